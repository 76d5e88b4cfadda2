#version 450 core
#extension GL_GOOGLE_include_directive : require
// K, diffuse part, and E: L = emission · L_e + (δρ/π) E, W/(m² sr). Twin: crates/reference/src/reflection.rs.

#include "geometry.glsl"
#include "surface.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Surfaces { Surface surfaces[]; };
layout(std430, binding = 1) readonly buffer Irradiance { real4 irradiance[]; };
layout(std430, binding = 2) writeonly buffer Radiance { real4 radiance[]; };

layout(push_constant) uniform ReflectPush {
    uint count;
    // 1 with emission, 0 without.
    float emission;
    // 1 with reflection, 0 without.
    float reflection;
};

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < count) {
        Surface s = surfaces[i];
        real3 reflected = reflection > 0.0 ? s.diffuse * INV_PI * irradiance[i].rgb : real3(0.0);
        radiance[i] = real4(emission * s.emission + reflected, 0.0);
    }
}
