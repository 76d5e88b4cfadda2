#ifndef FAR_LIST_GLSL
#define FAR_LIST_GLSL
// Push constants of the kernels that sum over lists of sources, clusters and triangles, and the walk along a list, which the
// receivers of a workgroup share. Where a lane owns a receiver, each lane of a workgroup fetches one source into
// workgroup memory, from where all read it: CPU drivers read memory lane by lane. Where lanes share receivers, each reads the source
// that it takes. Expects LANES, `facets`, `radiance`, and `far_lists`: the index of the first entry of each list, then the end of the
// last; then all entries, `index << 3 | bits`, ascending in each list.

#include "cooperative.glsl"
#include "passing.glsl"
#include "moment.glsl"

// Receivers of a list.
layout(constant_id = 12) const uint LIST = 32;

layout(push_constant) uniform ListPush {
    // First list; the workgroup's index counts from it.
    uint target_list;
    // Indices of sources, from `partner_begin` to before `partner_end`; others are skipped.
    uint partner_begin;
    uint partner_end;
    // Half of the near field's range in units of the characteristic areas: half_range · (s_i + s_j), area.
    float half_range;
    // First indices of the pages that are bound.
    uint target_page;
    uint partner_page;
    // Bits to consider: without PAIR_BACK in a pass of emission alone.
    uint passing;
    // Of the sources in range, `take` after the first `skip`.
    uint skip;
    uint take;
    // Index of the first cluster if the sources are clusters, otherwise 0.
    uint clusters;
    // Index of the first moment in `radiance`, three for each cluster.
    uint moments;
    // 1 if the sources are volumes, which have neither radiance nor moments, but bins alone.
    uint volumes;
};

// An entry of a list, and what it refers to.
struct Listed {
    uint entry;
    Facet facet;
    real4 light;
    Moment moment;
};

const uint FETCHED = TARGETS_ARE_SHARED ? 1 : LANES;
// Sources that are fetched at a time.
const uint STEP = TARGETS_ARE_SHARED ? COOPERATIVE : LANES;

shared uint fetched_entries[FETCHED];
shared Facet fetched_facets[FETCHED];
shared real4 fetched_light[FETCHED];
shared Moment fetched_moments[FETCHED];
Listed own_listed;

// First entry in a part of a list whose index is at least `index`, by bisection.
uint first_at_least(uint index, uint begin, uint end) {
    while (begin < end) {
        uint middle = (begin + end) / 2;
        bool below = far_lists[middle] >> 3 < index;
        begin = below ? middle + 1 : begin;
        end = below ? end : middle;
    }
    return begin;
}

// The part of a list in this dispatch.
uvec2 part_of_list(uint list) {
    uint end = far_lists[list + 1];
    uint begin = first_at_least(partner_begin, far_lists[list], end);
    end = first_at_least(partner_end, begin, end);
    begin = min(begin + skip, end);
    return uvec2(begin, min(begin + take, end));
}

// Variance of the triangles of a source: clusters and volumes have it in place of the characteristic area, as they are never close.
real spread_of(Facet source) {
    return clusters + volumes != 0 ? source.characteristic_area : real(0.0);
}

Listed listed(uint at) {
    Listed result;
    result.entry = far_lists[at];
    uint index = result.entry >> 3;
    result.facet = facets[index];
    result.light = real4(0.0);
    // A loop, to skip it for volumes.
    for (uint once = volumes != 0 ? 0 : 1; once > 0; once--) {
        result.light = radiance[index];
    }
    result.moment = NO_MOMENT;
    // A loop, to skip it for triangles.
    for (uint once = clusters != 0 ? 1 : 0; once > 0; once--) {
        uint row = moments + 3 * (index - clusters);
        result.moment = Moment(radiance[row].rgb, radiance[row + 1].rgb, radiance[row + 2].rgb);
    }
    return result;
}

// Fetches up to STEP entries from `at` on, and says how many of them this lane takes.
uint fetch(uint at, uint end) {
    if (TARGETS_ARE_SHARED) {
        uint own = at + lane_turn();
        own_listed = listed(min(own, end - 1));
        return own < end ? 1 : 0;
    }
    uint count = min(end - at, LANES);
    uint lane = gl_LocalInvocationID.x;
    Listed own = listed(at + min(lane, count - 1));
    // Nobody reads the ones before any more.
    barrier();
    fetched_entries[lane] = own.entry;
    fetched_facets[lane] = own.facet;
    fetched_light[lane] = own.light;
    fetched_moments[lane] = own.moment;
    barrier();
    return count;
}

// One of them.
uint fetched_entry(uint k) {
    return TARGETS_ARE_SHARED ? own_listed.entry : fetched_entries[k];
}

Facet fetched_facet(uint k) {
    if (TARGETS_ARE_SHARED) {
        return own_listed.facet;
    }
    return fetched_facets[k];
}

real3 fetched_radiance(uint k) {
    return TARGETS_ARE_SHARED ? own_listed.light.rgb : fetched_light[k].rgb;
}

Moment fetched_moment(uint k) {
    if (TARGETS_ARE_SHARED) {
        return own_listed.moment;
    }
    return fetched_moments[k];
}

#endif
