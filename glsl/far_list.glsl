#ifndef FAR_LIST_GLSL
#define FAR_LIST_GLSL
// Push constants of the kernels that sum over lists of sources, clusters and triangles, and the walk along a list. A
// workgroup is one subgroup; its receivers share a list. Each lane fetches one source into workgroup memory, from where
// all read it: CPU drivers read memory lane by lane. Expects LANES, `facets`, `radiance`, and `far_lists`: the index of
// the first entry of each list, then the end of the last; then all entries, `index << 3 | bits`, ascending in each list.

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

shared uint fetched_entries[LANES];
shared Facet fetched_facets[LANES];
shared real4 fetched_light[LANES];
shared Moment fetched_moments[LANES];

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

// Fetches up to LANES entries from `at` on, and says how many.
uint fetch(uint at, uint end) {
    uint count = min(end - at, LANES);
    uint lane = gl_LocalInvocationID.x;
    uint entry = far_lists[at + min(lane, count - 1)];
    uint index = entry >> 3;
    Facet facet = facets[index];
    real4 light = real4(0.0);
    // A loop, to skip it for volumes.
    for (uint once = volumes != 0 ? 0 : 1; once > 0; once--) {
        light = radiance[index];
    }
    Moment moment = NO_MOMENT;
    // A loop, to skip it for triangles.
    for (uint once = clusters != 0 ? 1 : 0; once > 0; once--) {
        uint row = moments + 3 * (index - clusters);
        moment = Moment(radiance[row].rgb, radiance[row + 1].rgb, radiance[row + 2].rgb);
    }
    // Nobody reads the ones before any more.
    subgroupBarrier();
    fetched_entries[lane] = entry;
    fetched_facets[lane] = facet;
    fetched_light[lane] = light;
    fetched_moments[lane] = moment;
    subgroupBarrier();
    return count;
}

#endif
