#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// Derivatives by the specular parameters of triangles that share a power: adds, per channel,
//     Σ_ob μ(o) ⟨h,n⟩^p H(b)   and   Σ_ob μ(o) ⟨h,n⟩^p ln⟨h,n⟩ H(b),
// from which the host computes ∂/∂σ and ∂/∂p. A lane owns a triangle; the rows are outgoing bins o.
// Twin: crates/reference/src/reflection.rs.

#include "surface.glsl"
#include "bins.glsl"
#define LOBES_BINDING 4
#include "lobe_rows.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 1) readonly buffer Incident { real incident[]; };
layout(scalar, binding = 1) readonly buffer IncidentRgb { real3 incident_rgb[]; };
layout(std430, binding = 2) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 2) readonly buffer SpecularRgb { real3 specular_rgb[]; };
// Two per slot.
layout(std430, binding = 3) buffer Sums { real4 sums[]; };
// ln⟨h,n⟩, in the order of `lobes`.
layout(std140, binding = LOBES_BINDING + 1) uniform Logarithms { real4 logarithms[QUARTERS]; };

void main() {
    if (gl_GlobalInvocationID.x >= count) {
        return;
    }
    uint slot = lobe_slots[first + gl_GlobalInvocationID.x];
    uint bins = (slot - page) * BINS;
    real3 sum = real3(0.0), sum_of_logarithms = real3(0.0);
    for (uint block = 0; block < blocks; block++) {
        real3 adjoint[LOBE_ROWS];
        for (uint r = 0; r < LOBE_ROWS; r++) {
            // The matrix is zero behind its last row, whatever that is multiplied by.
            uint o = bins + min(first_row + block * LOBE_ROWS + r, BINS - 1);
            adjoint[r] = CHANNELS == 1 ? real3(specular[o]) : specular_rgb[o];
        }
        for (uint b = begin; b < end; b++) {
            uint column = column_of(block, b);
            real3 spread = real3(0.0), spread_logarithms = real3(0.0);
            for (uint r = 0; r < LOBE_ROWS; r++) {
                real3 value = ENTRY(lobes, column, r) * adjoint[r];
                spread += value;
                spread_logarithms += ENTRY(logarithms, column, r) * value;
            }
            real3 light = CHANNELS == 1 ? real3(incident[bins + b]) : incident_rgb[bins + b];
            sum += spread * light;
            sum_of_logarithms += spread_logarithms * light;
        }
    }
    sums[2 * slot].rgb += sum;
    sums[2 * slot + 1].rgb += sum_of_logarithms;
}
