#version 450 core
#extension GL_GOOGLE_include_directive : require
// J: A(b) = H(b) / c_b leaves the back of the blockers of one page, W/(m² sr). Twin: src/reference/go_through.rs.

#include "geometry.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer BinTable { vec4 bin_table[]; };
layout(std430, binding = 1) readonly buffer Arriving { float arriving[]; };
layout(std430, binding = 2) writeonly buffer Antiradiance { float antiradiance[]; };

layout(push_constant) uniform ThroughPush {
    // Floats of the page.
    uint count;
};

void main() {
    uint stride = gl_NumWorkGroups.x * gl_WorkGroupSize.x;
    for (uint at = gl_GlobalInvocationID.x; at < count; at += stride) {
        antiradiance[at] = arriving[at] / bin_table[at / CHANNELS % BINS].w;
    }
}
