#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// S: the radiance each triangle of one group sends to the eye, L_i(direction to the eye), fronts only.
// Twin: src/reference/observation.rs.

#include "geometry.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Radiance { vec4 radiance[]; };
layout(std430, binding = 2) readonly buffer Antiradiance { float antiradiance[]; };
layout(scalar, binding = 2) readonly buffer AntiradianceRgb { vec3 antiradiance_rgb[]; };
layout(std430, binding = 3) readonly buffer Specular { float specular[]; };
layout(scalar, binding = 3) readonly buffer SpecularRgb { vec3 specular_rgb[]; };
layout(std430, binding = 4) writeonly buffer Colours { vec4 colours[]; };

layout(push_constant) uniform ObservePush {
    vec3 eye;
    // Slots of the group, from `begin` to before `end`.
    uint begin;
    uint end;
};

#include "source_bins.glsl"

void main() {
    uint i = begin + gl_GlobalInvocationID.x;
    if (i < end) {
        Facet f = facets[i];
        vec3 to_eye = eye - f.centre;
        vec3 direction = to_eye * inversesqrt(max(dot(to_eye, to_eye), R2_MIN));
        vec3 colour = radiance[i].rgb + binned_radiance(f.normal, (i - begin) * BINS, direction, true);
        colours[i] = vec4(dot(to_eye, f.normal) > 0.0 ? colour : vec3(0.0), 0.0);
    }
}
