#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// The derivative of the radiance of glossy triangles of one group towards the camera, times its cotangent, with
// respect to their geometry and to the camera position; the latter overwrites the cotangent. Twin:
// crates/reference/src/observation.rs.

#include "geometry.glsl"
#include "bins_slope.glsl"
#include "facet_gradient.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) buffer Colours { real4 colours[]; };
layout(scalar, binding = 2) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(std430, binding = 3) buffer Gradients { FacetGradient gradients[]; };

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
        real3 adjoint = colours[i].rgb;
        real3 by_camera = real3(0.0), by_normal = real3(0.0);
        for (uint once = dot(to_camera, f.normal) > 0.0 ? 1 : 0; once > 0; once--) {
            real r = length(to_camera);
            real3 direction = to_camera / r;
            real3 local = in_frame(f.normal, direction);
            Taps t = taps(local);
            real4 value;
            for (uint tap = 0; tap < 4; tap++) {
                value[tap] = dot(specular_rgb[(i - begin) * BINS + t.bin[tap]], adjoint);
            }
            real3 by_local = taps_gradient(local, t, value);
            real3 by_direction = orthonormal_basis(f.normal) * by_local;
            by_camera = (by_direction - direction * dot(direction, by_direction)) / r;
            by_normal = frame_gradient(f.normal, direction, by_local);
        }
        colours[i] = real4(by_camera, 0.0);
        real3 by_corner = by_camera * (real(1.0) / 3.0);
        gradients[i].a -= by_corner;
        gradients[i].b -= by_corner;
        gradients[i].c -= by_corner;
        gradients[i].normal += by_normal;
    }
}
