#ifndef OTHERS_GLSL
#define OTHERS_GLSL
// The others of a dispatch, from its first on, in uniform buffers. All lanes read the same one at a time: GPUs have a path
// for that, and lavapipe takes a quarter of what a broadcast from lane to lane costs. Expects OTHERS_BINDING, the first
// of two bindings.

// Of sixteen tiles of 64: 64 KiB in double precision, which is what devices promise.
const uint OTHERS = 1024;

layout(std140, binding = OTHERS_BINDING) uniform Others { Facet others[OTHERS]; };
layout(std140, binding = OTHERS_BINDING + 1) uniform OthersRadiance { real4 others_radiance[OTHERS]; };

#endif
