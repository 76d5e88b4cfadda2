#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// The derivative of ⟨λ, U L⟩ with respect to the geometry of the sources or of the receivers, whichever the lanes own,
// point to point: of Σ_ij w_ij ⟨L_i(ω_i), λ_ij⟩ with w_ij = share_ij max(cos_j, 0) |cos_i| g_ij a_i. Twin:
// src/reference/derivative/.

#include "geometry.glsl"
#include "near_field_gradient.glsl"
#include "bins_slope.glsl"
#include "facet_gradient.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;
// Whether a lane owns a source, or a receiver.
layout(constant_id = 10) const bool OWNS_SOURCE = true;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 2) readonly buffer CotangentIrradiance { real4 cotangent_irradiance[]; };
layout(std430, binding = 3) buffer Gradients { FacetGradient gradients[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(scalar, binding = 6) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
layout(std430, binding = 7) readonly buffer FarRuns { uint far_runs[]; };
#define OTHERS_BINDING 8
// What diffuse fronts send, or the cotangent of irradiance.
#define OTHERS_LIGHT others_light
#include "others.glsl"

#include "far_push.glsl"
#include "source_bins.glsl"
#include "directional_gradient.glsl"

void main() {
    uint tile = owner_tile + gl_WorkGroupID.x;
    uint owner = tile * TILE + gl_WorkGroupID.y * LANES + gl_LocalInvocationID.x;
    Facet own = facets[owner];
    real3 own_light = OWNS_SOURCE ? radiance[owner].rgb : cotangent_irradiance[owner].rgb;
    uint own_bins = (owner - owner_page) * BINS;
    real3 by_centre = real3(0.0), by_normal = real3(0.0);
    real by_area = 0.0, by_extent = 0.0;
    uint end = other_begin;
    for (uint run = first_run(tile, other_begin); end < other_end; run++) {
        uint begin = end;
        end = run_end(run);
        uint flags = run_flags(run);
        bool fronts = (flags & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (flags & PAIR_BACK) != 0;
        bool near = (flags & PAIR_NEAR) != 0;
        uint count = fronts || backs ? (end - begin) * TILE : 0;
        uint first = (begin - other_begin) * TILE;
        for (uint k = 0; k < count; k++) {
            Facet other = others[first + k];
            real3 d = OWNS_SOURCE ? other.centre - own.centre : own.centre - other.centre;
            real3 source_normal = OWNS_SOURCE ? own.normal : other.normal;
            real3 receiver_normal = OWNS_SOURCE ? other.normal : own.normal;
            real area = OWNS_SOURCE ? own.area : other.area;
            real r2 = max(dot(d, d), R2_MIN);
            real from = dot(d, source_normal);
            real to = max(-dot(d, receiver_normal), 0.0);
            real range = half_range * (other.extent + own.extent);
            real share = 1.0;
            real2 slopes = real2(0.0);
            // A loop: tiles that are far apart, nearly all, skip it.
            for (uint once = near ? 1 : 0; once > 0; once--) {
                share = far_weight(r2, range);
                slopes = far_weight_slopes(r2, range);
            }
            bool front = from > 0.0;
            real side = front ? real(fronts) : -real(backs);
            // w = share · side from · to · kernel.
            real wide = r2 + area * INV_PI;
            real kernel = area / (r2 * wide);
            for (uint once = side * from * to * share * area > 0.0 ? 1 : 0; once > 0; once--) {
                real weight = share * side * from * to * kernel;
                real r = sqrt(r2);
                real3 direction = d / r;
                real3 light = others_light[first + k].rgb;
                uint bins = (begin * TILE + k - other_page) * BINS;
                Exchanged e = exchanged(
                    source_normal, OWNS_SOURCE ? own_bins : bins, OWNS_SOURCE ? own_light : light, front,
                    receiver_normal, OWNS_SOURCE ? bins : own_bins, OWNS_SOURCE ? light : own_light,
                    direction, 1.0, 1.0
                );
                real value = dot(e.diffuse + e.binned, e.worth);
                real plain = value * side * from * to * kernel;
                real by_from = value * share * side * to * kernel;
                real by_to = value * share * side * from * kernel;
                real by_r2 = slopes.x * plain - share * plain * (1.0 / r2 + 1.0 / wide);
                real3 by_d = by_from * source_normal - by_to * receiver_normal + 2.0 * by_r2 * d
                    + through_normalization(weight * e.by_direction, direction, r);
                by_centre += OWNS_SOURCE ? -by_d : by_d;
                by_normal += OWNS_SOURCE ? by_from * d + weight * e.by_source_normal
                                         : -by_to * d + weight * e.by_receiver_normal;
                by_area += OWNS_SOURCE ? share * value * side * from * to / (wide * wide) : real(0.0);
                by_extent += slopes.y * plain * half_range;
            }
        }
    }
    by_centre *= real(1.0) / 3.0;
    gradients[owner].a += by_centre;
    gradients[owner].b += by_centre;
    gradients[owner].c += by_centre;
    gradients[owner].normal += by_normal;
    gradients[owner].area += by_area;
    gradients[owner].extent += by_extent;
}
