#ifndef HALF_BINS_GLSL
#define HALF_BINS_GLSL
// Bins of sources in half the bits: of each f32 the upper half (bfloat16), which has its sign, all of its exponent and
// eight significant bits. A word holds one channel of a bin in its upper half and of the bin in the next column, after the
// last one the first, in its lower half: two reads of three words fetch four taps. Made by pack.comp.

layout(constant_id = 10) const bool HALF_BINS = false;

// result += Σ_b T_b values[first + b], `rgb` being an array of packed uvec3.
#define GATHER_HALF_BINS(rgb, first, t, result)                                                      \
    for (uint row = 0; row < 4; row += 2) {                                                       \
        uvec3 pair = rgb[(first) + t.bin[row]];                                                   \
        result += t.weight[row] * real3(uintBitsToFloat(pair & 0xffff0000));                      \
        result += t.weight[row + 1] * real3(uintBitsToFloat(pair << 16));                         \
    }

#endif
