#version 450 core
#extension GL_GOOGLE_include_directive : require
// y <- a x + b y, as by combine.comp, and partial sums of ⟨z, y⟩ with the new y, as by dot.comp: a step of the
// Gram-Schmidt process reads each vector once.

#include "real.glsl"

layout(local_size_x = 64, local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer X { real4 x[]; };
layout(std430, binding = 1) buffer Y { real4 y[]; };
layout(std430, binding = 2) readonly buffer Z { real4 z[]; };
layout(std430, binding = 3) buffer Partial { real partial[]; };

layout(push_constant) uniform Push {
    real a;
    real b;
    // Fours of reals.
    uint count;
    // 1 to add to the sums of an earlier dispatch.
    uint add;
    // 1 for ⟨y, y⟩; z is not read then.
    uint norm;
};

void main() {
    uint stride = gl_NumWorkGroups.x * gl_WorkGroupSize.x;
    real sum = 0.0;
    for (uint i = gl_GlobalInvocationID.x; i < count; i += stride) {
        real4 value = a * x[i] + b * y[i];
        y[i] = value;
        real4 other = value;
        if (norm == 0) {
            other = z[i];
        }
        sum += dot(other, value);
    }
    partial[gl_GlobalInvocationID.x] = add != 0 ? partial[gl_GlobalInvocationID.x] + sum : sum;
}
