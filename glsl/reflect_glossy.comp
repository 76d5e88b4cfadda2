#version 450 core
#extension GL_GOOGLE_include_directive : require
// K, specular part: L(o) = Σ_b σ N(p) ⟨h(b,o), n⟩^p H(b), per front bin of the glossy triangles of one page. A lane makes
// one outgoing bin of one triangle. Twin: src/reference/reflection.rs.

#include "geometry.glsl"
#include "surface.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Surfaces { Surface surfaces[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 1) readonly buffer BinTable { vec4 bin_table[]; };
layout(std430, binding = 2) readonly buffer Arriving { float arriving[]; };
layout(std430, binding = 3) writeonly buffer Specular { float specular[]; };

layout(push_constant) uniform GlossyPush {
    // First slot of the page.
    uint page;
    // Pairs of triangle and bin of the page, from `first` on.
    uint first;
    uint count;
};

void main() {
    if (gl_GlobalInvocationID.x >= count) {
        return;
    }
    uint at = first + gl_GlobalInvocationID.x;
    uint triangle = at / BINS;
    Surface s = surfaces[page + triangle];
    vec3 o = bin_table[at % BINS].xyz;
    vec3 sum = vec3(0.0);
    for (uint b = 0; b < BINS; b++) {
        // ⟨h, n⟩ is the z of the half vector. pow(0, 0) is undefined: a lobe of power 0 is 1 everywhere.
        vec3 h = bin_table[b].xyz + o;
        float cosine = h.z * inversesqrt(max(dot(h, h), 1e-20));
        float lobe = s.power > 0.0 ? pow(max(cosine, 1e-20), s.power) : 1.0;
        uint from = (triangle * BINS + b) * CHANNELS;
        sum += lobe * bin_table[b].w * (CHANNELS == 1 ? vec3(arriving[from])
                                     : vec3(arriving[from], arriving[from + 1], arriving[from + 2]));
    }
    for (uint c = 0; c < CHANNELS; c++) {
        specular[at * CHANNELS + c] = s.specular[c] * sum[c];
    }
}
