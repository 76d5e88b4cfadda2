#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// S: the radiance of each triangle of one group towards the camera, L_i(direction to the camera), fronts only. Twin:
// crates/reference/src/observation.rs.

#include "geometry.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 2) readonly buffer Antiradiance { real antiradiance[]; };
layout(scalar, binding = 2) readonly buffer AntiradianceRgb { real3 antiradiance_rgb[]; };
layout(std430, binding = 3) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 3) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(std430, binding = 4) writeonly buffer Colours { real4 colours[]; };

layout(push_constant) uniform ObservePush {
    real3 camera_position;
    // Slots of the group, from `begin` to before `end`.
    uint begin;
    uint end;
};

#include "source_bins.glsl"

void main() {
    uint i = begin + gl_GlobalInvocationID.x;
    if (i < end) {
        Facet f = facets[i];
        real3 to_camera = camera_position - f.centre;
        real3 direction = to_camera * inversesqrt(max(dot(to_camera, to_camera), R2_MIN));
        real3 colour = radiance[i].rgb + binned_radiance(f.normal, (i - begin) * BINS, direction, true);
        colours[i] = real4(dot(to_camera, f.normal) > 0.0 ? colour : real3(0.0), 0.0);
    }
}
