#ifndef FACET_GRADIENT_GLSL
#define FACET_GRADIENT_GLSL

#include "real.glsl"

// ∂loss/∂geometry of one triangle, with the quantities that kernels read as independent; the host reduces them to
// corners. The centroid's gradient is added to the corners, a third each.
struct FacetGradient {
    real3 a;
    real area;
    real3 b;
    real characteristic_area;
    real3 c;
    real unused_corner;
    real3 normal;
    real unused_normal;
};

FacetGradient no_gradient() {
    return FacetGradient(real3(0.0), 0.0, real3(0.0), 0.0, real3(0.0), 0.0, real3(0.0), 0.0);
}

#endif
