#ifndef LOBE_ROWS_GLSL
#define LOBE_ROWS_GLSL
// The matrix of a lobe, for triangles that share a power: blocks of LOBE_ROWS rows, each by column. A dispatch covers as
// many blocks as a uniform buffer holds, or a part of the columns of one. All lanes of a workgroup read the same entry at
// a time. Expects LOBES_BINDING and bins.glsl.

// As many sums of three channels as a lane accumulates without much spilling.
const uint LOBE_ROWS = 16;

// 64 KiB, the uniform buffer size of common devices.
#ifdef F64
const uint QUARTERS = 2048;
#else
const uint QUARTERS = 4096;
#endif

// Four entries of a column each. A block has a multiple of four columns.
layout(std140, binding = LOBES_BINDING) uniform Lobes { real4 lobes[QUARTERS]; };
// Slots of the triangles by power.
layout(std430, binding = 0) readonly buffer LobeSlots { uint lobe_slots[]; };

layout(push_constant) uniform LobePush {
    // First slot of the page.
    uint page;
    // Triangles of this dispatch: `count` entries of `lobe_slots` from `first` on.
    uint first;
    uint count;
    // First row of the first block.
    uint first_row;
    // Blocks of rows.
    uint blocks;
    // Columns, from `begin` to before `end`.
    uint begin;
    uint end;
};

// Where a column of a block is in `lobes`.
uint column_of(uint block, uint column) {
    const uint columns = (BINS + 3) / 4 * 4;
    return (block * columns + column - begin) * (LOBE_ROWS / 4);
}

// Entry r of a column; zero behind the last row of the matrix.
#define ENTRY(matrix, column, r) matrix[(column) + (r) / 4][(r) % 4]

#endif
