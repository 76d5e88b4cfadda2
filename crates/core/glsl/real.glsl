#ifndef REAL_GLSL
#define REAL_GLSL
// The real type of the kernels. Shaders that include this are compiled twice, without and with F64 defined. Literals
// without suffix are exact in both as long as they have few digits; a quotient needs a real() around one side.

#ifdef F64
#define real double
#define real2 dvec2
#define real3 dvec3
#define real4 dvec4
#define real33 dmat3
const real PI = 3.14159265358979323846lf;
const real INV_PI = 0.318309886183790671538lf;
// 1/k, for series.
#define I(k) (real(1.0) / real(k))
#else
#define real float
#define real2 vec2
#define real3 vec3
#define real4 vec4
#define real33 mat3
const real PI = 3.14159265358979;
const real INV_PI = 0.318309886183791;
#endif

#endif
