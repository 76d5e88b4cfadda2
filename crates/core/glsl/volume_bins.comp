#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// Adds to the bins of volumes what their triangles in one page send: in the direction ω of each bin of either hemisphere around z,
//     I(ω) / ā,  I(ω) = Σ a_i |⟨n_i, ω⟩| (front: L_i(ω); back: -A_i(-ω)),
// and below the horizon the negative, as antiradiance of the opposite direction. A workgroup owns a volume.
// Twin: crates/reference/src/clusters.rs.

#include "geometry.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
// Of each volume, where its slots begin and end.
layout(std430, binding = 1) readonly buffer Parts { uvec2 parts[]; };
layout(std430, binding = 2) readonly buffer Slots { uint slots[]; };
layout(std430, binding = 3) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { real3 specular_rgb[]; };
// Centre of each bin, and c_b.
layout(std430, binding = 6) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 7) buffer Below { real below[]; };
layout(std430, binding = 8) buffer Above { real above[]; };

#include "source_bins.glsl"

layout(push_constant) uniform VolumePush {
    // Index of the first volume of this dispatch, and of all.
    uint begin;
    uint volumes;
    // The triangles of the page: slots from `slot_begin` to before `slot_end`.
    uint slot_begin;
    uint slot_end;
    // 1 if their backs send antiradiance.
    uint backs;
};

void main() {
    uint v = begin + gl_WorkGroupID.x;
    uvec2 of = parts[v - volumes];
    real per_area = 1.0 / facets[v].area;
    for (uint bin = gl_LocalInvocationID.x; bin < BINS; bin += gl_WorkGroupSize.x) {
        real3 centre = bin_table[bin].xyz;
        real3 up = real3(0.0), down = real3(0.0);
        for (uint at = of.x; at < of.y; at++) {
            uint slot = slots[at];
            // A loop, to skip it for triangles of other pages.
            for (uint once = slot >= slot_begin && slot < slot_end ? 1 : 0; once > 0; once--) {
                Facet own = facets[slot];
                real cosine = dot(own.normal, centre);
                real3 direction = cosine > 0.0 ? centre : -centre;
                uint first = (slot - slot_begin) * BINS;
                real seen = abs(cosine) * own.area;
                real3 front = seen * (radiance[slot].rgb + binned_radiance(own.normal, first, direction, true));
                real3 back = real3(0.0);
                for (uint behind = backs; behind > 0; behind--) {
                    back = seen * binned_radiance(own.normal, first, -direction, false);
                }
                up += cosine > 0.0 ? front : back;
                down += cosine > 0.0 ? back : front;
            }
        }
        uint to = ((v - volumes) * BINS + bin) * CHANNELS;
        for (uint c = 0; c < CHANNELS; c++) {
            above[to + c] += up[c] * per_area;
            below[to + c] -= down[c] * per_area;
        }
    }
}
