#ifndef SCATTERS_GLSL
#define SCATTERS_GLSL
// Sums into the bins of targets. No sum is atomic, and the order of additions is that of the partners, the same in each run.
// Where a lane owns a target, its sums accumulate in private or workgroup memory, which is not bounds-checked and costs a CPU driver
// a third of what buffers do. Where lanes share a target, they accumulate in workgroup memory: each lane notes what it has to
// scatter, and `reduce_scattered` adds that up. Expects `SCATTER_SETS`, the number of sets of bins.

#include "cooperative.glsl"

// Whether three channels accumulate in workgroup memory where a lane owns a target. CPU drivers access private memory channel by
// channel, workgroup memory a bin at a time.
layout(constant_id = 11) const bool SHARED_DEPOSITS = false;

const bool SCATTERING = SCATTER_SETS > 0;
const bool OWN_DEPOSITS = SCATTERING && !TARGETS_ARE_SHARED;
const bool COMMON_SCATTERED = SCATTERING && TARGETS_ARE_SHARED;
const uint GREY_DEPOSITS = OWN_DEPOSITS && CHANNELS == 1 ? SCATTER_SETS * BINS : 1;
const uint RGB_DEPOSITS = OWN_DEPOSITS && CHANNELS == 3 ? SCATTER_SETS * BINS : 1;
const uint OWN_RGB_DEPOSITS = SHARED_DEPOSITS ? 1 : RGB_DEPOSITS;
const uint SHARED_RGB_DEPOSITS = SHARED_DEPOSITS ? RGB_DEPOSITS * WORKGROUP : 1;
// Reals per target.
const uint COMMON_REALS = SCATTER_SETS * BINS * CHANNELS;

real grey_deposits[GREY_DEPOSITS];
real3 rgb_deposits[OWN_RGB_DEPOSITS];
shared real3 shared_deposits[SHARED_RGB_DEPOSITS];
// By target, set, bin and channel.
const uint ALL_COMMON_REALS = COMMON_SCATTERED ? TARGETS * COMMON_REALS : 1;
shared real common_scattered[ALL_COMMON_REALS];

// What lanes have noted: the first two of four bins, 16 bits each, their weights, and the value of each channel.
const uint NOTES = COMMON_SCATTERED ? WORKGROUP : 1;
shared uint noted_bins[NOTES];
shared real noted_weights[4 * NOTES];
shared real noted_values[3 * NOTES];
uint noted_first = 0;
Taps noted_taps = Taps(uvec4(0), real4(0.0));
real3 noted_value = real3(0.0);

uint in_shared(uint at) {
    return gl_LocalInvocationID.x * RGB_DEPOSITS + at;
}

void clear_scattered() {
    if (OWN_DEPOSITS) {
        for (uint at = 0; at < SCATTER_SETS * BINS; at++) {
            if (CHANNELS == 1) {
                grey_deposits[at] = 0.0;
            } else if (SHARED_DEPOSITS) {
                shared_deposits[in_shared(at)] = real3(0.0);
            } else {
                rgb_deposits[at] = real3(0.0);
            }
        }
    }
    if (COMMON_SCATTERED) {
        for (uint at = gl_LocalInvocationID.x; at < ALL_COMMON_REALS; at += WORKGROUP) {
            common_scattered[at] = 0.0;
        }
        barrier();
    }
}

// `direction`: unit, in world coordinates, in the hemisphere of `normal`; `first`: first bin of the set. Where lanes share
// targets, at most once before the next `reduce_scattered`.
void scatter(uint first, real3 normal, real3 direction, real3 value) {
    if (OWN_DEPOSITS) {
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
    if (COMMON_SCATTERED) {
        noted_taps = taps(in_frame(normal, direction));
        noted_first = first;
        noted_value = value;
    }
}

// Adds what the lanes have noted, in the order of their turns. Two lanes never add to the same bin: of those that share a target
// each owns a channel of every other row of bins, and a scatter meets two rows. All lanes must call it.
void reduce_scattered() {
    if (COMMON_SCATTERED) {
        uint lane = gl_LocalInvocationID.x;
        noted_bins[lane] = (noted_first + noted_taps.bin.x) | (noted_first + noted_taps.bin.y) << 16;
        for (uint tap = 0; tap < 4; tap++) {
            noted_weights[4 * lane + tap] = noted_taps.weight[tap];
        }
        for (uint channel = 0; channel < 3; channel++) {
            noted_values[3 * lane + channel] = noted_value[channel];
        }
        noted_value = real3(0.0);
        barrier();
        uint target = lane / COOPERATIVE, channel = lane % COOPERATIVE / 2, parity = lane & 1;
        for (uint turn = 0; turn < COOPERATIVE && channel < CHANNELS; turn++) {
            uint from = turn * TARGETS + target;
            real value = noted_values[3 * from + channel];
            uint first = noted_bins[from] & 0xffff, second = noted_bins[from] >> 16;
            uint row = first / COLUMNS % 2 == parity ? 0 : 1;
            uint bins = target * SCATTER_SETS * BINS + row * COLUMNS;
            uint weights = 4 * from + 2 * row;
            // A lane without anything to add has noted no bins.
            for (uint once = value != 0.0 ? 1 : 0; once > 0; once--) {
                common_scattered[(bins + first) * CHANNELS + channel] += noted_weights[weights] * value;
                common_scattered[(bins + second) * CHANNELS + channel] += noted_weights[weights + 1] * value;
            }
        }
        barrier();
    }
}

// The sum of one bin.
real3 deposited(uint at) {
    if (COMMON_SCATTERED) {
        uint first = lane_target() * COMMON_REALS + at * CHANNELS;
        return real3(common_scattered[first], common_scattered[first + CHANNELS / 3], common_scattered[first + CHANNELS / 3 * 2]);
    }
    if (CHANNELS == 1) {
        return real3(grey_deposits[at]);
    }
    return SHARED_DEPOSITS ? shared_deposits[in_shared(at)] : rgb_deposits[at];
}

// Adds one set to bins in a buffer, which is bound as an array of real, `grey`, and of packed real3, `rgb`. `factor`
// may use `bin`.
#define FLUSH_DEPOSITS(set, grey, rgb, first, factor)                \
    for (uint bin = lane_turn(); bin < BINS; bin += COOPERATIVE) {       \
        real3 sum = deposited((set) + bin) * (factor);               \
        if (CHANNELS == 1) {                                         \
            grey[(first) + bin] += sum.r;                            \
        } else {                                                     \
            rgb[(first) + bin] += sum;                               \
        }                                                            \
    }

#endif
