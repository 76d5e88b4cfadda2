#ifndef NEAR_PUSH_GLSL
#define NEAR_PUSH_GLSL
// Push constants of the near-field kernels. A lane owns a target, or shares it (cooperative.glsl), the receiver forwards and the source in the
// adjoint, and sums over its close partners. Expects `near_targets`: slots of targets; `near_offsets`: the start of
// each slot's list in `near_partners`, then the end of the last; and `near_partners`: slots, ascending within each
// list.

#include "cooperative.glsl"

layout(push_constant) uniform NearPush {
    // The first of `near_targets`, and their number.
    uint target_begin;
    uint targets;
    // Slots of partners, from `partner_begin` to before `partner_end`; others are skipped.
    uint partner_begin;
    uint partner_end;
    float half_range;
    uint target_page;
    uint partner_page;
    // 1 if backs emit antiradiance, 0 in a pass of emission alone.
    uint backs;
    // Of the partners in range, `take` after the first `skip`.
    uint skip;
    uint take;
};

// First index in an ascending part of `near_partners` whose slot is at least `slot`, by bisection.
uint first_at_least(uint slot, uint begin, uint end) {
    while (begin < end) {
        uint middle = (begin + end) / 2;
        bool below = near_partners[middle] < slot;
        begin = below ? middle + 1 : begin;
        end = below ? end : middle;
    }
    return begin;
}

// Which target is that of this lane; `targets` or more if it is idle.
uint own_number() {
    return gl_WorkGroupID.x * TARGETS + lane_target();
}

// Its slot; that of the first if the lane is idle.
uint owned(bool active_lane) {
    return near_targets[active_lane ? target_begin + own_number() : target_begin];
}

// The part of the list of `target` in this dispatch; empty if the lane is idle.
uvec2 close_partners(uint target, bool active_lane) {
    uint end = near_offsets[target + 1];
    uint begin = first_at_least(partner_begin, near_offsets[target], end);
    end = first_at_least(partner_end, begin, end);
    begin = min(begin + skip, end);
    return uvec2(begin, active_lane ? min(begin + take, end) : begin);
}

#endif
