#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// The derivative of ⟨λ, U L⟩ with respect to the geometry of the targets, sources or receivers, over close pairs.
// Pieces of a triangle are its corners, as columns, times a matrix of barycentric coordinates, so that gradients of
// pieces return to the corners by the transpose. Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field_gradient.glsl"
#include "bins_slope.glsl"
#include "pieces.glsl"
#include "facet_gradient.glsl"

layout(local_size_x_id = 0) in;
// Whether targets are sources, rather than receivers.
layout(constant_id = 10) const bool TARGET_IS_SOURCE = true;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 2) readonly buffer CotangentIrradiance { real4 cotangent_irradiance[]; };
layout(std430, binding = 3) buffer Gradients { FacetGradient gradients[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(scalar, binding = 6) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
layout(std430, binding = 7) readonly buffer NearOffsets { uint near_offsets[]; };
layout(std430, binding = 8) readonly buffer NearPartners { uint near_partners[]; };
layout(std430, binding = 9) readonly buffer Corners { real4 corners[]; };
layout(std430, binding = 10) readonly buffer NearTargets { uint near_targets[]; };

#include "near_push.glsl"
#include "source_bins.glsl"
#include "directional_gradient.glsl"

uint source_first, receiver_first;
real source_characteristic_area;
real3 source_normal, receiver_normal, source_diffuse, receiver_adjoint;
// Gradients of the target.
real33 by_corners = real33(0.0);
real3 by_normal = real3(0.0);
// Of the pair: with respect to the blend weight of the near field.
real by_near;

const real33 ONE = real33(1.0);

// Barycentric coordinates of the corners of a quarter, one per column.
real33 quarter_of(uint k) {
    real3 p = ONE[0], q = ONE[1], r = ONE[2];
    quarter(k, p, q, r);
    return real33(p, q, r);
}

// A piece of the source, `from` being the barycentric coordinates of its corners, and a point of the receiver at `to`.
// `diffuse` and `binned` are blend weights; returns the derivative with respect to `binned`, and adds to `by_near`
// that with respect to a factor of both.
real piece(real33 source, real33 receiver, real33 from, real3 to, real diffuse, real binned) {
    real3 third = real3(real(1.0) / 3.0);
    real33 corner = source * from;
    real3 point = receiver * to;
    real3 offset = point - corner * third;
    real side = dot(offset, source_normal);
    bool apart = side * side > COINCIDENT * source_characteristic_area;
    bool front = side > 0.0;
    bool directional = (SOURCE_FRONT && front) || (SOURCE_BACK && !front);
    diffuse = front ? diffuse : real(0.0);
    binned = directional ? binned : real(0.0);
    real by_binned = 0.0;
    for (uint once = apart && (diffuse > 0.0 || directional) ? 1 : 0; once > 0; once--) {
        real3 by_solid_normal;
        real33 by_piece;
        real projected = projected_solid_angle_gradient(
            receiver_normal, corner[0] - point, corner[1] - point, corner[2] - point,
            by_solid_normal, by_piece[0], by_piece[1], by_piece[2]
        );
        for (uint seen = projected > 0.0 ? 1 : 0; seen > 0; seen--) {
            real r = length(offset);
            real3 direction = offset / r;
            Exchanged e = exchanged(
                source_normal, source_first, source_diffuse, front, receiver_normal, receiver_first, receiver_adjoint,
                direction, diffuse, binned
            );
            by_binned = projected * dot(e.binned, e.adjoint);
            real3 radiance_here = diffuse * e.diffuse + binned * e.binned;
            real value = dot(radiance_here, e.adjoint);
            by_near += projected * value;
            real3 by_offset = through_normalization(projected * e.by_direction, direction, r);
            if (TARGET_IS_SOURCE) {
                by_piece *= value;
                by_corners += (by_piece - outerProduct(by_offset, third)) * transpose(from);
                by_normal += projected * e.by_source_normal;
            } else {
                real3 by_point = by_offset - value * (by_piece[0] + by_piece[1] + by_piece[2]);
                by_corners += outerProduct(by_point, to);
                by_normal += projected * e.by_receiver_normal + value * by_solid_normal;
            }
        }
    }
    return by_binned;
}

void main() {
    bool active_lane = own_number() < targets;
    uint target = owned(active_lane);
    Facet own = facets[target];
    real33 own_corners = real33(corners[3 * target].xyz, corners[3 * target + 1].xyz, corners[3 * target + 2].xyz);
    real by_characteristic_area = 0.0;
    real3 third = real3(real(1.0) / 3.0);
    uvec2 close = close_partners(target, active_lane);
    for (uint at = close.x; at < close.y; at++) {
        uint partner = near_partners[at];
        Facet f = facets[partner];
        real33 partner_corners = real33(corners[3 * partner].xyz, corners[3 * partner + 1].xyz, corners[3 * partner + 2].xyz);
        uint i = TARGET_IS_SOURCE ? target : partner;
        uint j = TARGET_IS_SOURCE ? partner : target;
        source_normal = TARGET_IS_SOURCE ? own.normal : f.normal;
        receiver_normal = TARGET_IS_SOURCE ? f.normal : own.normal;
        source_diffuse = radiance[i].rgb;
        source_characteristic_area = TARGET_IS_SOURCE ? own.characteristic_area : f.characteristic_area;
        receiver_adjoint = cotangent_irradiance[j].rgb;
        source_first = (i - (TARGET_IS_SOURCE ? target_page : partner_page)) * BINS;
        receiver_first = (j - (TARGET_IS_SOURCE ? partner_page : target_page)) * BINS;
        real33 source = TARGET_IS_SOURCE ? own_corners : partner_corners;
        real33 receiver = TARGET_IS_SOURCE ? partner_corners : own_corners;
        real3 between = own.centre - f.centre;
        real r2_pair = dot(between, between);
        real range = half_range * (own.characteristic_area + f.characteristic_area);
        real near = 1.0 - far_weight(r2_pair, range);
        real by_range = 0.0;
        by_near = 0.0;
        for (uint pair = 0; pair < 16; pair++) {
            real33 from = quarter_of(pair & 3), onto = quarter_of(pair >> 2);
            real3 to = onto * third;
            real3 d = receiver * to - source * (from * third);
            real r2 = dot(d, d);
            real far = 1.0;
            if (SOURCE_BACK || SOURCE_FRONT) {
                far = far_weight(r2, range * QUARTER_RANGE);
            }
            real by_far = near * 0.25 * piece(source, receiver, from, to, near * 0.25, near * far * 0.25);
            for (uint finer = far < 1.0 ? 0 : 16; finer < 16; finer++) {
                real33 from2 = from * quarter_of(finer & 3);
                real3 to2 = onto * (quarter_of(finer >> 2) * third);
                by_far -= near * 0.0625 * piece(source, receiver, from2, to2, 0.0, near * (1.0 - far) * 0.0625);
            }
            if (SOURCE_BACK || SOURCE_FRONT) {
                real2 slopes = by_far * far_weight_slopes(r2, range * QUARTER_RANGE);
                by_range += slopes.y * QUARTER_RANGE;
                real3 by_d = 2.0 * slopes.x * d;
                by_corners += TARGET_IS_SOURCE ? outerProduct(-by_d, from * third) : outerProduct(by_d, to);
            }
        }
        // near = 1 - far_weight; every piece has it as a factor.
        real2 slopes = near > 0.0 ? -by_near / near * far_weight_slopes(r2_pair, range) : real2(0.0);
        by_range += slopes.y;
        by_corners += outerProduct(2.0 * slopes.x * between, third);
        by_characteristic_area += by_range * half_range;
    }
    if (active_lane) {
        gradients[target].a += by_corners[0];
        gradients[target].b += by_corners[1];
        gradients[target].c += by_corners[2];
        gradients[target].normal += by_normal;
        gradients[target].characteristic_area += by_characteristic_area;
    }
}
