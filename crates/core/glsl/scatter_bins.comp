#version 450 core
#extension GL_GOOGLE_include_directive : require
// The transpose of gather_bins.comp: the cotangent of the bins of parts, triangles or clusters, from that of their cluster.
// A workgroup owns a cluster, and thereby its parts. Twin: crates/reference/src/clusters.rs.

#include "geometry.glsl"
#include "bins.glsl"
#include "cluster_parts.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Parts { uvec2 parts[]; };
layout(std430, binding = 2) readonly buffer From { real from[]; };
// The bins of parts; if they are clusters, in the same buffer.
layout(std430, binding = 3) buffer To { real to[]; };

layout(push_constant) uniform GatherBinsPush {
    // Index of the first cluster of this dispatch, and of all.
    uint begin;
    uint clusters;
    // 1 if their parts are triangles.
    uint triangles;
    // Indices of the first cluster and the first part in their pages.
    uint from_page;
    uint to_page;
};

const uint REALS = BINS * CHANNELS;

void main() {
    uint c = begin + gl_WorkGroupID.x;
    Facet cluster = facets[c];
    uvec2 of = parts[c - clusters];
    uint count = count_parts(of, triangles != 0);
    for (uint k = 0; k < count; k++) {
        uint i = part(of, triangles != 0, k);
        real factor = share(facets[i], cluster);
        for (uint at = gl_LocalInvocationID.x; at < REALS; at += gl_WorkGroupSize.x) {
            to[(i - to_page) * REALS + at] += factor * from[(c - from_page) * REALS + at];
        }
    }
}
