#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// The derivative of ⟨λ, U L⟩ with respect to the geometry of the targets, sources or receivers, point to point: of
// Σ_ij w_ij ⟨L_i(ω_i), λ_ij⟩ with w_ij = blend_ij max(cos_j, 0) |cos_i| g_ij a_i. Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field_gradient.glsl"
#include "bins_slope.glsl"
#include "facet_gradient.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;
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
layout(std430, binding = 7) readonly buffer FarRuns { uint far_runs[]; };
#define PARTNERS_BINDING 8
// What diffuse fronts send, or the cotangent of irradiance.
#define PARTNERS_LIGHT partner_light
#include "partners.glsl"

#include "far_push.glsl"
#include "source_bins.glsl"
#include "directional_gradient.glsl"

void main() {
    uint tile = target_tile + gl_WorkGroupID.x;
    uint target = tile * TILE + gl_WorkGroupID.y * LANES + gl_LocalInvocationID.x;
    Facet own = facets[target];
    real3 own_light = TARGET_IS_SOURCE ? radiance[target].rgb : cotangent_irradiance[target].rgb;
    uint own_bins = (target - target_page) * BINS;
    real3 by_centre = real3(0.0), by_normal = real3(0.0);
    real by_area = 0.0, by_characteristic_area = 0.0;
    uint end = partner_begin;
    for (uint run = first_run(tile, partner_begin); end < partner_end; run++) {
        uint begin = end;
        end = run_end(run);
        uint flags = run_flags(run);
        bool fronts = (flags & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (flags & PAIR_BACK) != 0;
        bool near = (flags & PAIR_NEAR) != 0;
        uint count = fronts || backs ? (end - begin) * TILE : 0;
        uint first = (begin - partner_begin) * TILE;
        for (uint k = 0; k < count; k++) {
            Facet partner = partners[first + k];
            real3 d = TARGET_IS_SOURCE ? partner.centre - own.centre : own.centre - partner.centre;
            real3 source_normal = TARGET_IS_SOURCE ? own.normal : partner.normal;
            real3 receiver_normal = TARGET_IS_SOURCE ? partner.normal : own.normal;
            real area = TARGET_IS_SOURCE ? own.area : partner.area;
            real r2 = max(dot(d, d), R2_MIN);
            real from = dot(d, source_normal);
            real to = max(-dot(d, receiver_normal), 0.0);
            real range = half_range * (partner.characteristic_area + own.characteristic_area);
            real blend = 1.0;
            real2 slopes = real2(0.0);
            // A loop, to skip it for tiles that are far apart, nearly all.
            for (uint once = near ? 1 : 0; once > 0; once--) {
                blend = far_weight(r2, range);
                slopes = far_weight_slopes(r2, range);
            }
            bool front = from > 0.0;
            real side = front ? real(fronts) : -real(backs);
            // w = blend · side from · to · kernel.
            real wide = r2 + area * INV_PI;
            real kernel = area / (r2 * wide);
            for (uint once = side * from * to * blend * area > 0.0 ? 1 : 0; once > 0; once--) {
                real weight = blend * side * from * to * kernel;
                real r = sqrt(r2);
                real3 direction = d / r;
                real3 light = partner_light[first + k].rgb;
                uint bins = (begin * TILE + k - partner_page) * BINS;
                Exchanged e = exchanged(
                    source_normal, TARGET_IS_SOURCE ? own_bins : bins, TARGET_IS_SOURCE ? own_light : light, front,
                    receiver_normal, TARGET_IS_SOURCE ? bins : own_bins, TARGET_IS_SOURCE ? light : own_light,
                    direction, 1.0, 1.0
                );
                real value = dot(e.diffuse + e.binned, e.adjoint);
                real plain = value * side * from * to * kernel;
                real by_from = value * blend * side * to * kernel;
                real by_to = value * blend * side * from * kernel;
                real by_r2 = slopes.x * plain - blend * plain * (1.0 / r2 + 1.0 / wide);
                real3 by_d = by_from * source_normal - by_to * receiver_normal + 2.0 * by_r2 * d
                    + through_normalization(weight * e.by_direction, direction, r);
                by_centre += TARGET_IS_SOURCE ? -by_d : by_d;
                by_normal += TARGET_IS_SOURCE ? by_from * d + weight * e.by_source_normal
                                         : -by_to * d + weight * e.by_receiver_normal;
                by_area += TARGET_IS_SOURCE ? blend * value * side * from * to / (wide * wide) : real(0.0);
                by_characteristic_area += slopes.y * plain * half_range;
            }
        }
    }
    by_centre *= real(1.0) / 3.0;
    gradients[target].a += by_centre;
    gradients[target].b += by_centre;
    gradients[target].c += by_centre;
    gradients[target].normal += by_normal;
    gradients[target].area += by_area;
    gradients[target].characteristic_area += by_characteristic_area;
}
