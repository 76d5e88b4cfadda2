#ifndef MOMENT_GLSL
#define MOMENT_GLSL
// The first moment of the diffuse radiance of a cluster around its centroid, Σ a ⟨n_i, n⟩ L_i (x_i - c)ᵀ / ā: three rows of radiance
// or its cotangent, one for each coordinate, RGB. Twin: crates/reference/src/clusters.rs.

#include "real.glsl"

struct Moment {
    real3 x;
    real3 y;
    real3 z;
};

const Moment NO_MOMENT = Moment(real3(0.0), real3(0.0), real3(0.0));

// From a derivative by place to light.
real3 along(Moment m, real3 v) {
    return m.x * v.x + m.y * v.y + m.z * v.z;
}

// Its transpose.
real3 of_light(Moment m, real3 light) {
    return real3(dot(m.x, light), dot(m.y, light), dot(m.z, light));
}

#endif
