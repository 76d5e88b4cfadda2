#ifndef GEOMETRY_GLSL
#define GEOMETRY_GLSL
// Geometry of a triangle, in coordinates scaled so that the scene lies within the unit ball.

#include "real.glsl"

struct Facet {
    real3 centre;
    real area;
    // Zero for padding, which receives nothing.
    real3 normal;
    // Area of the equilateral triangle with the same sum of squared edges.
    real characteristic_area;
};

// Squared distances below this are rounding: 1e-6 of the scene.
const real R2_MIN = 1e-12;

// The n.z at which the frame is discontinuous: crates/core/src/model/facet.rs gives the reason.
real frame_sign(real3 n) {
    return n.z < -0.6543 ? -1.0 : 1.0;
}

// Columns: two tangents and the normal (Duff et al., JCGT 2017).
real33 orthonormal_basis(real3 n) {
    real s = frame_sign(n);
    real a = -1.0 / (s + n.z);
    real b = n.x * n.y * a;
    return real33(real3(1.0 + s * n.x * n.x * a, s * b, -s * n.x), real3(b, s + n.y * n.y * a, -n.y), n);
}

// v · orthonormal_basis(n), multiplied out.
real3 in_frame(real3 n, real3 v) {
    real s = frame_sign(n);
    real along = dot(n, v);
    // Depends on the triangle alone, so compilers move it out of the loops over partners.
    real inverse = 1.0 / (s + n.z);
    real k = (along + s * v.z) * inverse;
    return real3(v.x - s * n.x * k, s * v.y - n.y * k, along);
}

#endif
