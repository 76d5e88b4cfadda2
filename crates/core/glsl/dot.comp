#version 450 core
#extension GL_GOOGLE_include_directive : require
// Partial sums of ⟨x, y⟩ over arrays of reals, four at a time, one sum per lane; the host adds them up in f64. Which lane
// sums what depends on `count` and on the dispatch alone, so that the result is the same from run to run.

#include "real.glsl"

layout(local_size_x = 64, local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer X { real4 x[]; };
layout(std430, binding = 1) readonly buffer Y { real4 y[]; };
layout(std430, binding = 2) buffer Partial { real partial[]; };

layout(push_constant) uniform DotPush {
    // Fours of reals.
    uint count;
    // 1 to add to the sums of an earlier dispatch.
    uint add;
};

void main() {
    uint stride = gl_NumWorkGroups.x * gl_WorkGroupSize.x;
    real sum = 0.0;
    for (uint i = gl_GlobalInvocationID.x; i < count; i += stride) {
        sum += dot(x[i], y[i]);
    }
    partial[gl_GlobalInvocationID.x] = add != 0 ? partial[gl_GlobalInvocationID.x] + sum : sum;
}
