#ifndef ADJOINT_BINS_GLSL
#define ADJOINT_BINS_GLSL
// Bins in the adjoint: reads the cotangents of a receiver's bins and scattered into those of a source. Expects
// `cotangent` and `cotangent_rgb`, the cotangent of H(b) at the receivers; and of the sources `outgoing_back` with
// `outgoing_back_rgb`, the resulting state, `outgoing_front` with `outgoing_front_rgb`, the cotangent of specular
// radiance, and `bin_table`.

layout(constant_id = 7) const bool SOURCE_BACK = false;
layout(constant_id = 8) const bool SOURCE_FRONT = false;
layout(constant_id = 9) const bool RECEIVER_BINS = false;
const uint BACK_SETS = SOURCE_BACK ? 1 : 0;
const uint FRONT_SETS = SOURCE_FRONT ? 1 : 0;
const uint SCATTER_SETS = BACK_SETS + FRONT_SETS;
const uint FRONT_SET = BACK_SETS * BINS;

#include "scattered.glsl"

// Σ_b T_b λ(b): the importance of irradiance from `direction`. `first`: first bin of the receiver in its page.
real3 binned_cotangent(real3 normal, uint first, real3 direction) {
    real3 result = real3(0.0);
    if (RECEIVER_BINS) {
        Taps t = taps(in_frame(normal, direction));
        GATHER(cotangent, cotangent_rgb, first, t, result)
    }
    return result;
}

// Adds the cotangent `value` of the radiance in `direction` to the bins of the source: the transpose of
// `binned_radiance`.
void scatter_radiance(real3 normal, real3 direction, bool front, real3 value) {
    if (SOURCE_FRONT || SOURCE_BACK) {
        bool kept = front ? SOURCE_FRONT : SOURCE_BACK;
        for (uint once = kept ? 1 : 0; once > 0; once--) {
            scatter(front ? FRONT_SET : 0, normal, front ? direction : -direction, front ? value : -value);
        }
    }
}

// J^T is the identity on a state of A(b) = H(b) / c_b, of which this is the cotangent of H(b).
void flush_radiance(uint first) {
    if (SOURCE_BACK) {
        FLUSH_DEPOSITS(0, outgoing_back, outgoing_back_rgb, first, 1.0 / bin_table[bin].w)
    }
    if (SOURCE_FRONT) {
        FLUSH_DEPOSITS(FRONT_SET, outgoing_front, outgoing_front_rgb, first, 1.0)
    }
}

#endif
