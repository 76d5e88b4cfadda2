#ifndef NEAR_FIELD_GRADIENT_GLSL
#define NEAR_FIELD_GRADIENT_GLSL
// Derivatives of near_field.glsl. Twin: src/reference/near_field_gradient.rs.

#include "near_field.glsl"

// ∂far_share/∂r2 and ∂far_share/∂range.
real2 far_share_slopes(real r2, real range) {
    real t = range > 0.0 ? clamp(2.0 * r2 / range - 1.0, 0.0, 1.0) : real(1.0);
    real by_t = 6.0 * t * (1.0 - t);
    return by_t > 0.0 ? by_t * 2.0 / range * real2(1.0, -r2 / range) : real2(0.0);
}

// Of f = side_vector(a, b) · n, times `factor`: adds ∂f/∂n, ∂f/∂a, ∂f/∂b.
void side_gradient(real3 a, real3 b, real3 n, real factor, inout real3 by_n, inout real3 by_a, inout real3 by_b) {
    real3 c = cross(a, b);
    real sine = length(c);
    for (uint once = sine > SHORTEST * (dot(a, a) + dot(b, b)) ? 1 : 0; once > 0; once--) {
        real cosine = dot(a, b);
        real squares = sine * sine + cosine * cosine;
        real3 unit = c / sine;
        real height = dot(unit, n);
        real3 vector = side_vector(a, b);
        real ratio = dot(vector, unit) / sine;
        // f = θ ⟨c/|c|, n⟩ with tanθ = |c| / ⟨a, b⟩.
        real3 by_c = factor * (ratio * (n - height * unit) + height * cosine / squares * unit);
        real by_cosine = -factor * height * sine / squares;
        by_n += factor * vector;
        by_a += cross(b, by_c) + by_cosine * b;
        by_b += cross(by_c, a) + by_cosine * a;
    }
}

// The gradient of projected_solid_angle(normal, p, q, r).
void projected_solid_angle_gradient(
    real3 normal, real3 p, real3 q, real3 r, out real3 by_normal, out real3 by_p, out real3 by_q, out real3 by_r
) {
    real3 corner[3] = real3[3](p, q, r);
    real3 height = real3(dot(p, normal), dot(q, normal), dot(r, normal));
    real3 leave = real3(0.0), enter = real3(0.0);
    real sum = 0.0;
    for (uint k = 0; k < 3; k++) {
        uint next = k == 2 ? 0 : k + 1;
        real3 a = corner[k], b = corner[next];
        real ha = height[k], hb = height[next];
        bool above_a = ha > 0.0, above_b = hb > 0.0;
        if (above_a != above_b) {
            real3 crossing = mix(a, b, ha / (ha - hb));
            leave = above_a ? crossing : leave;
            enter = above_a ? enter : crossing;
            a = above_a ? a : crossing;
            b = above_a ? crossing : b;
        }
        sum += above_a || above_b ? dot(side_vector(a, b), normal) : 0.0;
    }
    sum += dot(side_vector(leave, enter), normal);
    real factor = sum < 0.0 ? -0.5 : 0.5;
    by_normal = real3(0.0);
    real3 by_leave = real3(0.0), by_enter = real3(0.0);
    side_gradient(leave, enter, normal, factor, by_normal, by_leave, by_enter);
    real3 by_corner[3] = real3[3](real3(0.0), real3(0.0), real3(0.0));
    for (uint k = 0; k < 3; k++) {
        uint next = k == 2 ? 0 : k + 1;
        real3 a = corner[k], b = corner[next];
        real ha = height[k], hb = height[next];
        bool above_a = ha > 0.0, above_b = hb > 0.0;
        bool crosses = above_a != above_b;
        real along = crosses ? ha / (ha - hb) : real(0.0);
        real3 crossing = mix(a, b, along);
        real3 by_a = real3(0.0), by_b = real3(0.0);
        for (uint once = above_a || above_b ? 1 : 0; once > 0; once--) {
            side_gradient(above_a ? a : crossing, above_b ? b : crossing, normal, factor, by_normal, by_a, by_b);
        }
        // What the crossing has to say goes to the two ends, and to their heights.
        real3 by_crossing = crosses ? (above_a ? by_b + by_leave : by_a + by_enter) : real3(0.0);
        by_a = above_a ? by_a : real3(0.0);
        by_b = above_b ? by_b : real3(0.0);
        real by_along = dot(by_crossing, b - a);
        real across = crosses ? by_along / ((ha - hb) * (ha - hb)) : real(0.0);
        real by_ha = -hb * across, by_hb = ha * across;
        by_corner[k] += by_a + (1.0 - along) * by_crossing + by_ha * normal;
        by_corner[next] += by_b + along * by_crossing + by_hb * normal;
        by_normal += by_ha * a + by_hb * b;
    }
    by_p = by_corner[0];
    by_q = by_corner[1];
    by_r = by_corner[2];
}

#endif
