#ifndef BINS_GLSL
#define BINS_GLSL
// Direction bins: the four taps of T_b(ω) and their weights. Twin: src/plan/bins.rs.

#include "arctangent.glsl"

layout(constant_id = 2) const bool CONCENTRIC = false;
layout(constant_id = 3) const bool SMOOTHSTEP = false;
// Equal-angle: rows of polar angle, sectors of azimuth. Concentric: both the side of the square.
layout(constant_id = 4) const uint ROWS = 10;
layout(constant_id = 5) const uint COLUMNS = 13;
// 3, or 1 for a scene without colour.
layout(constant_id = 6) const uint CHANNELS = 3;

const uint BINS = ROWS * COLUMNS;

struct Taps {
    uvec4 bin;
    real4 weight;
};

real shape(real t) {
    return SMOOTHSTEP ? t * t * (3.0 - 2.0 * t) : t;
}

// The two cells around a coordinate whose centres are 0, 1, … count - 1.
void clamped(real coordinate, uint count, out uint first, out real weight) {
    real c = clamp(coordinate, 0.0, real(count - 1));
    real f = min(floor(c), real(count - 2));
    first = uint(f);
    weight = shape(c - f);
}

// atan2 in turns, in [0, 1): by the tangent of the half angle, y / (r + x), which lies in [0, 1] for x >= 0.
real turns(real x, real y, real r) {
    real half_angle = r > 0.0 ? arctangent(min(abs(y) / (r + abs(x)), 1.0)) : 0.0;
    real t = half_angle * INV_PI;
    t = x < 0.0 ? 0.5 - t : t;
    return y < 0.0 ? 1.0 - t : t;
}

// `w` in the frame of the triangle; below the horizon counts as on it.
Taps taps(real3 w) {
    real z = max(w.z, 0.0);
    uint row, row_next, column, column_next;
    real t, s;
    if (CONCENTRIC) {
        real2 disk = w.xy * inversesqrt(1.0 + z);
        real radius = length(disk);
        real2 a = abs(disk);
        real longer = max(a.x, a.y);
        real side = longer > 0.0 ? radius * arctangent(min(a.x, a.y) / longer) * (4.0 * INV_PI) : 0.0;
        real2 square = a.x >= a.y ? real2(radius, side) : real2(side, radius);
        square = real2(disk.x < 0.0 ? -square.x : square.x, disk.y < 0.0 ? -square.y : square.y);
        square = (square + 1.0) * (0.5 * real(ROWS)) - 0.5;
        clamped(square.y, ROWS, row, t);
        clamped(square.x, ROWS, column, s);
        column_next = column + 1;
    } else {
        real r = length(w.xy);
        real polar = 2.0 * arctangent(min(r / (1.0 + z), 1.0));
        // Of a direction below the horizon r and z do not belong together.
        polar = w.z > 0.0 ? polar : 0.5 * PI;
        clamped(polar * (2.0 * INV_PI * real(ROWS)) - 0.5, ROWS, row, t);
        real turn = turns(w.x, w.y, r) * real(COLUMNS) - 0.5;
        real sector = floor(turn);
        s = shape(turn - sector);
        column = sector < 0.0 ? COLUMNS - 1 : min(uint(sector), COLUMNS - 1);
        column_next = column + 1 == COLUMNS ? 0 : column + 1;
    }
    row_next = row + 1;
    uvec2 first = uvec2(row, row_next) * COLUMNS;
    Taps result;
    result.bin = uvec4(first.x + column, first.x + column_next, first.y + column, first.y + column_next);
    result.weight = real4((1.0 - t) * (1.0 - s), (1.0 - t) * s, t * (1.0 - s), t * s);
    return result;
}

// result += Σ_b T_b values[first + b] over bins in a buffer, which is there as array of real, `grey`, and of packed real3,
// `rgb`.
#define GATHER(grey, rgb, first, t, result)                                                       \
    for (uint tap = 0; tap < 4; tap++) {                                                          \
        uint at = (first) + t.bin[tap];                                                           \
        result += t.weight[tap] * (CHANNELS == 1 ? real3(grey[at]) : rgb[at]);                     \
    }

#endif
