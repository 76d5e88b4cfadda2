#version 450 core
#extension GL_GOOGLE_include_directive : require
// The end of a step of the Gram-Schmidt process: y <- y / ‖y‖, or 0 where that is no larger than `spanned`.

#include "real.glsl"

layout(std430, binding = 0) buffer Y { real4 y[]; };
// As of project.comp.
layout(std430, binding = 1) buffer Partial { real partial[]; };

layout(push_constant) uniform Push {
    real spanned;
    // ⟨y, y⟩ if `number` is 0.
    real square;
    // Fours of reals.
    uint count;
    // Dispatches of project.comp before, of which the last has summed up ⟨y, y⟩; 0 if the host knows it.
    uint number;
};

#include "total.glsl"

void main() {
    // The host does not compute the factor, whose last bit may depend on who takes the root.
    real norm = sqrt(number == 0 ? square : total(number - 1));
    real factor = norm <= spanned ? real(0.0) : real(1.0) / norm;
    for (uint i = gl_GlobalInvocationID.x; i < count; i += LANES) {
        y[i] = factor * y[i];
    }
}
