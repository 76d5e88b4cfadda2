#ifndef SPREAD_GLSL
#define SPREAD_GLSL
// How a receiver sees a cluster. Twin: crates/core/src/model/clusters/mean_cosine.rs.

struct Spread {
    // The mean of max(cos_j, 0) cos_i / r² over the triangles of a cluster, spread evenly in its plane around its centroid, to
    // second order, as another cos_j, in place of max(cos_j, 0).
    real cosine;
    // The share of the triangles above the receiver's horizon.
    real above;
    // The mean of max(cos_j, 0), to first order.
    real mean;
};

// The mean of max(to, 0) to first order, over triangles whose heights are uniformly distributed within `width` of `to`.
Spread spread_within(real to, real width) {
    real above = clamp(0.5 + 0.5 * to / max(width, 1e-12), 0.0, 1.0);
    real mean = to > width ? to : above * above * width;
    return Spread(mean, above, mean);
}

// `to` and `from` are the cosines times r, and so are the results; `tilt` is the cosine between the normals of the two sides that
// face each other, and `spread` the variance of the triangles. Where they lie on both sides of the receiver's horizon, their
// heights count as uniformly distributed.
Spread spread_over(real to, real from, real tilt, real spread, real r2) {
    real width = sqrt(max(1.5 * spread * (1.0 - tilt * tilt), 0.0));
    Spread first = spread_within(to, width);
    real above = first.above, mean = first.mean;
    real cosine = max(mean + above * (2.0 * spread / r2) * (mean - tilt * from - 3.0 * mean * from * from / r2), 0.0);
    real lit = cosine > 0.0 ? 1.0 : 0.0;
    return Spread(cosine, lit * above, lit * mean);
}

// The same of a volume: its triangles lie all around its centroid, and cos_j / r² is harmonic, so that to second order the mean is that
// of the centroid.
Spread spread_in_space(real to, real spread) {
    return spread_within(to, sqrt(spread));
}

// By how much the cosine changes along the cluster's plane, per unit of length, apart from |cos_i|: the first moment of light is
// multiplied by it. `d`: from source to receiver.
real3 spread_slope(Spread s, real3 receiver_normal, real3 d, real r2) {
    return s.above * receiver_normal + (4.0 * s.mean / r2) * d;
}

#endif
