#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U^T between close triangles: near.comp with sources as targets, which sum over their close receivers. Twin:
// crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "bins.glsl"
#include "pieces.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer CotangentIrradiance { real4 cotangent_irradiance[]; };
layout(std430, binding = 2) readonly buffer Corners { real4 corners[]; };
layout(std430, binding = 3) buffer Radiance { real4 radiance[]; };
layout(std430, binding = 4) readonly buffer Cotangent { real cotangent[]; };
layout(scalar, binding = 4) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
layout(std430, binding = 5) buffer Back { real outgoing_back[]; };
layout(scalar, binding = 5) buffer BackRgb { real3 outgoing_back_rgb[]; };
layout(std430, binding = 6) buffer Front { real outgoing_front[]; };
layout(scalar, binding = 6) buffer FrontRgb { real3 outgoing_front_rgb[]; };
layout(std430, binding = 7) readonly buffer NearOffsets { uint near_offsets[]; };
layout(std430, binding = 8) readonly buffer NearPartners { uint near_partners[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 9) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 10) readonly buffer NearTargets { uint near_targets[]; };

#include "near_push.glsl"
#include "adjoint_bins.glsl"

uint receiver_first;
real source_characteristic_area;
real3 receiver_normal, receiver_cotangent, source_normal;
real3 sum = real3(0.0);

// From a piece of the source to a point of the receiver, with the blend weights of the two kinds of radiance.
void piece(real3 p, real3 q, real3 r, real3 point, real diffuse, real binned) {
    real3 offset = point - (p + q + r) * (real(1.0) / 3.0);
    real side = dot(offset, source_normal);
    bool apart = side * side > COINCIDENT * source_characteristic_area;
    bool front = side > 0.0;
    diffuse = front ? diffuse : real(0.0);
    binned = (SOURCE_FRONT && front) || (SOURCE_BACK && !front) ? binned : real(0.0);
    for (uint once = apart && (diffuse > 0.0 || binned > 0.0) ? 1 : 0; once > 0; once--) {
        real projected = projected_solid_angle(receiver_normal, p - point, q - point, r - point);
        for (uint seen = projected > 0.0 ? 1 : 0; seen > 0; seen--) {
            real3 direction = normalize(offset);
            real3 value = receiver_cotangent + binned_cotangent(receiver_normal, receiver_first, -direction);
            value *= projected;
            scatter_radiance(source_normal, direction, front, binned * value);
            sum += diffuse * value;
        }
    }
}

#include "near_walk.glsl"

void main() {
    bool active_lane = own_number() < targets;
    uint i = owned(active_lane);
    Facet source = facets[i];
    source_normal = source.normal;
    source_characteristic_area = source.characteristic_area;
    clear_scattered();
    real3 u = corners[3 * i].xyz, v = corners[3 * i + 1].xyz, w = corners[3 * i + 2].xyz;
    uvec2 close = close_partners(i, active_lane);
    for (uint at = close.x; any_cooperative(at < close.y); at++) {
        // Lanes whose target has no more partners go on with the others.
        bool has_partner = !TARGETS_ARE_SHARED || at < close.y;
        uint j = has_partner ? near_partners[at] : i;
        Facet receiver = facets[j];
        receiver_normal = receiver.normal;
        receiver_cotangent = cotangent_irradiance[j].rgb;
        receiver_first = (j - partner_page) * BINS;
        real3 a = corners[3 * j].xyz, b = corners[3 * j + 1].xyz, c = corners[3 * j + 2].xyz;
        real3 between = receiver.centre - source.centre;
        real range = half_range * (source.characteristic_area + receiver.characteristic_area);
        real near = !has_partner ? real(0.0) : 1.0 - far_weight(dot(between, between), range);
        walk_pieces(source.centre, u, v, w, a, b, c, near, range);
    }
    sum = total(sum);
    // A loop, to skip it where nothing was accumulated: adding zeros to the bins costs a CPU driver as much as a
    // pair.
    for (uint once = close.x < close.y ? 1 : 0; once > 0; once--) {
        if (lane_turn() == 0) {
            radiance[i].rgb += sum;
        }
        flush_radiance((i - target_page) * BINS);
    }
}
