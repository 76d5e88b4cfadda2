#ifndef HALF_BINS_GLSL
#define HALF_BINS_GLSL
// Bins of sources as bfloat16, the upper half of an f32: sign, exponent and eight significant bits. A word holds one
// channel of a bin in its upper half and of the bin in the next column, cyclically, in its lower half, so that two
// reads of three words fetch four taps. Written by pack.comp.

layout(constant_id = 10) const bool HALF_BINS = false;

// result += Σ_b T_b values[first + b], `rgb` being an array of packed uvec3.
#define GATHER_HALF_BINS(rgb, first, t, result)                                                      \
    for (uint row = 0; row < 4; row += 2) {                                                       \
        uvec3 pair = rgb[(first) + t.bin[row]];                                                   \
        result += t.weight[row] * real3(uintBitsToFloat(pair & 0xffff0000));                      \
        result += t.weight[row + 1] * real3(uintBitsToFloat(pair << 16));                         \
    }

#endif
