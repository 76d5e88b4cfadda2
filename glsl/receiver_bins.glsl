#ifndef RECEIVER_BINS_GLSL
#define RECEIVER_BINS_GLSL
// Irradiance into the bins of a receiver. Expects an `arriving` array of float. Only one lane ever writes a receiver's
// bins: no atomics, and the same sums in the same order from run to run.

layout(constant_id = 9) const bool RECEIVER_BINS = false;

// `direction`: unit, from the receiver to the source. `first`: first bin of the receiver in its page.
void deposit(vec3 normal, uint first, vec3 direction, vec3 value) {
    if (RECEIVER_BINS) {
        Taps t = taps(direction * orthonormal_basis(normal));
        for (uint tap = 0; tap < 4; tap++) {
            uint at = (first + t.bin[tap]) * CHANNELS;
            for (uint c = 0; c < CHANNELS; c++) {
                arriving[at + c] += t.weight[tap] * value[c];
            }
        }
    }
}

#endif
