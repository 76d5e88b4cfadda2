#ifndef SURFACE_GLSL
#define SURFACE_GLSL

// The Blinn-Phong material of one triangle.
struct Surface {
    // δρ.
    vec3 diffuse;
    // p.
    float power;
    // L_e, W/(m² sr).
    vec3 emission;
    float unused_emission;
    // σ N(p), 1/sr.
    vec3 specular;
    float unused_specular;
};

#endif
