#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U^T to far sources, clusters and triangles, point to point: with w_ij = max(cos_j, 0) |cos_i| g_ij a_i and
// λ_ij = λ_j + Σ_b T_b(ω_j) λ_j(b), the importance of irradiance at j from i,
//     front: μ_i += w_ij λ_ij, μ_i(b) += T_b(ω_i) w_ij λ_ij;   back: -T_b(ω_i) w_ij λ_ij to the antiradiance,
// and of clusters the cotangent of the first moment, λ_ij (∂w_ij/∂x)ᵀ.
// A lane owns one source, or shares it (cooperative.glsl). Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "spread.glsl"
#include "bins.glsl"
#include "moment.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer ReceiverLists { uint receiver_lists[]; };
layout(std430, binding = 2) buffer Radiance { real4 radiance[]; };
layout(std430, binding = 3) readonly buffer Cotangent { real cotangent[]; };
layout(scalar, binding = 3) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
layout(std430, binding = 4) buffer Back { real outgoing_back[]; };
layout(scalar, binding = 4) buffer BackRgb { real3 outgoing_back_rgb[]; };
layout(std430, binding = 5) buffer Front { real outgoing_front[]; };
layout(scalar, binding = 5) buffer FrontRgb { real3 outgoing_front_rgb[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 6) readonly buffer BinTable { real4 bin_table[]; };
// λ, the cotangent of irradiance.
layout(std430, binding = 7) readonly buffer Cotangents { real4 cotangents[]; };
layout(std430, binding = 8) readonly buffer Targets { uint targets[]; };

#include "receiver_list.glsl"
#include "adjoint_bins.glsl"

void main() {
    uint group = own_group();
    uint i = own_source(group);
    bool active_lane = i < source_end;
    Facet source = facets[min(i, source_end - 1)];
    real3 sum = real3(0.0);
    Moment moment = NO_MOMENT;
    clear_scattered();
    uvec2 words = part_of_group(group);
    for (uint at = words.x; at < words.y; at += 2) {
        uint bits = own_bits(at, active_lane);
        bool fronts = (bits & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (bits & PAIR_BACK) != 0;
        bool near = (bits & PAIR_NEAR) != 0;
        uint first = receiver_lists[at] * LIST;
        for (uint row = 0; row < LIST; row += STEP) {
            fetch(first + row);
            for (uint k = lane_turn(); k < STEP; k += COOPERATIVE) {
                Facet receiver = fetched_facet(first + row, k);
                real3 d = receiver.centre - source.centre;
                real r2 = max(dot(d, d), R2_MIN);
                real from = dot(d, source.normal);
                bool front = from > 0.0;
                real blend = 1.0;
                // A loop, to skip it for sources that are far away, nearly all.
                for (uint once = near ? 1 : 0; once > 0; once--) {
                    blend = far_weight(r2, half_range * (receiver.characteristic_area + source.characteristic_area));
                }
                real tilt = front ? dot(receiver.normal, source.normal) : -dot(receiver.normal, source.normal);
                Spread seen = spread_over(-dot(d, receiver.normal), abs(from), tilt, spread_of(source), r2);
                real side = front ? real(fronts) : real(backs);
                real sent = side * blend * abs(from) * source.area / (r2 * (r2 + source.area * INV_PI));
                real weight = sent * seen.cosine;
                // A loop, to skip it where no lane has anything to add.
                for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
                    real3 direction = d * inversesqrt(r2);
                    uint bins = (first + row + k - partner_page) * BINS;
                    real3 binned = binned_cotangent(receiver.normal, bins, -direction);
                    real3 importance = fetched_cotangent(first + row, k) + binned;
                    real3 value = weight * importance;
                    scatter_radiance(source.normal, direction, front, value);
                    sum += front ? value : real3(0.0);
                    // A loop, to skip it for triangles.
                    for (uint uneven = clusters != 0 && front ? 1 : 0; uneven > 0; uneven--) {
                        real3 slope = sent * spread_slope(seen, receiver.normal, d, r2);
                        moment.x += slope.x * importance;
                        moment.y += slope.y * importance;
                        moment.z += slope.z * importance;
                    }
                }
                reduce_scattered();
            }
        }
    }
    sum = total(sum);
    moment = Moment(total(moment.x), total(moment.y), total(moment.z));
    // A loop, to skip lanes without a source of their own.
    for (uint once = active_lane && words.x < words.y ? 1 : 0; once > 0; once--) {
        if (lane_turn() == 0) {
            radiance[i - radiance_page].rgb += sum;
        }
        for (uint of_cluster = clusters != 0 && lane_turn() == 0 ? 1 : 0; of_cluster > 0; of_cluster--) {
            uint row = moments + 3 * (i - clusters);
            radiance[row].rgb += moment.x;
            radiance[row + 1].rgb += moment.y;
            radiance[row + 2].rgb += moment.z;
        }
        flush_radiance((i - target_page) * BINS);
    }
}
