#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// y += M x, with M a block of the near field in sliced ELLPACK: a workgroup takes a slice, cooperative lanes one of its rows.
// U and its transpose are the same kernel over different matrices. Host side: crates/core/src/plan/near_matrix/sliced.rs.

#include "cooperative.glsl"

// Cooperative lanes of all rows of a slice.
layout(local_size_x_id = 0) in;
// 3, or 1 for a scene without colour.
layout(constant_id = 6) const uint CHANNELS = 3;
// Whether x, and y, are values per bin; otherwise they are one vec4 per slot.
layout(constant_id = 8) const bool FROM_BINS = false;
layout(constant_id = 9) const bool TO_BINS = false;

// Where each slice starts, in steps; then the end of the last. A step is an entry of each row.
layout(std430, binding = 0) readonly buffer Starts { uint starts[]; };
layout(std430, binding = 1) readonly buffer Rows { uint rows[]; };
layout(std430, binding = 2) readonly buffer Columns { uint columns[]; };
layout(std430, binding = 3) readonly buffer Weights { real weights[]; };
layout(std430, binding = 4) readonly buffer From { real from_grey[]; };
layout(scalar, binding = 4) readonly buffer FromRgb { real3 from_rgb[]; };
layout(std430, binding = 4) readonly buffer FromSlots { real4 from_slots[]; };
layout(std430, binding = 5) buffer To { real to_grey[]; };
layout(scalar, binding = 5) buffer ToRgb { real3 to_rgb[]; };
layout(std430, binding = 5) buffer ToSlots { real4 to_slots[]; };

layout(push_constant) uniform NearMatrixPush {
    // First slice; the workgroup's index counts from it.
    uint first_slice;
    // Of the steps of each slice, `take` after the first `skip`.
    uint skip;
    uint take;
};

// In place of a row where a slice has fewer.
const uint NO_ROW = 0xffffffffu;

real3 light(uint column) {
    if (!FROM_BINS) {
        return from_slots[column].rgb;
    }
    return CHANNELS == 1 ? real3(from_grey[column]) : from_rgb[column];
}

void main() {
    uint slice = first_slice + gl_WorkGroupID.x;
    uint row = rows[slice * TARGETS + lane_target()];
    uint end = starts[slice + 1];
    uint begin = min(starts[slice] + skip, end);
    end = min(begin + take, end);
    real3 sum = real3(0.0);
    for (uint step = begin + lane_turn(); step < end; step += COOPERATIVE) {
        uint at = step * TARGETS + lane_target();
        sum += weights[at] * light(columns[at]);
    }
    sum = total(sum);
    if (row != NO_ROW && lane_turn() == 0) {
        if (!TO_BINS) {
            to_slots[row].rgb += sum;
        } else if (CHANNELS == 1) {
            to_grey[row] += sum.r;
        } else {
            to_rgb[row] += sum;
        }
    }
}
