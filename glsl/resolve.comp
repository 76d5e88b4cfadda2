#version 450 core
#extension GL_GOOGLE_include_directive : require
// Pixels from samples: each lane adds to its pixel the mean colour of the samples that see a face of this page of
// faces, and to alpha their fraction. Pages are accumulated over the same pixels, initially zero.

#include "picture.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

layout(std430, set = 0, binding = 0) readonly buffer Samples { uint sample_face[]; };
// RGB; three per face.
layout(std430, set = 0, binding = 1) readonly buffer Colours { vec4 colour[]; };
// Three per face: the function a x + b y + c of the picture's plane that is a corner's weight over the depth.
layout(std430, set = 0, binding = 2) readonly buffer Corners { vec4 corner[]; };
layout(std430, set = 0, binding = 3) buffer Pixels { vec4 pixel[]; };

layout(push_constant) uniform Push {
    // In samples: the whole picture, and the current band of rows.
    uint width;
    uint height;
    uint first_row;
    uint rows;
    // Samples per side of a pixel.
    uint side;
    // The faces of this page.
    uint first_face;
    uint face_count;
};

vec3 interpolated(uint face, uvec2 at) {
    vec3 p = vec3(place_of_sample(uvec2(at.x, first_row + at.y), uvec2(width, height)), 1.0);
    vec3 weight;
    for (uint i = 0; i < 3; i++) {
        // Rounding can put a sample just outside its face: weights must not extrapolate.
        weight[i] = max(dot(corner[3 * face + i].xyz, p), 0.0);
    }
    float sum = weight.x + weight.y + weight.z;
    weight = sum > 0.0 ? weight / sum : vec3(1.0 / 3.0);
    return weight.x * colour[3 * face].rgb + weight.y * colour[3 * face + 1].rgb + weight.z * colour[3 * face + 2].rgb;
}

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    uint columns = width / side;
    if (at.x >= columns || at.y >= rows / side) return;
    vec4 sum = vec4(0.0);
    for (uint v = 0; v < side; v++) {
        for (uint u = 0; u < side; u++) {
            uvec2 place = at * side + uvec2(u, v);
            // Faces before the page wrap around to large indices, like that of the background.
            uint face = sample_face[place.y * width + place.x] - first_face;
            if (face < face_count) {
                sum += vec4(interpolated(face, place), 1.0);
            }
        }
    }
    pixel[at.y * columns + at.x] += sum / float(side * side);
}
