#version 450 core
#extension GL_GOOGLE_include_directive : require
// Derivatives by the specular parameters of each glossy triangle of a page: adds, per channel,
//     Σ_ob μ(o) ⟨h,n⟩^p H(b)   and   Σ_ob μ(o) ⟨h,n⟩^p ln⟨h,n⟩ H(b),
// from which the host computes ∂/∂σ and ∂/∂p. A lane owns a triangle; the outgoing bins o are those of this dispatch.
// Twin: crates/reference/src/reflection.rs.

#include "geometry.glsl"
#include "surface.glsl"
#include "bins.glsl"
#include "lobe.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Surfaces { Surface surfaces[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 1) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 2) readonly buffer Incident { real incident[]; };
layout(std430, binding = 3) readonly buffer Specular { real specular[]; };
// Two per slot.
layout(std430, binding = 4) buffer Sums { real4 sums[]; };
// Slots of the triangles by power.
layout(std430, binding = 5) readonly buffer LobeSlots { uint lobe_slots[]; };

layout(push_constant) uniform GlossyDerivativePush {
    // First slot of the page.
    uint page;
    // The triangles: `count` entries of `lobe_slots` from `list` on.
    uint list;
    uint count;
    // Outgoing bins, from `bin_begin` to before `bin_end`.
    uint bin_begin;
    uint bin_end;
};

real3 rgb(bool outgoing, uint at) {
    uint from = at * CHANNELS;
    uvec3 channel = CHANNELS == 1 ? uvec3(0) : uvec3(0, 1, 2);
    return outgoing ? real3(specular[from + channel.x], specular[from + channel.y], specular[from + channel.z])
                   : real3(incident[from + channel.x], incident[from + channel.y], incident[from + channel.z]);
}

void main() {
    if (gl_GlobalInvocationID.x >= count) {
        return;
    }
    uint slot = lobe_slots[list + gl_GlobalInvocationID.x];
    uint bins = (slot - page) * BINS;
    Surface s = surfaces[slot];
    real3 sum = real3(0.0), sum_of_logarithms = real3(0.0);
    for (uint o = bin_begin; o < bin_end; o++) {
        real3 adjoint = rgb(true, bins + o);
        real3 out_direction = bin_table[o].xyz;
        for (uint b = 0; b < BINS; b++) {
            real cosine = half_cosine(bin_table[b].xyz, out_direction);
            real3 value = lobe(cosine, s.power) * bin_table[b].w * adjoint * rgb(false, bins + b);
            sum += value;
            sum_of_logarithms += logarithm(cosine) * value;
        }
    }
    sums[2 * slot].rgb += sum;
    sums[2 * slot + 1].rgb += sum_of_logarithms;
}
