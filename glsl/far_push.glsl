#ifndef FAR_PUSH_GLSL
#define FAR_PUSH_GLSL
// What the point-to-point kernels are told, and the runs of tiles between which the same may pass. A lane owns a triangle,
// the receiver forwards and the source in the adjoint, and walks over the others. Expects `far_runs`, those of the targets:
// for each tile of them the index of its first run, one entry more than there are tiles; then all runs, `end << 4 | bits`,
// where a run goes from the end of the one before, or the first tile of all, to before tile `end`.

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
    // What may pass: PAIR_BACK is left out in a pass of emission alone.
    uint passing;
};

const uint PAIR_FRONT = 1;
const uint PAIR_BACK = 2;
const uint PAIR_NEAR = 4;

// The run of a target's tile in which the other tile `first` lies, by bisection.
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

// The end of a run within this dispatch, and what may pass in it.
uint run_end(uint run) {
    return min(far_runs[run] >> 4, partner_end);
}

uint run_flags(uint run) {
    return far_runs[run] & passing;
}

#endif
