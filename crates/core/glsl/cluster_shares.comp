#version 450 core
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// The derivative of ⟨λ, U L⟩ with respect to the share of each part, triangle or cluster, in the light of its cluster: the product
// of the part's light and the cluster's cotangent. Also that by the centroids of both, between which the first moment is taken. A
// workgroup owns a cluster. Twin: crates/reference/src/clusters.rs.

#include "geometry.glsl"
#include "bins.glsl"
#include "cluster_parts.glsl"
#include "facet_gradient.glsl"
#include "moment.glsl"

layout(local_size_x_id = 0) in;
// Lanes of the workgroup: as a constant of its own, since Metal takes gl_WorkGroupSize for no constant size of an array.
layout(constant_id = 13) const uint LANES = 1;
layout(constant_id = 7) const bool SOURCE_BACK = false;
layout(constant_id = 8) const bool SOURCE_FRONT = false;

layout(std430, binding = 0) readonly buffer Parts { uvec2 parts[]; };
layout(std430, binding = 1) readonly buffer Radiance { real4 radiance[]; };
layout(std430, binding = 2) readonly buffer ClusterCotangents { real4 cluster_cotangents[]; };
// The light of parts, and the cotangent of clusters: of H(b) behind the antiradiance, as in a state of the adjoint.
layout(std430, binding = 3) readonly buffer Antiradiance { real antiradiance[]; };
layout(std430, binding = 4) readonly buffer Specular { real specular[]; };
layout(std430, binding = 5) readonly buffer Back { real back[]; };
layout(std430, binding = 6) readonly buffer Front { real front[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 7) readonly buffer BinTable { real4 bin_table[]; };
layout(std430, binding = 8) buffer Gradients { FacetGradient gradients[]; };
layout(std430, binding = 9) readonly buffer Facets { Facet facets[]; };

layout(push_constant) uniform SharesPush {
    // Index of the first cluster of this dispatch, and of all.
    uint begin;
    uint clusters;
    // 1 if their parts are triangles.
    uint triangles;
    // Indices of the first part and the first cluster in their pages.
    uint from_page;
    uint to_page;
    // Indices of the first moment in `radiance`, and in `cluster_cotangents`; three for each cluster.
    uint moments;
    uint cotangent_moments;
};

const uint REALS = BINS * CHANNELS;

shared real sums[LANES];

void main() {
    uint c = begin + gl_WorkGroupID.x;
    uint lane = gl_LocalInvocationID.x;
    uvec2 of = parts[c - clusters];
    Facet cluster = facets[c];
    real3 cotangent = cluster_cotangents[c - clusters].rgb;
    uint row = cotangent_moments + 3 * (c - clusters);
    Moment moment =
        Moment(cluster_cotangents[row].rgb, cluster_cotangents[row + 1].rgb, cluster_cotangents[row + 2].rgb);
    real3 by_centre = real3(0.0);
    for (uint k = 0; k < count_parts(of, triangles != 0); k++) {
        uint i = part(of, triangles != 0, k);
        real sum = 0.0;
        uint from = (i - from_page) * REALS, to = (c - to_page) * REALS;
        for (uint at = lane; SOURCE_BACK && at < REALS; at += LANES) {
            sum += bin_table[at / CHANNELS].w * antiradiance[from + at] * back[to + at];
        }
        for (uint at = lane; SOURCE_FRONT && at < REALS; at += LANES) {
            sum += specular[from + at] * front[to + at];
        }
        barrier();
        sums[lane] = sum;
        barrier();
        if (lane == 0) {
            Facet facet = facets[i];
            real3 light = radiance[i].rgb;
            sum = dot(light, cotangent + along(moment, facet.centre - cluster.centre));
            if (triangles == 0) {
                uint at = moments + 3 * (i - clusters);
                sum += dot(radiance[at].rgb, moment.x);
                sum += dot(radiance[at + 1].rgb, moment.y);
                sum += dot(radiance[at + 2].rgb, moment.z);
            }
            real3 by_part = share(facet, cluster) / 3.0 * of_light(moment, light);
            gradients[i].a += by_part;
            gradients[i].b += by_part;
            gradients[i].c += by_part;
            by_centre -= by_part;
            for (uint from_lane = 0; from_lane < LANES; from_lane++) {
                sum += sums[from_lane];
            }
            gradients[i].share = sum;
        }
    }
    if (lane == 0) {
        gradients[c].a += by_centre;
        gradients[c].b += by_centre;
        gradients[c].c += by_centre;
    }
}
