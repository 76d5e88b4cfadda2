#ifndef SPREAD_GRADIENT_GLSL
#define SPREAD_GRADIENT_GLSL
// Derivatives of spread.glsl. Twin: crates/core/src/model/clusters/mean_cosine.rs.

#include "spread.glsl"

// From the derivatives by the values of spread_over(to, from, tilt, spread, 1) to those by `to`, `from`, `tilt` and `spread`; zero
// where there is no light.
real4 spread_pull(Spread by, real to, real from, real tilt, real spread) {
    real width = sqrt(max(1.5 * spread * (1.0 - tilt * tilt), 0.0));
    bool straddles = width > 0.0 && abs(to) <= width;
    real by_width = straddles ? 1.0 / width : real(0.0);
    real above = straddles ? 0.5 + 0.5 * to * by_width : real(to > 0.0);
    real mean = straddles ? above * above * width : max(to, 0.0);
    real second = mean - tilt * from - 3.0 * mean * from * from;
    bool dark = !(mean + above * 2.0 * spread * second > 0.0);
    real by_mean = by.mean + by.cosine * (1.0 + above * 2.0 * spread * (1.0 - 3.0 * from * from));
    real by_above = by.above + by.cosine * 2.0 * spread * second;
    real at_to = by_mean * above + by_above * 0.5 * by_width;
    real at_width = straddles ? by_mean * above * (1.0 - above) - by_above * 0.5 * to * by_width * by_width : real(0.0);
    real at_from = -by.cosine * above * 2.0 * spread * (tilt + 6.0 * mean * from);
    real at_tilt = -by.cosine * above * 2.0 * spread * from - at_width * 1.5 * spread * tilt * by_width;
    real at_spread = by.cosine * above * 2.0 * second + at_width * 0.75 * (1.0 - tilt * tilt) * by_width;
    return dark ? real4(0.0) : real4(at_to, at_from, at_tilt, at_spread);
}

#endif
