#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// Writes half bins (glsl/half_bins.glsl). A row of workgroups converts a triangle, a lane one bin. Twin:
// src/reference/bf16.rs.

layout(local_size_x_id = 0) in;
// As in bins.glsl.
layout(constant_id = 4) const uint ROWS = 10;
layout(constant_id = 5) const uint COLUMNS = 13;
const uint BINS = ROWS * COLUMNS;

layout(scalar, binding = 0) readonly buffer Bins { vec3 bins_rgb[]; };
layout(scalar, binding = 1) writeonly buffer HalfBins { uvec3 half_bins_rgb[]; };

layout(push_constant) uniform PackPush {
    // First triangle of the page to convert.
    uint first;
};

// Rounded to eight significant bits, ties to even, in the upper half of a word.
uvec3 upper_half(vec3 value) {
    uvec3 bits = floatBitsToUint(value);
    return (bits + 0x7fff + (bits >> 16 & 1)) & 0xffff0000;
}

void main() {
    uint bin = gl_GlobalInvocationID.x;
    if (bin < BINS) {
        uint next = bin % COLUMNS == COLUMNS - 1 ? bin - (COLUMNS - 1) : bin + 1;
        uint from = (first + gl_WorkGroupID.y) * BINS;
        half_bins_rgb[gl_WorkGroupID.y * BINS + bin] = upper_half(bins_rgb[from + bin]) | upper_half(bins_rgb[from + next]) >> 16;
    }
}
