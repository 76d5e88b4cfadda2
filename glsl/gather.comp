#version 450 core
#extension GL_GOOGLE_include_directive : require
// The diffuse radiance of clusters: L = Σ a ⟨n_i, n⟩ L_i / ā over the parts of each, triangles or clusters. Twin:
// src/reference/clusters.rs.

#include "geometry.glsl"
#include "cluster_parts.glsl"

layout(local_size_x_id = 0) in;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Parts { uvec2 parts[]; };
layout(std430, binding = 2) buffer Radiance { real4 radiance[]; };

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
        real3 sum = real3(0.0);
        for (uint k = 0; k < count_parts(of, triangles != 0); k++) {
            uint i = part(of, triangles != 0, k);
            sum += share(facets[i], cluster) * radiance[i].rgb;
        }
        radiance[c] = real4(sum, 0.0);
    }
}
