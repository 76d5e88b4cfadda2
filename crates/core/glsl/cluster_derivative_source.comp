#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// The derivative of ⟨λ, U L⟩ with respect to the geometry of far sources, clusters and triangles, light and shares of
// clusters held fixed. A lane owns one source. Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field_gradient.glsl"
#include "bins_slope.glsl"
#include "facet_gradient.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer ReceiverLists { uint receiver_lists[]; };
layout(std430, binding = 2) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 3) buffer Gradients { FacetGradient gradients[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(scalar, binding = 6) readonly buffer CotangentRgb { real3 cotangent_rgb[]; };
// λ, the cotangent of irradiance.
layout(std430, binding = 7) readonly buffer Cotangents { real4 cotangents[]; };
layout(std430, binding = 8) readonly buffer Targets { uint targets[]; };

#include "receiver_list.glsl"
#include "source_bins.glsl"
#include "directional_gradient.glsl"
#include "listed_gradient.glsl"

void main() {
    uint group = own_group();
    uint i = own_source(group);
    bool active_lane = i < source_end;
    uint own = min(i, source_end - 1);
    Facet source = facets[own];
    real3 light = radiance[own].rgb;
    Moment moment = NO_MOMENT;
    // A loop, to skip it for triangles.
    for (uint once = clusters != 0 ? 1 : 0; once > 0; once--) {
        uint row = moments + 3 * (own - clusters);
        moment = Moment(radiance[row].rgb, radiance[row + 1].rgb, radiance[row + 2].rgb);
    }
    uint source_bins = (own - target_page) * BINS;
    real spread = spread_of(source);
    FacetGradient sum = no_gradient();
    uvec2 words = part_of_group(group);
    for (uint at = words.x; at < words.y; at += 2) {
        uint bits = own_bits(at, active_lane);
        bool fronts = (bits & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (bits & PAIR_BACK) != 0;
        bool near = (bits & PAIR_NEAR) != 0;
        uint first = receiver_lists[at] * LIST;
        for (uint row = 0; row < LIST; row += STEP) {
            fetch(first + row);
            for (uint k = 0; k < STEP; k++) {
                uint receiver_bins = (first + row + k - partner_page) * BINS;
                ListedGradient g = listed_gradient(
                    source, light, moment, source_bins, spread, fronts, backs, near,
                    fetched_facet(first + row, k), fetched_cotangent(first + row, k), receiver_bins
                );
                sum.a -= g.by_between;
                sum.normal += g.by_source_normal;
                sum.area += g.by_area;
                sum.characteristic_area += clusters != 0 ? g.by_spread : g.by_characteristic_area;
            }
        }
    }
    sum.a *= real(1.0) / 3.0;
    // A loop, to skip lanes without a source of their own.
    for (uint once = active_lane ? 1 : 0; once > 0; once--) {
        gradients[i].a += sum.a;
        gradients[i].b += sum.a;
        gradients[i].c += sum.a;
        gradients[i].normal += sum.normal;
        gradients[i].area += sum.area;
        gradients[i].characteristic_area += sum.characteristic_area;
    }
}
