#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U where source, receiver or both have bins, point to point:
//     H_j(b) += T_b(ω_j) max(cos_j, 0) |cos_i| g_ij a_i · (front: L_i(ω_i); back: -A_i(ω_i)).
// A lane owns one receiver, or shares it (cooperative.glsl). Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer FarRuns { uint far_runs[]; };
layout(std430, binding = 2) buffer Irradiance { real4 irradiance[]; };
layout(std430, binding = 3) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 3) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 4) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 4) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(std430, binding = 5) buffer Incident { real incident[]; };
layout(scalar, binding = 5) buffer IncidentRgb { real3 incident_rgb[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 6) readonly buffer BinTable { real4 bin_table[]; };
#define PARTNERS_BINDING 7
#define PARTNERS_LIGHT partner_radiance
#include "partners.glsl"

#include "far_push.glsl"
#include "source_bins.glsl"
#include "receiver_bins.glsl"

// Adds what one source sends to one receiver to the scattered, and the sum of all bins to `sum`. `at`: place of the source among the
// partners, `bins`: its first bin in its page.
void receive(
    Facet receiver,
    Facet source,
    uint at,
    uint bins,
    bool fronts,
    bool backs,
    bool near,
    inout real3 sum
) {
    real3 d = receiver.centre - source.centre;
    real r2 = max(dot(d, d), R2_MIN);
    real from = dot(d, source.normal);
    real to = max(-dot(d, receiver.normal), 0.0);
    real blend = 1.0;
    // A loop, to skip it for sources that are far away, nearly all.
    for (uint once = near ? 1 : 0; once > 0; once--) {
        blend = far_weight(r2, half_range * (source.characteristic_area + receiver.characteristic_area));
    }
    real side = from > 0.0 ? real(fronts) : real(backs);
    real weight = side * blend * abs(from) * to * source.area / (r2 * (r2 + source.area * INV_PI));
    // A loop, to skip it where no lane has anything to add.
    for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
        real3 direction = d * inversesqrt(r2);
        bool front = from > 0.0;
        real3 binned = binned_radiance(source.normal, bins, direction, front);
        real3 value = weight * (front ? partner_radiance[at].rgb + binned : binned);
        scatter(0, receiver.normal, -direction, value);
        sum += value;
    }
}

void main() {
    uint tile = target_tile + gl_WorkGroupID.x;
    uint j = tile * TILE + gl_WorkGroupID.y * TARGETS + lane_target();
    Facet receiver = facets[j];
    real3 sum = real3(0.0);
    clear_scattered();
    uint end = partner_begin;
    for (uint run = first_run(tile, partner_begin); end < partner_end; run++) {
        uint begin = end;
        end = run_end(run);
        uint flags = run_flags(run);
        bool fronts = (flags & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (flags & PAIR_BACK) != 0;
        bool near = (flags & PAIR_NEAR) != 0;
        uint sources = fronts || backs ? (end - begin) * TILE : 0;
        uint first = (begin - partner_begin) * TILE;
        for (uint k = lane_turn(); k < sources; k += COOPERATIVE) {
            uint bins = (begin * TILE + k - partner_page) * BINS;
            receive(receiver, partners[first + k], first + k, bins, fronts, backs, near, sum);
            reduce_scattered();
        }
    }
    sum = total(sum);
    if (lane_turn() == 0) {
        irradiance[j].rgb += sum;
    }
    flush_scattered((j - target_page) * BINS);
}
