#ifndef SPREAD_GLSL
#define SPREAD_GLSL
// The cosine at a receiver for a cluster. Twin: src/model/clusters/mean_cosine.rs.

// The mean of max(cos_j, 0) cos_i / r² over the triangles of a cluster, spread evenly in its plane around its centroid, to
// second order, as another cos_j, in place of max(cos_j, 0). `to` and `from` are the cosines times r, `tilt` is the cosine
// between the normals of the two sides that face each other, and `spread` the variance of the triangles. Where they lie on
// both sides of the receiver's horizon, their heights count as uniformly distributed.
real spread_over(real to, real from, real tilt, real spread, real r2) {
    real width = sqrt(max(1.5 * spread * (1.0 - tilt * tilt), 0.0));
    real above = clamp(0.5 + 0.5 * to / max(width, 1e-12), 0.0, 1.0);
    real mean = to > width ? to : above * above * width;
    return max(mean + above * (2.0 * spread / r2) * (mean - tilt * from - 3.0 * mean * from * from / r2), 0.0);
}

#endif
