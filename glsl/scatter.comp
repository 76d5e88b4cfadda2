#version 450 core
#extension GL_GOOGLE_include_directive : require
// The transpose of gather.comp: the cotangent of the radiance of parts, triangles or clusters, from that of their cluster.
// Every part belongs to one cluster. Twin: src/reference/clusters_adjoint.rs.

#include "geometry.glsl"
#include "cluster_parts.glsl"

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
};

void main() {
    uint c = begin + gl_GlobalInvocationID.x;
    if (c < end) {
        Facet cluster = facets[c];
        uvec2 of = parts[c - clusters];
        real3 own = of_clusters[c - clusters].rgb;
        for (uint k = 0; k < count_parts(of, triangles != 0); k++) {
            uint i = part(of, triangles != 0, k);
            real3 value = share(facets[i], cluster) * own;
            if (triangles != 0) {
                of_triangles[i].rgb += value;
            } else {
                of_clusters[i - clusters].rgb += value;
            }
        }
    }
}
