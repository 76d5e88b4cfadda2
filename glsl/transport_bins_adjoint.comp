#version 450 core
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U^T where source, receiver or both have bins, point to point: with w_ij = max(cos_j, 0) |cos_i| g_ij a_i and
// λ_ij = λ_j + Σ_b T_b(ω_j) λ_j(b), the importance of irradiance at j from i,
//     front: μ_i += w_ij λ_ij, μ_i(b) += T_b(ω_i) w_ij λ_ij;   back: -T_b(ω_i) w_ij λ_ij to the antiradiance.
// transport_bins.comp with sources as targets. Twin: src/reference/adjoint.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer CotangentIrradiance { real4 cotangent_irradiance[]; };
layout(std430, binding = 2) readonly buffer FarRuns { uint far_runs[]; };
layout(std430, binding = 3) buffer Radiance { real4 radiance[]; };
layout(std430, binding = 4) readonly buffer Cotangent { real cotangent[]; };
layout(scalar, binding = 4) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
layout(std430, binding = 5) buffer Back { real outgoing_back[]; };
layout(scalar, binding = 5) buffer BackRgb { real3 outgoing_back_rgb[]; };
layout(std430, binding = 6) buffer Front { real outgoing_front[]; };
layout(scalar, binding = 6) buffer FrontRgb { real3 outgoing_front_rgb[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 7) readonly buffer BinTable { real4 bin_table[]; };

#include "far_push.glsl"
#include "adjoint_bins.glsl"

void main() {
    uint tile = target_tile + gl_WorkGroupID.x;
    uint i = tile * TILE + gl_WorkGroupID.y * LANES + gl_LocalInvocationID.x;
    Facet source = facets[i];
    real3 sum = real3(0.0);
    clear_deposits();
    uint end = partner_begin;
    for (uint run = first_run(tile, partner_begin); end < partner_end; run++) {
        uint begin = end;
        end = run_end(run);
        uint flags = run_flags(run);
        bool fronts = (flags & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (flags & PAIR_BACK) != 0;
        bool near = (flags & PAIR_NEAR) != 0;
        uint batches = fronts || backs ? (end - begin) * (TILE / LANES) : 0;
        for (uint batch = 0; batch < batches; batch++) {
            uint mine = begin * TILE + batch * LANES + gl_LocalInvocationID.x;
            Facet f = facets[mine];
            real3 light = cotangent_irradiance[mine].rgb;
            for (uint lane = 0; lane < LANES; lane++) {
                uint j = begin * TILE + batch * LANES + lane;
                real3 x = subgroupBroadcast(f.centre, lane);
                real3 n = subgroupBroadcast(f.normal, lane);
                real3 l = subgroupBroadcast(light, lane);
                real characteristic_area = subgroupBroadcast(f.characteristic_area, lane);
                real3 d = x - source.centre;
                real r2 = max(dot(d, d), R2_MIN);
                real from = dot(d, source.normal);
                real to = max(-dot(d, n), 0.0);
                real blend = near ? far_weight(r2, half_range * (characteristic_area + source.characteristic_area)) : real(1.0);
                real side = from > 0.0 ? real(fronts) : real(backs);
                real weight = side * blend * abs(from) * to * source.area / (r2 * (r2 + source.area * INV_PI));
                // A loop, to skip it where no lane has anything to add.
                for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
                    real3 direction = d * inversesqrt(r2);
                    bool front = from > 0.0;
                    real3 value = weight * (l + binned_cotangent(n, (j - partner_page) * BINS, -direction));
                    deposit_radiance(source.normal, direction, front, value);
                    sum += front ? value : real3(0.0);
                }
            }
        }
    }
    radiance[i].rgb += sum;
    flush_radiance((i - target_page) * BINS);
}
