#ifndef ARCTANGENT_GLSL
#define ARCTANGENT_GLSL
// atan for 0 <= t <= 1, to 1.2e-8 before rounding: the built-in one may be off by far more.
float arctangent(float t) {
    float u = t * t;
    return t * ((((((((0.0028340643 * u - 0.0160050305) * u + 0.0425876075) * u - 0.0749544544) * u + 0.106367541) * u - 0.142025705) * u + 0.199924836) * u - 0.333330668) * u + 0.999999984);
}

#endif
