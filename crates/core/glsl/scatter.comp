#version 450 core
#extension GL_GOOGLE_include_directive : require
// The transpose of gather.comp: the cotangents of the radiance of parts, triangles or clusters, and of its moments, from those of
// their cluster.
// Every part belongs to one cluster. Twin: crates/reference/src/clusters.rs.

#include "geometry.glsl"
#include "cluster_parts.glsl"
#include "moment.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Parts { uvec2 parts[]; };
// Cotangents of clusters, by number, and of triangles.
layout(std430, binding = 2) buffer Clusters { real4 of_clusters[]; };
layout(std430, binding = 3) buffer Triangles { real4 of_triangles[]; };

layout(push_constant) uniform GatherPush {
    // Indices of the clusters, from `begin` to before `end`, and of the first of all.
    uint begin;
    uint end;
    uint clusters;
    // 1 if their parts are triangles.
    uint triangles;
    // Index of the first moment among the cotangents of clusters, three for each.
    uint moments;
};

void main() {
    uint c = begin + gl_GlobalInvocationID.x;
    if (c < end) {
        Facet cluster = facets[c];
        uvec2 of = parts[c - clusters];
        real3 own = of_clusters[c - clusters].rgb;
        uint at = moments + 3 * (c - clusters);
        Moment moment = Moment(of_clusters[at].rgb, of_clusters[at + 1].rgb, of_clusters[at + 2].rgb);
        for (uint k = 0; k < count_parts(of, triangles != 0); k++) {
            uint i = part(of, triangles != 0, k);
            Facet facet = facets[i];
            real factor = share(facet, cluster);
            real3 value = factor * (own + along(moment, facet.centre - cluster.centre));
            if (triangles != 0) {
                of_triangles[i].rgb += value;
            } else {
                of_clusters[i - clusters].rgb += value;
                uint to = moments + 3 * (i - clusters);
                of_clusters[to].rgb += factor * moment.x;
                of_clusters[to + 1].rgb += factor * moment.y;
                of_clusters[to + 2].rgb += factor * moment.z;
            }
        }
    }
}
