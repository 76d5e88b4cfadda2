#ifndef BINS_SLOPE_GLSL
#define BINS_SLOPE_GLSL
// Derivatives of the weights T_b by the direction. Twin: crates/core/src/model/bins.rs.

#include "bins.glsl"

// Derivative of the weight that `clamped` gives to the second cell, per unit of the coordinate.
real clamped_slope(real coordinate, uint count) {
    return coordinate > 0.0 && coordinate < real(count - 1) ? real(1.0) : real(0.0);
}

// The gradient of Σ_tap weight · value over the taps of `w`, which is in the frame of the triangle. Zero where it is
// undefined: at the pole, and along the polar angle below the horizon.
real3 taps_gradient(real3 w, Taps taps, real4 value) {
    real t = taps.weight[2] + taps.weight[3], s = taps.weight[1] + taps.weight[3];
    real by_row = (1.0 - s) * (value[2] - value[0]) + s * (value[3] - value[1]);
    real by_column = (1.0 - t) * (value[1] - value[0]) + t * (value[3] - value[2]);
    bool above = w.z > 0.0;
    real z = max(w.z, 0.0);
    if (CONCENTRIC) {
        real2 disk = w.xy * inversesqrt(1.0 + z);
        real radius = length(disk);
        real2 a = abs(disk);
        bool wide = a.x >= a.y;
        real longer = max(a.x, a.y);
        bool pole = !(radius > POLE);
        real angle = pole ? real(0.0) : short_arctangent(min(a.x, a.y) / longer);
        real side = radius * angle * (4.0 * INV_PI);
        real2 sign_of = real2(disk.x < 0.0 ? -1.0 : 1.0, disk.y < 0.0 ? -1.0 : 1.0);
        real2 square = sign_of * (wide ? real2(radius, side) : real2(side, radius));
        square = (square + 1.0) * (0.5 * real(ROWS)) - 0.5;
        real per_radius = pole ? real(0.0) : 1.0 / radius;
        real2 along = disk * per_radius;
        // Across the radius, by the angle from the nearer axis.
        real2 across = per_radius * (wide ? real2(-a.y * sign_of.x, a.x * sign_of.y) : real2(a.y * sign_of.x, -a.x * sign_of.y));
        real2 of_side = (4.0 * INV_PI) * (angle * along + across);
        real2 of_x = sign_of.x * (wide ? along : of_side);
        real2 of_y = sign_of.y * (wide ? of_side : along);
        real scale = 0.5 * real(ROWS);
        real2 gradient = by_row * clamped_slope(square.y, ROWS) * scale * of_y
            + by_column * clamped_slope(square.x, ROWS) * scale * of_x;
        real by_z = above ? -0.5 * dot(gradient, disk) / (1.0 + z) : real(0.0);
        return real3(gradient * inversesqrt(1.0 + z), by_z);
    }
    real r = length(w.xy);
    real per_r = r > POLE ? 1.0 / r : real(0.0);
    real polar = arccosine(min(z, real(1.0)));
    real rows = 2.0 * INV_PI * real(ROWS);
    real row_slope = above ? by_row * clamped_slope(polar * rows - 0.5, ROWS) * rows / (r * r + z * z) : real(0.0);
    real column_slope = by_column * (0.5 * INV_PI * real(COLUMNS)) * per_r;
    real2 outward = w.xy * per_r;
    return real3(row_slope * z * outward + column_slope * real2(-outward.y, outward.x), -row_slope * r);
}

// The gradient with respect to the normal n of g · R(n)ᵀ v, R being the frame of n.
real3 frame_gradient(real3 n, real3 v, real3 g) {
    real s = frame_sign(n);
    real a = -1.0 / (s + n.z);
    real b = n.x * n.y * a;
    real by_b = g.x * s * v.y + g.y * v.x;
    real by_a = g.x * s * n.x * n.x * v.x + g.y * n.y * n.y * v.y + by_b * n.x * n.y;
    return g.z * v
        + real3(
            g.x * s * (2.0 * n.x * a * v.x - v.z) + by_b * n.y * a,
            g.y * (2.0 * n.y * a * v.y - v.z) + by_b * n.x * a,
            by_a * a * a
        );
}

#endif
