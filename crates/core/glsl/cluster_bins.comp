#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U where source, receiver or both have bins, point to point, over lists of clusters and triangles:
//     H_j(b) += T_b(ω_j) max(cos_j, 0) |cos_i| g_ij a_i · (front: L_i(ω_i); back: -A_i(ω_i)).
// transport_bins.comp with other sources. A lane owns one receiver, or shares it (cooperative.glsl). Twin: crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "spread.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer FarLists { uint far_lists[]; };
layout(std430, binding = 2) buffer Irradiance { real4 irradiance[]; };
layout(std430, binding = 3) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 3) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 4) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 4) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(std430, binding = 5) buffer Incident { real incident[]; };
layout(scalar, binding = 5) buffer IncidentRgb { real3 incident_rgb[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 6) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 7) readonly buffer Radiance { real4 radiance[]; };

#include "far_list.glsl"
#include "source_bins.glsl"
#include "receiver_bins.glsl"

real3 light(uint at) {
    return fetched_radiance(at);
}

Moment moment(uint at) {
    return fetched_moment(at);
}

#define SPREAD
#include "bins_pair.glsl"

void main() {
    uint list = target_list + gl_WorkGroupID.x;
    uint j = list * LIST + gl_WorkGroupID.y * TARGETS + lane_target();
    Facet receiver = facets[j];
    real3 sum = real3(0.0);
    uvec2 entries = part_of_list(list);
    // A loop, to skip it where nothing would be added.
    for (uint once = entries.x < entries.y ? 1 : 0; once > 0; once--) {
        clear_scattered();
        for (uint at = entries.x; at < entries.y; at += STEP) {
            uint count = fetch(at, entries.y);
            for (uint k = 0; k < count; k++) {
                uint entry = fetched_entry(k);
                uint bits = entry & passing;
                bool backs = SOURCE_BACK && (bits & PAIR_BACK) != 0;
                uint bins = ((entry >> 3) - partner_page) * BINS;
                bool fronts = (bits & PAIR_FRONT) != 0, near = (bits & PAIR_NEAR) != 0;
                Facet source = fetched_facet(k);
                receive(receiver, source, k, bins, fronts, backs, near, sum);
            }
            reduce_scattered();
        }
        sum = total(sum);
        // Padding is within the horizon of everything, and fetches sources for the others.
        for (uint real_triangle = receiver.area > 0.0 ? 1 : 0; real_triangle > 0; real_triangle--) {
            if (lane_turn() == 0) {
                irradiance[j].rgb += sum;
            }
            flush_scattered((j - target_page) * BINS);
        }
    }
}
