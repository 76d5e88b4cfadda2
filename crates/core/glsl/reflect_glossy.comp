#version 450 core
#extension GL_GOOGLE_include_directive : require
// K, specular part: L(o) = Σ_b σ N(p) ⟨h(b,o), n⟩^p H(b), per front bin of the glossy triangles of one page. A lane
// computes one outgoing bin of one triangle. Twin: crates/reference/src/reflection.rs.

#include "geometry.glsl"
#include "surface.glsl"
#include "bins.glsl"
#include "lobe.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Surfaces { Surface surfaces[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 1) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 2) readonly buffer Incident { real incident[]; };
layout(std430, binding = 3) writeonly buffer Specular { real specular[]; };
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
    real3 o = bin_table[pair % BINS].xyz;
    real3 sum = real3(0.0);
    // The lobes of padding, too, are black, and a small scene is mostly padding.
    uint incoming = reflects_specularly(s) ? BINS : 0;
    for (uint b = 0; b < incoming; b++) {
        uint from = (bins + b) * CHANNELS;
        sum += lobe(half_cosine(bin_table[b].xyz, o), s.power) * bin_table[b].w * (CHANNELS == 1 ? real3(incident[from])
                                     : real3(incident[from], incident[from + 1], incident[from + 2]));
    }
    uint at = bins + pair % BINS;
    for (uint c = 0; c < CHANNELS; c++) {
        specular[at * CHANNELS + c] = s.specular[c] * sum[c];
    }
}
