#ifndef NEAR_FIELD_GLSL
#define NEAR_FIELD_GLSL
// Light between triangles that are close to one another. Twin: src/reference/near_field.rs.

#include "arctangent.glsl"

// Share of the point-to-point kernel in a pair at squared distance r2; the near field has the rest.
float far_share(float r2, float range) {
    float t = range > 0.0 ? clamp(2.0 * r2 / range - 1.0, 0.0, 1.0) : 1.0;
    return t * t * (3.0 - 2.0 * t);
}

// θ / sinθ times the cross product: the angle one side subtends times the unit normal of its plane.
vec3 side_vector(vec3 a, vec3 b) {
    vec3 c = cross(a, b);
    float sine = length(c);
    float cosine = dot(a, b);
    // The half angle's tangent, sine / (|a||b| + cosine), keeps the argument in [0, 1] for angles up to a right one.
    float both = sqrt(sine * sine + cosine * cosine);
    float acute = 2.0 * arctangent(min(sine / max(both + abs(cosine), 1e-30), 1.0));
    float angle = cosine < 0.0 ? PI - acute : acute;
    // On the side itself, or on a side without length, no solid angle is bounded.
    return sine > 1e-7 * (dot(a, a) + dot(b, b)) ? c * (angle / sine) : vec3(0.0);
}

// ∫ cosθ dω over a triangle whose corners are given relative to the point, clipped at the horizon of the normal, in
// [0, π]: Lambert's polygon formula. The sign of the triangle's orientation is dropped.
float projected_solid_angle(vec3 normal, vec3 p, vec3 q, vec3 r) {
    vec3 corner[3] = vec3[3](p, q, r);
    vec3 height = vec3(dot(p, normal), dot(q, normal), dot(r, normal));
    // Only ever used together: where the outline leaves the upper half-space and where it comes back.
    vec3 leave = vec3(0.0), enter = vec3(0.0);
    float sum = 0.0;
    for (uint k = 0; k < 3; k++) {
        uint next = k == 2 ? 0 : k + 1;
        vec3 a = corner[k], b = corner[next];
        float ha = height[k], hb = height[next];
        bool above_a = ha > 0.0, above_b = hb > 0.0;
        if (above_a != above_b) {
            vec3 crossing = mix(a, b, ha / (ha - hb));
            leave = above_a ? crossing : leave;
            enter = above_a ? enter : crossing;
            a = above_a ? a : crossing;
            b = above_a ? crossing : b;
        }
        sum += above_a || above_b ? dot(side_vector(a, b), normal) : 0.0;
    }
    sum += dot(side_vector(leave, enter), normal);
    return 0.5 * abs(sum);
}

#endif
