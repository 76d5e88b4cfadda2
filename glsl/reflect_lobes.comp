#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// K, specular part, of triangles that share a power: L(o) = σ N(p) Σ_b M(o,b) A(b) with M(o,b) = ⟨h(b,o), n⟩^p c_b, in
// which H(b) = c_b A(b). A lane computes LOBE_ROWS outgoing bins of one triangle. Twin: src/reference/reflection.rs.

#include "surface.glsl"
#include "bins.glsl"
#define LOBES_BINDING 4
#include "lobe_rows.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 1) readonly buffer Surfaces { Surface surfaces[]; };
layout(std430, binding = 2) readonly buffer Incident { real incident[]; };
layout(scalar, binding = 2) readonly buffer IncidentRgb { real3 incident_rgb[]; };
layout(std430, binding = 3) buffer Specular { real specular[]; };

void main() {
    if (gl_GlobalInvocationID.x >= count) {
        return;
    }
    uint slot = lobe_slots[first + gl_GlobalInvocationID.x];
    uint bins = (slot - page) * BINS;
    real3 sum[LOBE_ROWS];
    for (uint r = 0; r < LOBE_ROWS; r++) {
        sum[r] = real3(0.0);
    }
    for (uint b = begin; b < end; b++) {
        real3 light = CHANNELS == 1 ? real3(incident[bins + b]) : incident_rgb[bins + b];
        for (uint r = 0; r < LOBE_ROWS; r++) {
            sum[r] += entry(r, b) * light;
        }
    }
    real3 scale = surfaces[slot].specular;
    for (uint r = 0; r < LOBE_ROWS; r++) {
        for (uint c = 0; row + r < BINS && c < CHANNELS; c++) {
            uint at = (bins + row + r) * CHANNELS + c;
            specular[at] = (begin > 0 ? specular[at] : real(0.0)) + scale[c] * sum[r][c];
        }
    }
}
