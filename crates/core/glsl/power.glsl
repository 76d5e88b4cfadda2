#ifndef POWER_GLSL
#define POWER_GLSL
// x^p and ln x for x > 0: built in for f32 only.

#include "real.glsl"

#ifdef F64
const real LN2 = 0.693147180559945309417lf;

// ln x of a normal number: x = m 2^e with 2/3 <= m < 4/3, ln m = 2 artanh((m - 1) / (m + 1)), whose series ends at
// 0.2^25 / 25.
real logarithm(real x) {
    uvec2 words = unpackDouble2x32(x);
    int exponent = int(words.y >> 20 & 0x7ff) - 1023;
    real m = packDouble2x32(uvec2(words.x, words.y & 0x000fffff | 0x3ff00000));
    if (m >= 4.0 / real(3.0)) {
        m *= 0.5;
        exponent += 1;
    }
    real z = (m - 1.0) / (m + 1.0);
    real u = z * z;
    real sum = (I(1) + u * (I(3) + u * (I(5) + u * (I(7) + u * (I(9) + u * (I(11) + u * (I(13) + u * (I(15) + u * (I(17) + u * (I(19) + u * (I(21) + u * (I(23) + u * I(25)))))))))))));
    return 2.0 * z * sum + real(exponent) * LN2;
}

// e^y for y <= 0: 2^k e^f with |f| <= ln2 / 2, whose series ends at 0.35^17 / 17!; zero where 2^k is not normal.
real exponential(real y) {
    real k = floor(y / LN2 + 0.5);
    real f = y - k * LN2;
    real sum = (1.0 + f * I(1) * (1.0 + f * I(2) * (1.0 + f * I(3) * (1.0 + f * I(4) * (1.0 + f * I(5) * (1.0 + f * I(6) * (1.0 + f * I(7) * (1.0 + f * I(8) * (1.0 + f * I(9) * (1.0 + f * I(10) * (1.0 + f * I(11) * (1.0 + f * I(12) * (1.0 + f * I(13) * (1.0 + f * I(14) * (1.0 + f * I(15) * (1.0 + f * I(16) * (1.0 + f * I(17))))))))))))))))));
    bool normal = k > -1022.0;
    uint exponent = uint(normal ? int(k) + 1023 : 0);
    return sum * packDouble2x32(uvec2(0, exponent << 20));
}

// For 0 < x <= 1 and p >= 0.
real power(real x, real p) {
    return exponential(min(p * logarithm(x), real(0.0)));
}
#else
real logarithm(real x) {
    return log(x);
}

real power(real x, real p) {
    return pow(x, p);
}
#endif

#endif
