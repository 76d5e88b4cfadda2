#ifndef NEAR_FIELD_GLSL
#define NEAR_FIELD_GLSL
// Light between close triangles. Twins: crates/core/src/model/polygon.rs, and crates/core/src/model/near_field.rs for the blend
// weight.

#include "arctangent.glsl"

// Sides that subtend less than this are ignored.
#ifdef F64
const real SHORTEST = 1e-12;
#else
const real SHORTEST = 1e-7;
#endif

// Blend weight of the point-to-point kernel at squared distance r2; the near field has the rest.
real far_weight(real r2, real range) {
    real t = range > 0.0 ? clamp(2.0 * r2 / range - 1.0, 0.0, 1.0) : 1.0;
    return t * t * (3.0 - 2.0 * t);
}

// θ / sinθ times the cross product: the angle one side subtends times the unit normal of its plane.
real3 side_vector(real3 a, real3 b) {
    real3 c = cross(a, b);
    real sine = length(c);
    real cosine = dot(a, b);
    // The half angle's tangent, sine / (|a||b| + cosine), keeps the argument in [0, 1] for angles up to a right one.
    real both = sqrt(sine * sine + cosine * cosine);
    real acute = 2.0 * arctangent(min(sine / max(both + abs(cosine), 1e-30), 1.0));
    real angle = cosine < 0.0 ? PI - acute : acute;
    // A side through the point, or without length, bounds no solid angle.
    return sine > SHORTEST * (dot(a, a) + dot(b, b)) ? c * (angle / sine) : real3(0.0);
}

// The part of a side above the horizon: its angle times the unit normal of its plane. Where it crosses, `leave` or `enter` becomes the point
// at which the outline leaves the upper half-space or enters it again.
real3 upper_side(real3 a, real3 b, real ha, real hb, inout real3 leave, inout real3 enter) {
    bool above_a = ha > 0.0, above_b = hb > 0.0;
    real3 crossing = above_a != above_b ? mix(a, b, ha / (ha - hb)) : real3(0.0);
    leave = above_a && !above_b ? crossing : leave;
    enter = above_b && !above_a ? crossing : enter;
    // A side below the horizon has no angle: both ends are the crossing.
    return side_vector(above_a ? a : crossing, above_b ? b : crossing);
}

// ∫ ω dω over a triangle whose corners are given relative to the point, clipped at the horizon of the normal: Lambert's polygon formula. The
// sign of the triangle's orientation is dropped.
real3 vector_irradiance(real3 normal, real3 p, real3 q, real3 r) {
    real hp = dot(p, normal), hq = dot(q, normal), hr = dot(r, normal);
    // Set both or neither.
    real3 leave = real3(0.0), enter = real3(0.0);
    real3 sum = upper_side(p, q, hp, hq, leave, enter);
    sum += upper_side(q, r, hq, hr, leave, enter);
    sum += upper_side(r, p, hr, hp, leave, enter);
    sum += side_vector(leave, enter);
    return dot(sum, normal) < 0.0 ? -0.5 * sum : 0.5 * sum;
}

// ∫ cosθ dω over the same, in [0, π].
real projected_solid_angle(real3 normal, real3 p, real3 q, real3 r) {
    return dot(vector_irradiance(normal, p, q, r), normal);
}

#endif
