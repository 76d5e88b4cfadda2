#ifndef ARCTANGENT_GLSL
#define ARCTANGENT_GLSL

#include "real.glsl"

#ifdef F64
// atan for 0 <= t <= 1, to rounding: two halvings of the angle leave t below 0.199, where the series ends at t^23 / 23.
real arctangent(real t) {
    t /= 1.0 + sqrt(1.0 + t * t);
    t /= 1.0 + sqrt(1.0 + t * t);
    real u = t * t;
    return 4.0 * t * (1.0 - u * (I(3) - u * (I(5) - u * (I(7) - u * (I(9) - u * (I(11) - u * (I(13) - u * (I(15) - u * (I(17) - u * (I(19) - u * (I(21) - u * I(23))))))))))));
}
#else
// atan for 0 <= t <= 1, to 1.2e-8 before rounding: Vulkan allows the built-in one a far larger error.
real arctangent(real t) {
    real u = t * t;
    return t * ((((((((0.0028340643 * u - 0.0160050305) * u + 0.0425876075) * u - 0.0749544544) * u + 0.106367541) * u - 0.142025705) * u + 0.199924836) * u - 0.333330668) * u + 0.999999984);
}
#endif

#endif
