#ifndef FAR_PUSH_GLSL
#define FAR_PUSH_GLSL
// Push constants of the point-to-point kernels, and runs of partner tiles with the same bits. A lane owns a target, or shares it,
// the receiver forwards and the source in the adjoint, and sums over its partners. Expects `far_runs` of the targets:
// the index of the first run of each tile, then the end of the last; then all runs, `end << 4 | bits`. A run begins
// at the end of the one before, the first one at tile 0, and ends before tile `end`.

#include "passing.glsl"

layout(push_constant) uniform FarPush {
    // First tile of targets; the workgroup's index counts from it.
    uint target_tile;
    // Tiles of partners, from `partner_begin` to before `partner_end`.
    uint partner_begin;
    uint partner_end;
    // Half of the near field's range in units of the characteristic areas: half_range · (s_i + s_j), area.
    float half_range;
    // First slots of the pages that are bound.
    uint target_page;
    uint partner_page;
    // Bits to consider: without PAIR_BACK in a pass of emission alone.
    uint passing;
};

// The run of a target tile that contains the partner tile `first`, by bisection.
uint first_run(uint target, uint first) {
    uint begin = far_runs[target];
    uint end = far_runs[target + 1];
    while (begin < end) {
        uint middle = (begin + end) / 2;
        bool before = far_runs[middle] >> 4 <= first;
        begin = before ? middle + 1 : begin;
        end = before ? end : middle;
    }
    return begin;
}

// The end of a run within this dispatch, and its bits.
uint run_end(uint run) {
    return min(far_runs[run] >> 4, partner_end);
}

uint run_flags(uint run) {
    return far_runs[run] & passing;
}

#endif
