#version 450 core
#extension GL_GOOGLE_include_directive : require
// K^T, specular part: λ(b) += Σ_o σ N(p) ⟨h(b,o), n⟩^p μ(o), from the cotangent μ of specular radiance to that of the
// irradiance H(b). A lane computes one bin of one triangle. Twin: crates/reference/src/reflection.rs.

#include "geometry.glsl"
#include "surface.glsl"
#include "bins.glsl"
#include "lobe.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Surfaces { Surface surfaces[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 1) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 2) readonly buffer Specular { real specular[]; };
layout(std430, binding = 3) buffer Cotangent { real cotangent[]; };
// Slots of the triangles by power.
layout(std430, binding = 4) readonly buffer LobeSlots { uint lobe_slots[]; };

layout(push_constant) uniform GlossyPush {
    // First slot of the page.
    uint page;
    // The triangles are those of `lobe_slots` from here on.
    uint list;
    // Pairs of such a triangle and a bin, from `first` on.
    uint first;
    uint count;
};

void main() {
    if (gl_GlobalInvocationID.x >= count) {
        return;
    }
    uint pair = first + gl_GlobalInvocationID.x;
    uint slot = lobe_slots[list + pair / BINS];
    uint bins = (slot - page) * BINS;
    Surface s = surfaces[slot];
    // The lobes of padding, too, are black, and a small scene is mostly padding.
    if (!reflects_specularly(s)) {
        return;
    }
    real3 b = bin_table[pair % BINS].xyz;
    real3 sum = real3(0.0);
    for (uint o = 0; o < BINS; o++) {
        uint from = (bins + o) * CHANNELS;
        sum += lobe(half_cosine(bin_table[o].xyz, b), s.power)
            * (CHANNELS == 1 ? real3(specular[from])
                             : real3(specular[from], specular[from + 1], specular[from + 2]));
    }
    uint at = bins + pair % BINS;
    for (uint c = 0; c < CHANNELS; c++) {
        cotangent[at * CHANNELS + c] += s.specular[c] * sum[c];
    }
}
