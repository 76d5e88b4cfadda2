#version 450 core
#extension GL_GOOGLE_include_directive : require
// y <- a x + b y over arrays of reals, four at a time. A grid-stride loop: any number of groups covers all elements, so
// the dispatch need not match the array. With b = 0, y is not read and may be undefined.

#include "real.glsl"

layout(local_size_x = 64, local_size_x_id = 0) in;

layout(std430, set = 0, binding = 0) readonly buffer X { real4 x[]; };
layout(std430, set = 0, binding = 1) buffer Y { real4 y[]; };

layout(push_constant) uniform Push {
    real a;
    real b;
    // Fours of reals.
    uint count;
};

void main() {
    uint stride = gl_NumWorkGroups.x * gl_WorkGroupSize.x;
    for (uint i = gl_GlobalInvocationID.x; i < count; i += stride) {
        y[i] = b == 0.0 ? a * x[i] : a * x[i] + b * y[i];
    }
}
