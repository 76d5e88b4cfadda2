#ifndef LOBE_ROWS_GLSL
#define LOBE_ROWS_GLSL
// Rows of the matrix of a lobe, for triangles that share a power: LOBE_ROWS rows of it, by column, of which a dispatch covers
// as many as a uniform buffer holds. All lanes read the same entry at a time. Expects LOBES_BINDING.

// As many sums of three channels as a lane accumulates without much spilling.
const uint LOBE_ROWS = 16;

// 64 KiB, the uniform buffer size of common devices.
#ifdef F64
const uint QUARTERS = 2048;
#else
const uint QUARTERS = 4096;
#endif

// Four rows of a column each.
layout(std140, binding = LOBES_BINDING) uniform Lobes { real4 lobes[QUARTERS]; };
// Slots of the triangles by power.
layout(std430, binding = 0) readonly buffer LobeSlots { uint lobe_slots[]; };

layout(push_constant) uniform LobePush {
    // First slot of the page.
    uint page;
    // Triangles of this dispatch: `count` entries of `lobe_slots` from `first` on.
    uint first;
    uint count;
    // First row of the matrix.
    uint row;
    // Columns, from `begin` to before `end`.
    uint begin;
    uint end;
};

// Entry of a row from `row` on, of a column from `begin` on; zero behind the last row.
real entry(uint r, uint column) {
    return lobes[(column - begin) * (LOBE_ROWS / 4) + r / 4][r % 4];
}

#endif
