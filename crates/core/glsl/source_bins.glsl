#ifndef SOURCE_BINS_GLSL
#define SOURCE_BINS_GLSL
// Radiance of a source per direction bin. Expects the buffers of bins of the source: `antiradiance` and `specular` as
// arrays of real, and the same memory as arrays of packed real3, `antiradiance_rgb` and `specular_rgb`, which takes
// one load instead of three.

layout(constant_id = 7) const bool SOURCE_BACK = false;
layout(constant_id = 8) const bool SOURCE_FRONT = false;

// The part of the radiance that varies with direction: specular from the front, and from the back (J) the negative of
// the radiance incident on the front, which is the state itself: its bins hold A(b) = H(b) / c_b. `direction` is that
// in which light travels; `first`: first bin of the source in its page.
real3 binned_radiance(real3 normal, uint first, real3 direction, bool front) {
    real3 result = real3(0.0);
    // A loop, to skip it where all lanes are on a side that sends no such light: an `if` would not.
    for (uint once = (front ? SOURCE_FRONT : SOURCE_BACK) ? 1 : 0; once > 0; once--) {
        // Light that leaves the back in `direction` was incident from -`direction`.
        Taps t = taps(in_frame(normal, front ? direction : -direction));
        if (SOURCE_FRONT && front) {
            GATHER(specular, specular_rgb, first, t, result)
        }
        if (SOURCE_BACK && !front) {
            GATHER(antiradiance, antiradiance_rgb, first, t, result)
            result = -result;
        }
    }
    return result;
}

#endif
