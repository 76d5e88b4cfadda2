#ifndef BINS_GLSL
#define BINS_GLSL
// Direction bins: the four taps of T_b(ω) and their weights. Twin: crates/core/src/model/bins.rs.

#include "arctangent.glsl"

layout(constant_id = 2) const bool CONCENTRIC = false;
// Equal-angle: rows of polar angle, sectors of azimuth. Concentric: both the side of the square.
layout(constant_id = 4) const uint ROWS = 10;
layout(constant_id = 5) const uint COLUMNS = 13;
// 3, or 1 for a scene without colour.
layout(constant_id = 6) const uint CHANNELS = 3;

const uint BINS = ROWS * COLUMNS;

// Sines below this are rounding, where there is no azimuth, and no derivative by it.
#ifdef F64
const real POLE = 1e-12;
#else
const real POLE = 1e-5;
#endif

struct Taps {
    uvec4 bin;
    real4 weight;
};

#ifdef F64
real short_arctangent(real t) {
    return arctangent(t);
}

real arccosine(real z) {
    return 2.0 * arctangent(sqrt((1.0 - z) / (1.0 + z)));
}
#else
// To 2.5e-7 and 9e-8 for arguments in [0, 1], less than the rounding of the coordinates of a layout.
real short_arctangent(real t) {
    real u = t * t;
    return t * ((((((0.00681179107 * u - 0.0336042135) * u + 0.0796236637) * u - 0.132333416) * u + 0.198078154) * u - 0.33317368) * u + 0.999996112);
}

real arccosine(real z) {
    return sqrt(1.0 - z) * ((((((0.00261172047 * z - 0.0120033948) * z + 0.0277629132) * z - 0.0491974368) * z + 0.0888358857) * z - 0.214591089) * z + 1.57079624);
}
#endif

// The first of the two cells around a coordinate, whose centres are 0, 1, … count - 1; `weight` is that of the
// second.
real clamped(real coordinate, uint count, out real weight) {
    real c = clamp(coordinate, 0.0, real(count - 1));
    real first = min(floor(c), real(count - 2));
    weight = c - first;
    return first;
}

// atan2 in turns, in [0, 1].
real turns(real x, real y) {
    real2 a = abs(real2(x, y));
    real octant = short_arctangent(min(a.x, a.y) / max(max(a.x, a.y), 1e-30)) * (0.5 * INV_PI);
    real quadrant = a.x < a.y ? 0.25 - octant : octant;
    real half_plane = x < 0.0 ? 0.5 - quadrant : quadrant;
    return y < 0.0 ? 1.0 - half_plane : half_plane;
}

// `w`: unit, in the frame of the triangle; directions below the horizon count as on it.
Taps taps(real3 w) {
    real z = clamp(w.z, 0.0, 1.0);
    real row, column, t, s;
    bool wraps = false;
    if (CONCENTRIC) {
        real2 disk = w.xy * inversesqrt(1.0 + z);
        real radius = length(disk);
        real2 a = abs(disk);
        real longer = max(a.x, a.y);
        real side = longer > 0.0 ? radius * short_arctangent(min(a.x, a.y) / longer) * (4.0 * INV_PI) : 0.0;
        real2 square = a.x >= a.y ? real2(radius, side) : real2(side, radius);
        square = real2(disk.x < 0.0 ? -square.x : square.x, disk.y < 0.0 ? -square.y : square.y);
        square = (square + 1.0) * (0.5 * real(ROWS)) - 0.5;
        row = clamped(square.y, ROWS, t);
        column = clamped(square.x, ROWS, s);
    } else {
        row = clamped(arccosine(z) * (2.0 * INV_PI * real(ROWS)) - 0.5, ROWS, t);
        real2 level = dot(w.xy, w.xy) > POLE * POLE ? w.xy : real2(0.0);
        real turn = turns(level.x, level.y) * real(COLUMNS) - 0.5;
        real sector = floor(turn);
        s = turn - sector;
        column = sector < 0.0 ? real(COLUMNS - 1) : sector;
        wraps = column == real(COLUMNS - 1);
    }
    // In reals, which are exact here: CPUs multiply and convert integers slowly.
    uint first = uint(int(row * real(COLUMNS) + column));
    uint next = wraps ? first - (COLUMNS - 1) : first + 1;
    Taps result;
    result.bin = uvec4(first, next, first + COLUMNS, next + COLUMNS);
    result.weight = real4((1.0 - t) * (1.0 - s), (1.0 - t) * s, t * (1.0 - s), t * s);
    return result;
}

// result += Σ_b T_b values[first + b] over bins in a buffer, which is bound as an array of real, `grey`, and of
// packed real3, `rgb`.
#define GATHER(grey, rgb, first, t, result)                                                       \
    for (uint tap = 0; tap < 4; tap++) {                                                          \
        uint at = (first) + t.bin[tap];                                                           \
        result += t.weight[tap] * (CHANNELS == 1 ? real3(grey[at]) : rgb[at]);                     \
    }

#endif
