#version 450 core
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_GOOGLE_include_directive : require
// U^T from triangles without bins to diffuse fronts, point to point:
//     μ_i += a_i Σ_j max(cos_i, 0) max(cos_j, 0) g_ij λ_j,   g = 1 / (r² + a_i/π).
// transport_irradiance.comp with sources as targets. Twin: src/reference/adjoint.rs.

#include "geometry.glsl"
#include "near_field.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;
const uint PER_LANE = TILE / LANES;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
// λ, the cotangent of irradiance.
layout(std430, binding = 1) readonly buffer Cotangent { real4 cotangent_irradiance[]; };
layout(std430, binding = 2) readonly buffer FarRuns { uint far_runs[]; };
// μ, the cotangent of radiance.
layout(std430, binding = 3) buffer Radiance { real4 radiance[]; };

#include "far_push.glsl"

void main() {
    uint tile = target_tile + gl_WorkGroupID.x;
    real3 centre[PER_LANE], normal[PER_LANE], sum[PER_LANE];
    real characteristic_area[PER_LANE], area[PER_LANE];
    for (uint k = 0; k < PER_LANE; k++) {
        Facet f = facets[tile * TILE + k * LANES + gl_LocalInvocationID.x];
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
        bool near = (flags & PAIR_NEAR) != 0;
        uint batches = (flags & PAIR_FRONT) != 0 ? (end - begin) * (TILE / LANES) : 0;
        for (uint batch = 0; batch < batches; batch++) {
            uint mine = begin * TILE + batch * LANES + gl_LocalInvocationID.x;
            Facet f = facets[mine];
            real3 light = cotangent_irradiance[mine].rgb;
            for (uint lane = 0; lane < LANES; lane++) {
                real3 x = subgroupBroadcast(f.centre, lane);
                real3 n = subgroupBroadcast(f.normal, lane);
                real3 l = subgroupBroadcast(light, lane);
                real e = subgroupBroadcast(f.characteristic_area, lane);
                for (uint k = 0; k < PER_LANE; k++) {
                    real3 d = x - centre[k];
                    real r2 = max(dot(d, d), R2_MIN);
                    real cosines = max(dot(d, normal[k]), 0.0) * max(-dot(d, n), 0.0);
                    real blend = near ? far_weight(r2, half_range * (e + characteristic_area[k])) : real(1.0);
                    sum[k] += l * (blend * cosines / (r2 * (r2 + area[k] * INV_PI)));
                }
            }
        }
    }
    for (uint k = 0; k < PER_LANE; k++) {
        radiance[tile * TILE + k * LANES + gl_LocalInvocationID.x].rgb += area[k] * sum[k];
    }
}
