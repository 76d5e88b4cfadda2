#ifndef RECEIVER_LIST_GLSL
#define RECEIVER_LIST_GLSL
// Push constants of the kernels whose lanes own sources, clusters or triangles, and the walk along their receivers. SOURCES
// neighbouring sources have one list of lists: groups of LIST receivers, with what may pass from each of the sources. Where
// a lane owns a source and the workgroup is no wider than a group, each lane fetches one receiver into workgroup memory, from where
// all read it: CPU drivers read memory lane by lane. A wider one covers several groups, each with a list of its own, and lanes read
// receivers themselves; as they do where lanes share sources. Expects LANES; `facets`; `receiver_lists`: the index of the first word
// of each group, then the end of the last; then all entries, two words each, ascending in each group: the list, and 3 bits of each
// source; `targets`, the groups of a dispatch; and `cotangents`, those of irradiance.

#include "cooperative.glsl"
#include "passing.glsl"

// Receivers of a list, and sources of a group.
layout(constant_id = 12) const uint LIST = 32;
layout(constant_id = 14) const uint SOURCES = 8;

layout(push_constant) uniform ReceiversPush {
    // First of `targets`, from which the workgroup's index counts, and one past the last.
    uint target_begin;
    uint target_end;
    // Indices of the sources in range, from `source_begin` to before `source_end`, and the group of the first.
    uint source_begin;
    uint source_end;
    uint group_begin;
    // Lists, from `list_begin` to before `list_end`; others are skipped.
    uint list_begin;
    uint list_end;
    // Half of the near field's range in units of the characteristic areas: half_range · (s_i + s_j), area.
    float half_range;
    // First indices of the pages that are bound: bins of sources, radiance of sources, bins of receivers.
    uint target_page;
    uint radiance_page;
    uint partner_page;
    // Of the entries in range, `take` after the first `skip`.
    uint skip;
    uint take;
    // Index of the first cluster if the sources are clusters, otherwise 0.
    uint clusters;
    // Index of the first moment in the radiance that is bound, three for each cluster.
    uint moments;
};

const bool WIDE = !TARGETS_ARE_SHARED && LANES > SOURCES;
const bool FETCHES = !TARGETS_ARE_SHARED && !WIDE;
// Groups of a workgroup.
const uint GROUPS = WIDE ? LANES / SOURCES : 1;
// Receivers at a time.
const uint STEP = FETCHES ? LANES : LIST;
const uint FETCHED = FETCHES ? LANES : 1;

shared Facet fetched_facets[FETCHED];
shared real4 fetched_cotangents[FETCHED];

uint own_target() {
    return target_begin + gl_WorkGroupID.x * GROUPS + (WIDE ? gl_LocalInvocationID.x / SOURCES : 0);
}

// Which of the sources of a group this lane owns.
uint own_place() {
    return WIDE ? gl_LocalInvocationID.x % SOURCES : gl_WorkGroupID.y * TARGETS + lane_target();
}

// The group and the source of this lane: `source_end` or more if it is idle.
uint own_group() {
    return targets[min(own_target(), target_end - 1)];
}

uint own_source(uint group) {
    return own_target() < target_end ? source_begin + (group - group_begin) * SOURCES + own_place() : source_end;
}

// First word in a part of a group whose list is at least `list`, by bisection.
uint first_at_least(uint list, uint begin, uint end) {
    while (begin < end) {
        uint middle = begin + (end - begin) / 4 * 2;
        bool below = receiver_lists[middle] < list;
        begin = below ? middle + 2 : begin;
        end = below ? end : middle;
    }
    return begin;
}

// The words of a group in this dispatch.
uvec2 part_of_group(uint group) {
    uint end = receiver_lists[group + 1];
    uint begin = first_at_least(list_begin, receiver_lists[group], end);
    end = first_at_least(list_end, begin, end);
    begin = min(begin + 2 * skip, end);
    return uvec2(begin, min(begin + 2 * take, end));
}

// What may pass from the source of this lane to the list at a word.
uint own_bits(uint at, bool active_lane) {
    uint bits = receiver_lists[at + 1] >> (3 * own_place());
    return active_lane ? bits & (PAIR_FRONT | PAIR_BACK | PAIR_NEAR) : 0;
}

// Fetches STEP receivers from slot `first` on.
void fetch(uint first) {
    if (FETCHES) {
        uint lane = gl_LocalInvocationID.x;
        Facet facet = facets[first + lane];
        real4 cotangent = cotangents[first + lane];
        // Nobody reads the ones before any more.
        barrier();
        fetched_facets[lane] = facet;
        fetched_cotangents[lane] = cotangent;
        barrier();
    }
}

// One of them, and its cotangent.
Facet fetched_facet(uint first, uint k) {
    if (!FETCHES) {
        Facet facet = facets[first + k];
        return facet;
    }
    Facet facet = fetched_facets[k];
    return facet;
}

real3 fetched_cotangent(uint first, uint k) {
    return FETCHES ? fetched_cotangents[k].rgb : cotangents[first + k].rgb;
}

// Variance of the triangles of a source: clusters have it in place of the characteristic area, as they are never close.
real spread_of(Facet source) {
    return clusters != 0 ? source.characteristic_area : real(0.0);
}

#endif
