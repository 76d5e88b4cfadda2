#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// K, specular part, of triangles that share a power: L(o) = σ N(p) Σ_b M(o,b) A(b) with M(o,b) = ⟨h(b,o), n⟩^p c_b, in
// which H(b) = c_b A(b). A lane computes LOBE_ROWS outgoing bins of one triangle. Twin: crates/reference/src/reflection.rs.

#include "surface.glsl"
#include "bins.glsl"
#define LOBES_BINDING 4
#include "lobe_rows.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 1) readonly buffer Surfaces { Surface surfaces[]; };
layout(std430, binding = 2) readonly buffer Incident { real incident[]; };
layout(scalar, binding = 2) readonly buffer IncidentRgb { real3 incident_rgb[]; };
layout(std430, binding = 3) buffer Specular { real specular[]; };
layout(scalar, binding = 3) buffer SpecularRgb { real3 specular_rgb[]; };

void main() {
    if (gl_GlobalInvocationID.x >= count) {
        return;
    }
    uint slot = lobe_slots[first + gl_GlobalInvocationID.x];
    uint bins = (slot - page) * BINS;
    uint row = first_row + gl_WorkGroupID.y * LOBE_ROWS;
    real3 sum[LOBE_ROWS];
    for (uint r = 0; r < LOBE_ROWS; r++) {
        sum[r] = real3(0.0);
    }
    for (uint b = begin; b < end; b++) {
        uint column = column_of(gl_WorkGroupID.y, b);
        real3 light = CHANNELS == 1 ? real3(incident[bins + b]) : incident_rgb[bins + b];
        for (uint r = 0; r < LOBE_ROWS; r++) {
            sum[r] += ENTRY(lobes, column, r) * light;
        }
    }
    real3 scale = surfaces[slot].specular;
    for (uint r = 0; r < LOBE_ROWS; r++) {
        uint o = bins + row + r;
        // No loop inside, which would keep this one from being unrolled and the sums from staying in registers.
        if (row + r < BINS && CHANNELS == 1) {
            specular[o] = (begin > 0 ? specular[o] : real(0.0)) + scale.r * sum[r].r;
        } else if (row + r < BINS) {
            specular_rgb[o] = (begin > 0 ? specular_rgb[o] : real3(0.0)) + scale * sum[r];
        }
    }
}
