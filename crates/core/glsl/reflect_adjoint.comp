#version 450 core
#extension GL_GOOGLE_include_directive : require
// K^T, diffuse part: λ = given · λ_0 + (δρ/π) μ, from the cotangent μ of radiance. λ_0 is the cotangent of irradiance
// given by the loss. Twin: crates/reference/src/reflection.rs.

#include "geometry.glsl"
#include "surface.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Surfaces { Surface surfaces[]; };
layout(std430, binding = 1) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 2) readonly buffer Given { real4 given_irradiance[]; };
layout(std430, binding = 3) writeonly buffer Irradiance { real4 irradiance[]; };

layout(push_constant) uniform ReflectAdjointPush {
    uint count;
    // 1 with λ_0, 0 without.
    float given;
};

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < count) {
        real3 reflected = surfaces[i].diffuse * INV_PI * radiance[i].rgb;
        irradiance[i] = real4(real(given) * given_irradiance[i].rgb + reflected, 0.0);
    }
}
