#version 450 core
#extension GL_GOOGLE_include_directive : require
// The radiance of clusters per bin: Σ a ⟨n_i, n⟩ L_i(b) / ā over the parts of each, triangles or clusters. Frames of
// parts are so similar that their bins need no rotation. A workgroup owns a cluster. Twin: crates/reference/src/clusters.rs.

#include "geometry.glsl"
#include "bins.glsl"
#include "cluster_parts.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Parts { uvec2 parts[]; };
// The bins of parts; if they are clusters, in the same buffer as the result.
layout(std430, binding = 2) readonly buffer From { real from[]; };
layout(std430, binding = 3) buffer To { real to[]; };

layout(push_constant) uniform GatherBinsPush {
    // Index of the first cluster of this dispatch, and of all.
    uint begin;
    uint clusters;
    // 1 if their parts are triangles.
    uint triangles;
    // Indices of the first part and the first cluster in their pages.
    uint from_page;
    uint to_page;
};

const uint REALS = BINS * CHANNELS;
// Triangles of a cluster, at most: a tile.
const uint MOST_PARTS = 64;

void main() {
    uint c = begin + gl_WorkGroupID.x;
    Facet cluster = facets[c];
    uvec2 of = parts[c - clusters];
    uint count = count_parts(of, triangles != 0);
    real shares[MOST_PARTS];
    for (uint k = 0; k < count; k++) {
        shares[k] = share(facets[part(of, triangles != 0, k)], cluster);
    }
    for (uint at = gl_LocalInvocationID.x; at < REALS; at += gl_WorkGroupSize.x) {
        real sum = 0.0;
        for (uint k = 0; k < count; k++) {
            sum += shares[k] * from[(part(of, triangles != 0, k) - from_page) * REALS + at];
        }
        to[(c - to_page) * REALS + at] = sum;
    }
}
