#ifndef GEOMETRY_GLSL
#define GEOMETRY_GLSL
// What is known of a triangle, in coordinates scaled so that the scene lies within one unit of the origin.

struct Facet {
    vec3 centre;
    float area;
    // Zero for the slots that only fill up a tile: nothing arrives there.
    vec3 normal;
    // Area of the equilateral triangle with the same sum of squared edges.
    float extent;
};

const float PI = 3.14159265358979;
const float INV_PI = 0.318309886183791;

// Squared distances below this are rounding: 1e-6 of the scene.
const float R2_MIN = 1e-12;

// Columns: two tangents and the normal (Duff et al., JCGT 2017).
mat3 orthonormal_basis(vec3 n) {
    float s = n.z < 0.0 ? -1.0 : 1.0;
    float a = -1.0 / (s + n.z);
    float b = n.x * n.y * a;
    return mat3(vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x), vec3(b, s + n.y * n.y * a, -n.y), n);
}

#endif
