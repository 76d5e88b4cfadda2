#version 450 core
#extension GL_GOOGLE_include_directive : require
// U^T from triangles without bins to diffuse fronts, point to point:
//     μ_i += a_i Σ_j max(cos_i, 0) max(cos_j, 0) g_ij λ_j,   g = 1 / (r² + a_i/π).
// transport_irradiance.comp with sources as targets. Twin: crates/reference/src/lines.rs.

#include "cooperative.glsl"
#include "geometry.glsl"
#include "near_field.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;
const uint PER_LANE = TARGETS_ARE_SHARED ? 1 : TILE / LANES;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer FarRuns { uint far_runs[]; };
// μ, the cotangent of radiance.
layout(std430, binding = 2) buffer Radiance { real4 radiance[]; };
#define PARTNERS_BINDING 3
// λ, the cotangent of irradiance.
#define PARTNERS_LIGHT partner_cotangent
#include "partners.glsl"

#include "far_push.glsl"

void main() {
    uint tile = target_tile + gl_WorkGroupID.x;
    uint first = tile * TILE + gl_WorkGroupID.y * TARGETS + lane_target();
    real3 centre[PER_LANE], normal[PER_LANE], sum[PER_LANE];
    real characteristic_area[PER_LANE], area[PER_LANE];
    for (uint k = 0; k < PER_LANE; k++) {
        Facet f = facets[first + k * LANES];
        centre[k] = f.centre;
        normal[k] = f.normal;
        characteristic_area[k] = f.characteristic_area;
        area[k] = f.area;
        sum[k] = real3(0.0);
    }
    uint end = partner_begin;
    for (uint run = first_run(tile, partner_begin); end < partner_end; run++) {
        uint begin = end;
        end = run_end(run);
        uint flags = run_flags(run);
        // Loops that may run zero times: an `if` would not skip the work on a device that executes both branches.
        uint receivers = (flags & PAIR_FRONT) != 0 ? (end - begin) * TILE : 0;
        uint near_receivers = (flags & PAIR_NEAR) != 0 ? receivers : 0;
        uint far_receivers = receivers - near_receivers;
        uint at = (begin - partner_begin) * TILE;
        for (uint j = at + lane_turn(); j < at + far_receivers; j += COOPERATIVE) {
            Facet f = partners[j];
            real3 l = partner_cotangent[j].rgb;
            for (uint k = 0; k < PER_LANE; k++) {
                real3 d = f.centre - centre[k];
                real r2 = max(dot(d, d), R2_MIN);
                real cosines = max(dot(d, normal[k]), 0.0) * max(-dot(d, f.normal), 0.0);
                sum[k] += l * (cosines / (r2 * (r2 + area[k] * INV_PI)));
            }
        }
        for (uint j = at + lane_turn(); j < at + near_receivers; j += COOPERATIVE) {
            Facet f = partners[j];
            real3 l = partner_cotangent[j].rgb;
            for (uint k = 0; k < PER_LANE; k++) {
                real3 d = f.centre - centre[k];
                real r2 = max(dot(d, d), R2_MIN);
                real cosines = max(dot(d, normal[k]), 0.0) * max(-dot(d, f.normal), 0.0);
                real blend = far_weight(r2, half_range * (f.characteristic_area + characteristic_area[k]));
                sum[k] += l * (blend * cosines / (r2 * (r2 + area[k] * INV_PI)));
            }
        }
    }
    for (uint k = 0; k < PER_LANE; k++) {
        real3 all = total(area[k] * sum[k]);
        if (lane_turn() == 0) {
            radiance[first + k * LANES].rgb += all;
        }
    }
}
