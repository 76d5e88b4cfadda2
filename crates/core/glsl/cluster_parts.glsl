#ifndef CLUSTER_PARTS_GLSL
#define CLUSTER_PARTS_GLSL
// What clusters consist of: triangles, the slots from parts.x to before parts.y, or the two clusters of these indices.
// Twin: crates/core/src/model/clusters/mod.rs.

// The weight of a part's radiance in that of its cluster: a ⟨n_i, n⟩ / ā.
real share(Facet part, Facet cluster) {
    return cluster.area > 0.0 ? part.area * dot(part.normal, cluster.normal) / cluster.area : real(0.0);
}

uint count_parts(uvec2 parts, bool triangles) {
    return triangles ? parts.y - parts.x : 2;
}

uint part(uvec2 parts, bool triangles, uint k) {
    return triangles ? parts.x + k : k == 0 ? parts.x : parts.y;
}

#endif
