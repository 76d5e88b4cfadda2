#ifndef LOBE_GLSL
#define LOBE_GLSL
// The Blinn-Phong lobe between two directions in the frame of a triangle.

#include "power.glsl"

// ⟨h, n⟩: the z of the half vector.
real half_cosine(real3 b, real3 o) {
    real3 h = b + o;
    return max(h.z * inversesqrt(max(dot(h, h), 1e-20)), 1e-20);
}

// cosine^p. pow(0, 0) is undefined: a lobe of power 0 is 1 everywhere.
real lobe(real cosine, real p) {
    return p > 0.0 ? power(cosine, p) : real(1.0);
}

#endif
