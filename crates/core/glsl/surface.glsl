#ifndef SURFACE_GLSL
#define SURFACE_GLSL

#include "real.glsl"

// The Blinn-Phong material of one triangle.
struct Surface {
    // δρ.
    real3 diffuse;
    // p.
    real power;
    // L_e, W/(m² sr).
    real3 emission;
    real unused_emission;
    // σ N(p), 1/sr.
    real3 specular;
    real unused_specular;
};

// Whether it has a lobe that is not black.
bool reflects_specularly(Surface s) {
    return any(notEqual(s.specular, real3(0.0)));
}

#endif
