#version 450 core
#extension GL_GOOGLE_include_directive : require
// Adds the light of lamps that glossy triangles reflect, which is known per outgoing bin, to their specular radiance.

#include "real.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer FirstBounce { real first_bounce[]; };
layout(std430, binding = 1) buffer Specular { real specular[]; };

layout(push_constant) uniform FirstBouncePush {
    // The first value for the piece.
    uint offset;
    uint count;
    // 1 to add to what is there, 0 to replace it.
    uint add;
};

void main() {
    uint stride = gl_NumWorkGroups.x * gl_WorkGroupSize.x;
    for (uint i = gl_GlobalInvocationID.x; i < count; i += stride) {
        specular[i] = first_bounce[offset + i] + (add == 1 ? specular[i] : real(0.0));
    }
}
