#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U between close triangles, integrated piecewise: quarter to quarter and, for radiance that varies with direction,
// between two quarters close for their size, quarter of a quarter to quarter of a quarter. Each piece of the source
// illuminates the centroid of each piece of the receiver by Lambert's polygon formula. A lane owns one receiver, or shares
// it (cooperative.glsl), and sums over its close sources. Twin: crates/reference/src/lines.rs, which subdivides every source.

#include "geometry.glsl"
#include "near_field.glsl"
#include "bins.glsl"
#include "pieces.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 2) readonly buffer Corners { real4 corners[]; };
layout(std430, binding = 3) buffer Irradiance { real4 irradiance[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(std430, binding = 6) buffer Incident { real incident[]; };
layout(scalar, binding = 6) buffer IncidentRgb { real3 incident_rgb[]; };
layout(std430, binding = 7) readonly buffer NearOffsets { uint near_offsets[]; };
layout(std430, binding = 8) readonly buffer NearPartners { uint near_partners[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 9) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 10) readonly buffer NearTargets { uint near_targets[]; };

#include "near_push.glsl"
#include "source_bins.glsl"
#include "receiver_bins.glsl"

uint source_first;
real source_characteristic_area;
real3 receiver_normal, source_normal, source_diffuse;
real3 sum = real3(0.0);

// From a piece of the source to a point of the receiver, with the blend weights of the two kinds of radiance.
void piece(real3 p, real3 q, real3 r, real3 point, real diffuse, real binned) {
    real3 offset = point - (p + q + r) * (real(1.0) / 3.0);
    real side = dot(offset, source_normal);
    bool apart = side * side > COINCIDENT * source_characteristic_area;
    bool front = side > 0.0;
    diffuse = front ? diffuse : 0.0;
    binned = (SOURCE_FRONT && front) || (SOURCE_BACK && !front && backs != 0) ? binned : 0.0;
    // A loop that may run zero times: an `if` would not skip the work on a device that executes both sides.
    for (uint once = apart && (diffuse > 0.0 || binned > 0.0) ? 1 : 0; once > 0; once--) {
        real projected = projected_solid_angle(receiver_normal, p - point, q - point, r - point);
        for (uint seen = projected > 0.0 ? 1 : 0; seen > 0; seen--) {
            real3 direction = normalize(offset);
            real3 value = diffuse * source_diffuse;
            for (uint needed = binned > 0.0 ? 1 : 0; needed > 0; needed--) {
                value += binned * binned_radiance(source_normal, source_first, direction, front);
            }
            value *= projected;
            scatter(0, receiver_normal, -direction, value);
            sum += value;
        }
    }
}

#include "near_walk.glsl"

void main() {
    bool active_lane = own_number() < targets;
    uint j = owned(active_lane);
    Facet receiver = facets[j];
    receiver_normal = receiver.normal;
    clear_scattered();
    real3 a = corners[3 * j].xyz, b = corners[3 * j + 1].xyz, c = corners[3 * j + 2].xyz;
    uvec2 close = close_partners(j, active_lane);
    for (uint at = close.x; any_cooperative(at < close.y); at++) {
        // Lanes whose target has no more partners go on with the others.
        bool has_partner = !TARGETS_ARE_SHARED || at < close.y;
        uint i = has_partner ? near_partners[at] : j;
        Facet source = facets[i];
        source_normal = source.normal;
        source_characteristic_area = source.characteristic_area;
        source_diffuse = radiance[i].rgb;
        source_first = (i - partner_page) * BINS;
        real3 u = corners[3 * i].xyz, v = corners[3 * i + 1].xyz, w = corners[3 * i + 2].xyz;
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
            irradiance[j].rgb += sum;
        }
        flush_scattered((j - target_page) * BINS);
    }
}
