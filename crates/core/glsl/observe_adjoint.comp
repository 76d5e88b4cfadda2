#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// S^T: adds the cotangent of each triangle's radiance towards the camera to that of its outgoing light, for one
// group, fronts only. Twin: crates/reference/src/observation.rs.

#include "geometry.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 8) const bool SOURCE_FRONT = false;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Colours { real4 colours[]; };
layout(std430, binding = 2) buffer Radiance { real4 radiance[]; };
layout(std430, binding = 3) buffer Specular { real specular[]; };

layout(push_constant) uniform ObservePush {
    real3 camera_position;
    // Slots of the group, from `begin` to before `end`.
    uint begin;
    uint end;
};

void main() {
    uint i = begin + gl_GlobalInvocationID.x;
    if (i < end) {
        Facet f = facets[i];
        real3 to_camera = camera_position - f.centre;
        bool seen = dot(to_camera, f.normal) > 0.0;
        real3 colour = seen ? colours[i].rgb : real3(0.0);
        radiance[i].rgb += colour;
        for (uint once = SOURCE_FRONT && seen ? 1 : 0; once > 0; once--) {
            real3 direction = to_camera * inversesqrt(max(dot(to_camera, to_camera), R2_MIN));
            Taps t = taps(in_frame(f.normal, direction));
            for (uint tap = 0; tap < 4; tap++) {
                uint at = ((i - begin) * BINS + t.bin[tap]) * CHANNELS;
                for (uint c = 0; c < CHANNELS; c++) {
                    specular[at + c] += t.weight[tap] * colour[c];
                }
            }
        }
    }
}
