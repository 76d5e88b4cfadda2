#ifndef PASSING_GLSL
#define PASSING_GLSL
// Bits that say what may pass between sources and receivers. Twin: crates/core/src/model/passing.rs.

const uint PAIR_FRONT = 1;
const uint PAIR_BACK = 2;
const uint PAIR_NEAR = 4;

#endif
