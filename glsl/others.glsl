#ifndef OTHERS_GLSL
#define OTHERS_GLSL
// The others of a dispatch, from its first on, in uniform buffers. All lanes read the same one at a time: GPUs have a path
// for that, and lavapipe takes a quarter of what a broadcast from lane to lane costs. Expects OTHERS_BINDING, the first
// of two bindings, and OTHERS_LIGHT, what to call the values of the second.

// 64 KiB of facets, which is what common devices offer.
#ifdef F64
const uint OTHERS = 1024;
#else
const uint OTHERS = 2048;
#endif

layout(std140, binding = OTHERS_BINDING) uniform Others { Facet others[OTHERS]; };
layout(std140, binding = OTHERS_BINDING + 1) uniform OthersLight { real4 OTHERS_LIGHT[OTHERS]; };

#endif
