#ifndef PARTNERS_GLSL
#define PARTNERS_GLSL
// The partners of a dispatch, from its first on, in uniform buffers. All lanes read the same one at a time, for which
// GPUs have a fast path, and which costs lavapipe a quarter of a broadcast between lanes. Expects PARTNERS_BINDING,
// the first of two bindings, and PARTNERS_LIGHT, the name of the values at the second.

// 64 KiB of facets, the uniform buffer size of common devices.
#ifdef F64
const uint PARTNERS = 1024;
#else
const uint PARTNERS = 2048;
#endif

layout(std140, binding = PARTNERS_BINDING) uniform Partners { Facet partners[PARTNERS]; };
layout(std140, binding = PARTNERS_BINDING + 1) uniform PartnersLight { real4 PARTNERS_LIGHT[PARTNERS]; };

#endif
