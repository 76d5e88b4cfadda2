#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// K^T, specular part, of triangles that share a power: λ(b) += σ N(p) Σ_o ⟨h(b,o), n⟩^p μ(o), from the cotangent μ of
// specular radiance to that of the irradiance H(b). A lane computes LOBE_ROWS bins b of one triangle.
// Twin: crates/reference/src/reflection.rs.

#include "surface.glsl"
#include "bins.glsl"
#define LOBES_BINDING 4
#include "lobe_rows.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 1) readonly buffer Surfaces { Surface surfaces[]; };
layout(std430, binding = 2) readonly buffer Specular { real specular[]; };
layout(scalar, binding = 2) readonly buffer SpecularRgb { real3 specular_rgb[]; };
layout(std430, binding = 3) buffer Cotangent { real cotangent[]; };
layout(scalar, binding = 3) buffer CotangentRgb { real3 cotangent_rgb[]; };

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
    for (uint o = begin; o < end; o++) {
        uint column = column_of(gl_WorkGroupID.y, o);
        real3 adjoint = CHANNELS == 1 ? real3(specular[bins + o]) : specular_rgb[bins + o];
        for (uint r = 0; r < LOBE_ROWS; r++) {
            sum[r] += ENTRY(lobes, column, r) * adjoint;
        }
    }
    real3 scale = surfaces[slot].specular;
    for (uint r = 0; r < LOBE_ROWS; r++) {
        uint b = bins + row + r;
        // No loop inside, which would keep this one from being unrolled and the sums from staying in registers.
        if (row + r < BINS && CHANNELS == 1) {
            cotangent[b] += scale.r * sum[r].r;
        } else if (row + r < BINS) {
            cotangent_rgb[b] += scale * sum[r];
        }
    }
}
