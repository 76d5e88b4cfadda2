#ifndef NEAR_FIELD_GRADIENT_GLSL
#define NEAR_FIELD_GRADIENT_GLSL
// Derivatives of near_field.glsl. Twins: crates/core/src/model/polygon.rs and near_field.rs.

#include "near_field.glsl"

// ∂far_weight/∂r2 and ∂far_weight/∂range.
real2 far_weight_slopes(real r2, real range) {
    real t = range > 0.0 ? clamp(2.0 * r2 / range - 1.0, 0.0, 1.0) : real(1.0);
    real by_t = 6.0 * t * (1.0 - t);
    return by_t > 0.0 ? by_t * 2.0 / range * real2(1.0, -r2 / range) : real2(0.0);
}

// Returns θ ⟨u, n⟩, u being the unit normal of the plane of a side a, b that subtends θ, and adds its derivatives.
// Terms n × a/|a|² and n × b/|b|² are omitted, since they cancel around a polygon.
real side_gradient(real3 a, real3 b, real3 n, inout real3 by_n, inout real3 by_a, inout real3 by_b) {
    real value = 0.0;
    real3 c = cross(a, b);
    real sine = length(c);
    for (uint once = sine > SHORTEST * (dot(a, a) + dot(b, b)) ? 1 : 0; once > 0; once--) {
        real3 unit = c / sine;
        real height = dot(unit, n);
        real3 vector = side_vector(a, b);
        real ratio = dot(vector, unit) / sine;
        real3 across = n - height * unit;
        value = dot(vector, n);
        by_n += vector;
        by_a += cross(ratio * b - a / dot(a, a), across);
        by_b += cross(across, ratio * a - b / dot(b, b));
    }
    return value;
}

// projected_solid_angle(normal, p, q, r) with its gradient. Where a side crosses the horizon, the crossing moves with its
// two ends; moving along the side changes nothing, since light from the horizon contributes nothing. Likewise the
// side in the horizon has a derivative along the normal only, which does not count.
real projected_solid_angle_gradient(
    real3 normal, real3 p, real3 q, real3 r, out real3 by_normal, out real3 by_p, out real3 by_q, out real3 by_r
) {
    real3 corner[3] = real3[3](p, q, r);
    real3 height = real3(dot(p, normal), dot(q, normal), dot(r, normal));
    real3 leave = real3(0.0), enter = real3(0.0);
    real3 by_corner[3] = real3[3](real3(0.0), real3(0.0), real3(0.0));
    real sum = 0.0;
    by_normal = real3(0.0);
    for (uint k = 0; k < 3; k++) {
        uint next = k == 2 ? 0 : k + 1;
        real3 a = corner[k], b = corner[next];
        real ha = height[k], hb = height[next];
        bool above_a = ha > 0.0, above_b = hb > 0.0;
        bool crosses = above_a != above_b;
        real along = crosses ? ha / (ha - hb) : real(0.0);
        real3 crossing = mix(a, b, along);
        leave = crosses && above_a ? crossing : leave;
        enter = crosses && above_b ? crossing : enter;
        for (uint once = above_a || above_b ? 1 : 0; once > 0; once--) {
            real3 by_a = real3(0.0), by_b = real3(0.0);
            sum += side_gradient(above_a ? a : crossing, above_b ? b : crossing, normal, by_normal, by_a, by_b);
            real3 by_crossing = crosses ? (above_a ? by_b : by_a) : real3(0.0);
            by_corner[k] += (above_a ? by_a : real3(0.0)) + (1.0 - along) * by_crossing;
            by_corner[next] += (above_b ? by_b : real3(0.0)) + along * by_crossing;
        }
    }
    sum += dot(side_vector(leave, enter), normal);
    real factor = sum < 0.0 ? -0.5 : 0.5;
    by_normal *= factor;
    by_p = factor * by_corner[0];
    by_q = factor * by_corner[1];
    by_r = factor * by_corner[2];
    return factor * sum;
}

#endif
