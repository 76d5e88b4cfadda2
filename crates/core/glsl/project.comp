#version 450 core
#extension GL_GOOGLE_include_directive : require
// A step of the Gram-Schmidt process: y <- y - h x, with h the product of which the dispatch before this wrote partial sums, or first of all
// y <- x - y; and partial sums of ⟨z, y⟩ with the new y. Each vector is read once. Which lane sums what, and in which order,
// depends on the vector's length and on the dispatch alone, so that results are the same from run to run.

#include "real.glsl"

layout(std430, binding = 0) readonly buffer X { real4 x[]; };
layout(std430, binding = 1) buffer Y { real4 y[]; };
layout(std430, binding = 2) readonly buffer Z { real4 z[]; };
// A sum for each lane: two slices, which dispatches write in turn. After them h by number, for the host.
layout(std430, binding = 3) buffer Partial { real partial[]; };

layout(push_constant) uniform ProjectPush {
    // Fours of reals.
    uint count;
    // 1 to add to the sums of an earlier dispatch of the same number.
    uint add;
    // 1 for ⟨y, y⟩; z is not read then.
    uint norm;
    // Dispatches before, but for those of other parts of the vector.
    uint number;
};

#include "total.glsl"

void main() {
    real a = number == 0 ? real(1.0) : -total(number - 1);
    real b = number == 0 ? real(-1.0) : real(1.0);
    real sum = 0.0;
    for (uint i = gl_GlobalInvocationID.x; i < count; i += LANES) {
        real4 value = a * x[i] + b * y[i];
        y[i] = value;
        real4 other = value;
        if (norm == 0) {
            other = z[i];
        }
        sum += dot(other, value);
    }
    uint at = (number & 1) * LANES + gl_GlobalInvocationID.x;
    partial[at] = add != 0 ? partial[at] + sum : sum;
}
