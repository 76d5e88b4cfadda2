#ifndef COOPERATIVE_GLSL
#define COOPERATIVE_GLSL
// Which targets the lanes of a workgroup accumulate sums of, and which partners they take. On CPU drivers a lane owns a target, and
// walks along all its partners. On GPUs COOPERATIVE lanes share a target, and each takes one partner in so many, where targets have bins,
// as a set for each lane would not fit a GPU's registers, and where there are too few targets for a lane each.

#include "real.glsl"

// Lanes of the workgroup: as a constant of its own, since Metal takes gl_WorkGroupSize for no constant size of an array.
layout(constant_id = 13) const uint WORKGROUP = 1;
// Lanes that share a target: 1, or a power of two from 4 on; at least 8 where targets have bins, at most 16 for close pairs.
layout(constant_id = 15) const uint COOPERATIVE = 1;

const bool TARGETS_ARE_SHARED = COOPERATIVE > 1;
const uint TARGETS = WORKGROUP / COOPERATIVE;

// Which of the workgroup's targets is that of a lane. Neighbouring lanes read the same partner.
uint lane_target() {
    return TARGETS_ARE_SHARED ? gl_LocalInvocationID.x % TARGETS : gl_LocalInvocationID.x;
}

// The first partner of a lane.
uint lane_turn() {
    return TARGETS_ARE_SHARED ? gl_LocalInvocationID.x / TARGETS : 0;
}

shared uint vote;
const uint SUMMANDS = TARGETS_ARE_SHARED ? 3 * WORKGROUP : 1;
shared real summands[SUMMANDS];

// Whether `own` is true for any lane that must go on together with this one. All lanes must call it.
bool any_cooperative(bool own) {
    if (TARGETS_ARE_SHARED) {
        // Nobody reads the one before any more.
        barrier();
        if (gl_LocalInvocationID.x == 0) {
            vote = 0;
        }
        barrier();
        // The same outcome in every order of the lanes.
        if (own) {
            atomicOr(vote, 1);
        }
        barrier();
        return vote != 0;
    }
    return own;
}

// The sum over the lanes that share a target, in the order of their turns. All lanes must call it.
real3 total(real3 own) {
    if (TARGETS_ARE_SHARED) {
        uint lane = gl_LocalInvocationID.x;
        barrier();
        for (uint channel = 0; channel < 3; channel++) {
            summands[3 * lane + channel] = own[channel];
        }
        barrier();
        real3 sum = real3(0.0);
        for (uint turn = 0; turn < COOPERATIVE; turn++) {
            uint of = 3 * (turn * TARGETS + lane_target());
            sum += real3(summands[of], summands[of + 1], summands[of + 2]);
        }
        return sum;
    }
    return own;
}

#endif
