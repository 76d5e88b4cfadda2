#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U^T where source, receiver or both have bins, point to point: with w_ij = max(cos_j, 0) |cos_i| g_ij a_i and
// λ_ij = λ_j + Σ_b T_b(ω_j) λ_j(b), what one unit of irradiance at j from i is worth,
//     front: μ_i += w_ij λ_ij, μ_i(b) += T_b(ω_i) w_ij λ_ij;   back: -T_b(ω_i) w_ij λ_ij to the antiradiance.
// As transport_bins.comp, with sources for owners. Twin: src/reference/adjoint.rs.

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
layout(std430, binding = 4) buffer Back { real leaving_back[]; };
layout(scalar, binding = 4) buffer BackRgb { real3 leaving_back_rgb[]; };
layout(std430, binding = 5) buffer Front { real leaving_front[]; };
layout(scalar, binding = 5) buffer FrontRgb { real3 leaving_front_rgb[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 6) readonly buffer BinTable { real4 bin_table[]; };
#define OTHERS_BINDING 7
// λ, the cotangent of irradiance.
#define OTHERS_LIGHT others_cotangent
#include "others.glsl"

#include "far_push.glsl"
#include "adjoint_bins.glsl"

void main() {
    uint tile = owner_tile + gl_WorkGroupID.x;
    uint i = tile * TILE + gl_WorkGroupID.y * LANES + gl_LocalInvocationID.x;
    Facet source = facets[i];
    real3 sum = real3(0.0);
    clear_deposits();
    uint end = other_begin;
    for (uint run = first_run(tile, other_begin); end < other_end; run++) {
        uint begin = end;
        end = run_end(run);
        uint flags = run_flags(run);
        bool fronts = (flags & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (flags & PAIR_BACK) != 0;
        bool near = (flags & PAIR_NEAR) != 0;
        uint receivers = fronts || backs ? (end - begin) * TILE : 0;
        uint first = (begin - other_begin) * TILE;
        for (uint k = 0; k < receivers; k++) {
            Facet receiver = others[first + k];
            real3 d = receiver.centre - source.centre;
            real r2 = max(dot(d, d), R2_MIN);
            real from = dot(d, source.normal);
            real to = max(-dot(d, receiver.normal), 0.0);
            real share = 1.0;
            // A loop: tiles that are far apart, nearly all, skip it.
            for (uint once = near ? 1 : 0; once > 0; once--) {
                share = far_weight(r2, half_range * (receiver.extent + source.extent));
            }
            real side = from > 0.0 ? real(fronts) : real(backs);
            real weight = side * share * abs(from) * to * source.area / (r2 * (r2 + source.area * INV_PI));
            // A loop, for the same reason as elsewhere: it is skipped where no lane has anything to add.
            for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
                real3 direction = d * inversesqrt(r2);
                bool front = from > 0.0;
                uint bins = (begin * TILE + k - other_page) * BINS;
                real3 binned = binned_cotangent(receiver.normal, bins, -direction);
                real3 value = weight * (others_cotangent[first + k].rgb + binned);
                deposit_radiance(source.normal, direction, front, value);
                sum += front ? value : real3(0.0);
            }
        }
    }
    radiance[i].rgb += sum;
    flush_radiance((i - owner_page) * BINS);
}
