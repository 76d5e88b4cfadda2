#ifndef DEPOSITS_GLSL
#define DEPOSITS_GLSL
// Sums into the bins of the triangle that a lane owns. They accumulate in private or workgroup memory, which is not
// bounds-checked and costs a CPU driver a third of what buffers do. Only one lane ever writes a triangle's bins, so
// there are no atomics, and the order of additions is the same in each run. Expects `DEPOSIT_SETS`, the number of
// sets of bins.

// Whether three channels accumulate in workgroup memory. CPU drivers access private memory channel by channel,
// workgroup memory a bin at a time.
layout(constant_id = 11) const bool SHARED_DEPOSITS = false;
// Lanes of the workgroup: as a constant of its own, since Metal takes gl_WorkGroupSize for no constant size of an array.
layout(constant_id = 13) const uint DEPOSITING_LANES = 1;

const bool DEPOSITING = DEPOSIT_SETS > 0;
const uint GREY_DEPOSITS = DEPOSITING && CHANNELS == 1 ? DEPOSIT_SETS * BINS : 1;
const uint RGB_DEPOSITS = DEPOSITING && CHANNELS == 3 ? DEPOSIT_SETS * BINS : 1;
const uint OWN_RGB_DEPOSITS = SHARED_DEPOSITS ? 1 : RGB_DEPOSITS;
const uint SHARED_RGB_DEPOSITS = SHARED_DEPOSITS ? RGB_DEPOSITS * DEPOSITING_LANES : 1;

real grey_deposits[GREY_DEPOSITS];
real3 rgb_deposits[OWN_RGB_DEPOSITS];
shared real3 shared_deposits[SHARED_RGB_DEPOSITS];

uint in_shared(uint at) {
    return gl_LocalInvocationID.x * RGB_DEPOSITS + at;
}

void clear_deposits() {
    if (DEPOSITING) {
        for (uint at = 0; at < DEPOSIT_SETS * BINS; at++) {
            if (CHANNELS == 1) {
                grey_deposits[at] = 0.0;
            } else if (SHARED_DEPOSITS) {
                shared_deposits[in_shared(at)] = real3(0.0);
            } else {
                rgb_deposits[at] = real3(0.0);
            }
        }
    }
}

// `direction`: unit, in world coordinates, in the hemisphere of `normal`; `first`: first bin of the set.
void deposit(uint first, real3 normal, real3 direction, real3 value) {
    if (DEPOSITING) {
        Taps t = taps(in_frame(normal, direction));
        for (uint tap = 0; tap < 4; tap++) {
            uint at = first + t.bin[tap];
            if (CHANNELS == 1) {
                grey_deposits[at] += t.weight[tap] * value.r;
            } else if (SHARED_DEPOSITS) {
                shared_deposits[in_shared(at)] += t.weight[tap] * value;
            } else {
                rgb_deposits[at] += t.weight[tap] * value;
            }
        }
    }
}

// The sum of one bin.
real3 deposited(uint at) {
    if (CHANNELS == 1) {
        return real3(grey_deposits[at]);
    }
    return SHARED_DEPOSITS ? shared_deposits[in_shared(at)] : rgb_deposits[at];
}

// Adds one set to bins in a buffer, which is bound as an array of real, `grey`, and of packed real3, `rgb`. `factor`
// may use `bin`.
#define FLUSH_DEPOSITS(set, grey, rgb, first, factor)                \
    for (uint bin = 0; bin < BINS; bin++) {                          \
        real3 sum = deposited((set) + bin) * (factor);               \
        if (CHANNELS == 1) {                                         \
            grey[(first) + bin] += sum.r;                            \
        } else {                                                     \
            rgb[(first) + bin] += sum;                               \
        }                                                            \
    }

#endif
