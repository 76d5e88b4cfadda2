#ifndef RECEIVER_BINS_GLSL
#define RECEIVER_BINS_GLSL
// Irradiance into the bins of a receiver. A lane owns a receiver and gathers its bins in memory of its own, which costs
// a CPU driver a third of what buffers do, being neither masked nor bounds-checked. Only one lane ever writes a
// receiver's bins: no atomics, and the same sums in the same order from run to run. Expects the
// buffer of the receivers' bins, `arriving` as an array of real and `arriving_rgb` as one of packed real3, and `bin_table`.

layout(constant_id = 9) const bool RECEIVER_BINS = false;
const uint GREY_DEPOSITS = RECEIVER_BINS && CHANNELS == 1 ? BINS : 1;
const uint RGB_DEPOSITS = RECEIVER_BINS && CHANNELS == 3 ? BINS : 1;

real grey_deposits[GREY_DEPOSITS];
real3 rgb_deposits[RGB_DEPOSITS];

void clear_deposits() {
    if (RECEIVER_BINS) {
        for (uint at = 0; at < BINS; at++) {
            if (CHANNELS == 1) {
                grey_deposits[at] = 0.0;
            } else {
                rgb_deposits[at] = real3(0.0);
            }
        }
    }
}

// `direction`: unit, from the receiver to the source.
void deposit(real3 normal, real3 direction, real3 value) {
    if (RECEIVER_BINS) {
        Taps t = taps(direction * orthonormal_basis(normal));
        for (uint tap = 0; tap < 4; tap++) {
            uint at = t.bin[tap];
            if (CHANNELS == 1) {
                grey_deposits[at] += t.weight[tap] * value.r;
            } else {
                rgb_deposits[at] += t.weight[tap] * value;
            }
        }
    }
}

// Adds what was gathered to the receiver's bins, as radiance: H(b) / c_b. `first`: its first bin in its page.
void flush_deposits(uint first) {
    if (RECEIVER_BINS) {
        for (uint at = 0; at < BINS; at++) {
            real to_radiance = 1.0 / bin_table[at].w;
            if (CHANNELS == 1) {
                arriving[first + at] += grey_deposits[at] * to_radiance;
            } else {
                arriving_rgb[first + at] += rgb_deposits[at] * to_radiance;
            }
        }
    }
}

#endif
