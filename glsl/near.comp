#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U between triangles that are close to one another, integrated over pieces: quarter to quarter, and for radiance that
// varies with direction, where two quarters are close for their own size, quarter of a quarter to quarter of a quarter. Each piece of the source counts with Lambert's polygon formula from the centroid of each piece of the
// receiver. A lane owns one receiver and walks its list of close sources. Twin: src/reference/transport.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 2) readonly buffer Corners { real4 corners[]; };
layout(std430, binding = 3) buffer Irradiance { real4 irradiance[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(std430, binding = 6) buffer Arriving { real arriving[]; };
layout(scalar, binding = 6) buffer ArrivingRgb { real3 arriving_rgb[]; };
// Of each receiver: where its list starts in `near_sources`. One entry more than there are slots.
layout(std430, binding = 7) readonly buffer NearOffsets { uint near_offsets[]; };
// Slots of close sources, rising within each list.
layout(std430, binding = 8) readonly buffer NearSources { uint near_sources[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 9) readonly buffer BinTable { real4 bin_table[]; };

layout(push_constant) uniform NearPush {
    // Receivers, from slot `receiver_begin` to before `receiver_end`.
    uint receiver_begin;
    uint receiver_end;
    // Sources of other slots are passed over.
    uint source_begin;
    uint source_end;
    float half_range;
    uint receiver_page;
    uint source_page;
    // 1 where backs let antiradiance out, 0 in a pass of emission alone.
    uint backs;
    // Of the sources in range, `take` after the first `skip`.
    uint skip;
    uint take;
};

#include "source_bins.glsl"
#include "receiver_bins.glsl"

// src/reference/near_field.rs says why.
const real QUARTER_RANGE = real(1.0) / 24.0;

// The quarters of the triangle p, q, r: three at its corners, then the one in the middle.
void quarter(uint k, inout real3 p, inout real3 q, inout real3 r) {
    real3 pq = 0.5 * (p + q), qr = 0.5 * (q + r), rp = 0.5 * (r + p);
    p = k == 0 ? p : k == 1 ? pq : k == 2 ? rp : pq;
    q = k == 0 ? pq : k == 1 ? q : qr;
    r = k == 0 ? rp : k == 1 ? qr : k == 2 ? r : rp;
}

uint receiver_slot, receiver_first, source_first;
real3 receiver_normal, source_normal, source_diffuse;
real3 sum = real3(0.0);

// From a piece of the source to a point of the receiver, with the shares of the two kinds of radiance.
void piece(real3 p, real3 q, real3 r, real3 point, real diffuse, real binned) {
    real3 offset = point - (p + q + r) * (real(1.0) / 3.0);
    real side = dot(offset, source_normal);
    bool front = side > 0.0;
    diffuse = front ? diffuse : 0.0;
    binned = (SOURCE_FRONT && front) || (SOURCE_BACK && !front && backs != 0) ? binned : 0.0;
    // A loop that may run zero times: an `if` would not skip the work on a device that executes both sides.
    for (uint once = side != 0.0 && (diffuse > 0.0 || binned > 0.0) ? 1 : 0; once > 0; once--) {
        real projected = projected_solid_angle(receiver_normal, p - point, q - point, r - point);
        for (uint seen = projected > 0.0 ? 1 : 0; seen > 0; seen--) {
            real3 direction = normalize(offset);
            real3 value = diffuse * source_diffuse;
            for (uint needed = binned > 0.0 ? 1 : 0; needed > 0; needed--) {
                value += binned * binned_radiance(source_normal, source_first, direction, front);
            }
            value *= projected;
            deposit(receiver_normal, -direction, value);
            sum += value;
        }
    }
}

void main() {
    receiver_slot = receiver_begin + gl_GlobalInvocationID.x;
    bool active_lane = receiver_slot < receiver_end;
    uint j = active_lane ? receiver_slot : receiver_begin;
    receiver_first = (j - receiver_page) * BINS;
    Facet receiver = facets[j];
    receiver_normal = receiver.normal;
    clear_deposits();
    real3 a = corners[3 * j].xyz, b = corners[3 * j + 1].xyz, c = corners[3 * j + 2].xyz;
    uint end = near_offsets[j + 1];
    // The first source of the range, by bisection.
    uint at = near_offsets[j], after = end;
    while (at < after) {
        uint middle = (at + after) / 2;
        bool below = near_sources[middle] < source_begin;
        at = below ? middle + 1 : at;
        after = below ? after : middle;
    }
    at = min(at + skip, end);
    end = active_lane ? min(end, at + take) : at;
    for (; at < end; at++) {
        uint i = near_sources[at];
        if (i >= source_end) {
            break;
        }
        Facet source = facets[i];
        source_normal = source.normal;
        source_diffuse = radiance[i].rgb;
        source_first = (i - source_page) * BINS;
        real3 u = corners[3 * i].xyz, v = corners[3 * i + 1].xyz, w = corners[3 * i + 2].xyz;
        real3 between = receiver.centre - source.centre;
        real range = half_range * (source.extent + receiver.extent);
        real near = 1.0 - far_share(dot(between, between), range);
        for (uint pair = 0; pair < 16; pair++) {
            real3 p = u, q = v, r = w, e = a, f = b, g = c;
            quarter(pair & 3, p, q, r);
            quarter(pair >> 2, e, f, g);
            real3 point = (e + f + g) * (real(1.0) / 3.0);
            real far = 1.0;
            if (SOURCE_BACK || SOURCE_FRONT) {
                real3 d = point - (p + q + r) * (real(1.0) / 3.0);
                far = far_share(dot(d, d), range * QUARTER_RANGE);
            }
            piece(p, q, r, point, near * (1.0 / 4.0), near * far * (1.0 / 4.0));
            for (uint finer = far < 1.0 ? 0 : 16; finer < 16; finer++) {
                real3 p2 = p, q2 = q, r2 = r, e2 = e, f2 = f, g2 = g;
                quarter(finer & 3, p2, q2, r2);
                quarter(finer >> 2, e2, f2, g2);
                piece(p2, q2, r2, (e2 + f2 + g2) * (real(1.0) / 3.0), 0.0, near * (1.0 - far) * (1.0 / 16.0));
            }
        }
    }
    if (active_lane) {
        irradiance[receiver_slot].rgb += sum;
        flush_deposits(receiver_first);
    }
}
