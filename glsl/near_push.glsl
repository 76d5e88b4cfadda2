#ifndef NEAR_PUSH_GLSL
#define NEAR_PUSH_GLSL
// What the kernels of close pairs are told. A lane owns a triangle, the receiver forwards and the source in the adjoint,
// and walks its list of close partners. Expects `near_targets`: slots of targets; `near_offsets`: of each slot, where its list
// starts in `near_others`, one entry more than there are slots; and `near_others`: slots, rising within each list.

layout(push_constant) uniform NearPush {
    // The first of `near_targets`, and how many of them.
    uint target_begin;
    uint targets;
    // Others of other slots are passed over.
    uint partner_begin;
    uint partner_end;
    float half_range;
    uint target_page;
    uint partner_page;
    // 1 where backs let antiradiance out, 0 in a pass of emission alone.
    uint backs;
    // Of the others in range, `take` after the first `skip`.
    uint skip;
    uint take;
};

// First index in a rising part of `near_others` whose slot is at least `slot`, by bisection.
uint first_at_least(uint slot, uint begin, uint end) {
    while (begin < end) {
        uint middle = (begin + end) / 2;
        bool below = near_others[middle] < slot;
        begin = below ? middle + 1 : begin;
        end = below ? end : middle;
    }
    return begin;
}

// The slot that this lane owns; that of the first lane if it is idle.
uint owned(bool active_lane) {
    return near_targets[active_lane ? target_begin + gl_GlobalInvocationID.x : target_begin];
}

// The part of its list that `target` walks in this dispatch; none if the lane is idle.
uvec2 close_others(uint target, bool active_lane) {
    uint end = near_offsets[target + 1];
    uint begin = first_at_least(partner_begin, near_offsets[target], end);
    end = first_at_least(partner_end, begin, end);
    begin = min(begin + skip, end);
    return uvec2(begin, active_lane ? min(begin + take, end) : begin);
}

#endif
