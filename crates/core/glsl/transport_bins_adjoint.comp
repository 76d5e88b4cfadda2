#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U^T where source, receiver or both have bins, point to point: with w_ij = max(cos_j, 0) |cos_i| g_ij a_i and
// λ_ij = λ_j + Σ_b T_b(ω_j) λ_j(b), the importance of irradiance at j from i,
//     front: μ_i += w_ij λ_ij, μ_i(b) += T_b(ω_i) w_ij λ_ij;   back: -T_b(ω_i) w_ij λ_ij to the antiradiance.
// transport_bins.comp with sources as targets. Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer FarRuns { uint far_runs[]; };
layout(std430, binding = 2) buffer Radiance { real4 radiance[]; };
layout(std430, binding = 3) readonly buffer Cotangent { real cotangent[]; };
layout(scalar, binding = 3) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
layout(std430, binding = 4) buffer Back { real outgoing_back[]; };
layout(scalar, binding = 4) buffer BackRgb { real3 outgoing_back_rgb[]; };
layout(std430, binding = 5) buffer Front { real outgoing_front[]; };
layout(scalar, binding = 5) buffer FrontRgb { real3 outgoing_front_rgb[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 6) readonly buffer BinTable { real4 bin_table[]; };
#define PARTNERS_BINDING 7
// λ, the cotangent of irradiance.
#define PARTNERS_LIGHT partner_cotangent
#include "partners.glsl"

#include "far_push.glsl"
#include "adjoint_bins.glsl"

void main() {
    uint tile = target_tile + gl_WorkGroupID.x;
    uint i = tile * TILE + gl_WorkGroupID.y * TARGETS + lane_target();
    Facet source = facets[i];
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
        uint receivers = fronts || backs ? (end - begin) * TILE : 0;
        uint first = (begin - partner_begin) * TILE;
        for (uint k = lane_turn(); k < receivers; k += COOPERATIVE) {
            Facet receiver = partners[first + k];
            real3 d = receiver.centre - source.centre;
            real r2 = max(dot(d, d), R2_MIN);
            real from = dot(d, source.normal);
            real to = max(-dot(d, receiver.normal), 0.0);
            real blend = 1.0;
            // A loop, to skip it for tiles that are far apart, nearly all.
            for (uint once = near ? 1 : 0; once > 0; once--) {
                blend = far_weight(r2, half_range * (receiver.characteristic_area + source.characteristic_area));
            }
            real side = from > 0.0 ? real(fronts) : real(backs);
            real weight = side * blend * abs(from) * to * source.area / (r2 * (r2 + source.area * INV_PI));
            // A loop, to skip it where no lane has anything to add.
            for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
                real3 direction = d * inversesqrt(r2);
                bool front = from > 0.0;
                uint bins = (begin * TILE + k - partner_page) * BINS;
                real3 binned = binned_cotangent(receiver.normal, bins, -direction);
                real3 value = weight * (partner_cotangent[first + k].rgb + binned);
                scatter_radiance(source.normal, direction, front, value);
                sum += front ? value : real3(0.0);
            }
            reduce_scattered();
        }
    }
    sum = total(sum);
    if (lane_turn() == 0) {
        radiance[i].rgb += sum;
    }
    flush_radiance((i - target_page) * BINS);
}
