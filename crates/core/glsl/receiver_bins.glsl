#ifndef RECEIVER_BINS_GLSL
#define RECEIVER_BINS_GLSL
// Adds irradiance to the bins of a receiver, which a lane owns. Expects the buffer of the receivers' bins, `incident`
// as an array of real and `incident_rgb` as one of packed real3, and `bin_table`.

layout(constant_id = 9) const bool RECEIVER_BINS = false;
const uint SCATTER_SETS = RECEIVER_BINS ? 1 : 0;

#include "scattered.glsl"

// Adds the sums to the receiver's bins, as radiance: H(b) / c_b. `first`: its first bin in its page.
void flush_scattered(uint first) {
    if (RECEIVER_BINS) {
        FLUSH_DEPOSITS(0, incident, incident_rgb, first, 1.0 / bin_table[bin].w)
    }
}

#endif
