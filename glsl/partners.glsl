#ifndef PARTNERS_GLSL
#define PARTNERS_GLSL
// The partners of a dispatch, from its first on, in uniform buffers. All lanes read the same one at a time: GPUs have a path
// for that, and lavapipe takes a quarter of what a broadcast from lane to lane costs. Expects OTHERS_BINDING, the first
// of two bindings.

// 64 KiB of facets, which is what common devices offer.
#ifdef F64
const uint OTHERS = 1024;
#else
const uint OTHERS = 2048;
#endif

layout(std140, binding = OTHERS_BINDING) uniform Others { Facet partners[OTHERS]; };
layout(std140, binding = OTHERS_BINDING + 1) uniform OthersRadiance { real4 others_radiance[OTHERS]; };

#endif
