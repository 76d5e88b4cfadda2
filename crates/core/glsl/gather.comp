#version 450 core
#extension GL_GOOGLE_include_directive : require
// The diffuse radiance of clusters: L = Σ a ⟨n_i, n⟩ L_i / ā over the parts of each, triangles or clusters, and its first moment
// around the centroid. Twin: crates/reference/src/clusters.rs.

#include "geometry.glsl"
#include "cluster_parts.glsl"
#include "moment.glsl"

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
    // Index of the first moment, three for each cluster.
    uint moments;
};

void main() {
    uint c = begin + gl_GlobalInvocationID.x;
    if (c < end) {
        Facet cluster = facets[c];
        uvec2 of = parts[c - clusters];
        real3 sum = real3(0.0);
        Moment moment = NO_MOMENT;
        for (uint k = 0; k < count_parts(of, triangles != 0); k++) {
            uint i = part(of, triangles != 0, k);
            Facet own = facets[i];
            real factor = share(own, cluster);
            real3 light = factor * radiance[i].rgb;
            real3 offset = own.centre - cluster.centre;
            sum += light;
            moment.x += offset.x * light;
            moment.y += offset.y * light;
            moment.z += offset.z * light;
            // A loop, to skip it for triangles.
            for (uint once = triangles != 0 ? 0 : 1; once > 0; once--) {
                uint at = moments + 3 * (i - clusters);
                moment.x += factor * radiance[at].rgb;
                moment.y += factor * radiance[at + 1].rgb;
                moment.z += factor * radiance[at + 2].rgb;
            }
        }
        radiance[c] = real4(sum, 0.0);
        uint at = moments + 3 * (c - clusters);
        radiance[at] = real4(moment.x, 0.0);
        radiance[at + 1] = real4(moment.y, 0.0);
        radiance[at + 2] = real4(moment.z, 0.0);
    }
}
