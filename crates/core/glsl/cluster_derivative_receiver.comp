#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// The derivative of ⟨λ, U L⟩ with respect to the geometry of the receivers of far sources, clusters and triangles. A lane owns
// one receiver. Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field_gradient.glsl"
#include "bins_slope.glsl"
#include "facet_gradient.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer FarLists { uint far_lists[]; };
layout(std430, binding = 2) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 3) buffer Gradients { FacetGradient gradients[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(scalar, binding = 6) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
// λ, the cotangent of irradiance.
layout(std430, binding = 7) readonly buffer Cotangents { real4 cotangents[]; };

#include "far_list.glsl"
#include "source_bins.glsl"
#include "directional_gradient.glsl"
#include "listed_gradient.glsl"

void main() {
    uint list = target_list + gl_WorkGroupID.x;
    uint j = list * LIST + gl_WorkGroupID.y * LANES + gl_LocalInvocationID.x;
    Facet receiver = facets[j];
    real3 cotangent = cotangents[j].rgb;
    uint receiver_bins = (j - target_page) * BINS;
    FacetGradient sum = no_gradient();
    uvec2 entries = part_of_list(list);
    for (uint at = entries.x; at < entries.y; at += LANES) {
        uint count = fetch(at, entries.y);
        for (uint k = 0; k < count; k++) {
            uint entry = fetched_entry(k);
            uint bits = entry & passing;
            bool fronts = (bits & PAIR_FRONT) != 0;
            bool backs = SOURCE_BACK && (bits & PAIR_BACK) != 0;
            Facet source = fetched_facet(k);
            ListedGradient g = listed_gradient(
                source, fetched_radiance(k), fetched_moment(k), ((entry >> 3) - partner_page) * BINS, spread_of(source), fronts, backs,
                (bits & PAIR_NEAR) != 0, receiver, cotangent, receiver_bins
            );
            sum.a += g.by_between;
            sum.normal += g.by_receiver_normal;
            sum.characteristic_area += g.by_characteristic_area;
        }
    }
    sum.a *= real(1.0) / 3.0;
    // A loop, to skip padding.
    for (uint once = receiver.area > 0.0 ? 1 : 0; once > 0; once--) {
        gradients[j].a += sum.a;
        gradients[j].b += sum.a;
        gradients[j].c += sum.a;
        gradients[j].normal += sum.normal;
        gradients[j].characteristic_area += sum.characteristic_area;
    }
}
