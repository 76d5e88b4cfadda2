#version 450 core
// The nearest face behind each sample of a picture, among the faces listed for the sample's tile: one workgroup per
// tile, one lane per sample. Edges and inverse depth of a face are functions a x + b y + c of the coordinates in the
// picture, -1 to 1 on both axes, y upwards; the host prepares them so that a sample is on the face, in front of the
// camera, where all three edges are at least 0. Depths persist between dispatches: each one adds faces to the
// picture.

layout(local_size_x = 16, local_size_y = 16) in;

// The (a, b, c) of the edges in xyz; those of the inverse depth in w.
struct Face {
    vec4 edge[3];
};

layout(std430, set = 0, binding = 0) readonly buffer TileStart { uint tile_start[]; };
layout(std430, set = 0, binding = 1) readonly buffer TileFaces { uint tile_faces[]; };
layout(std430, set = 0, binding = 2) readonly buffer Faces { Face faces[]; };
// The index of each of `faces` in the scene.
layout(std430, set = 0, binding = 3) readonly buffer Numbers { uint number[]; };
layout(std430, set = 0, binding = 4) buffer Depths { float inverse_depth[]; };
layout(std430, set = 0, binding = 5) buffer Samples { uint sample_face[]; };

// In samples: the whole picture, and the current band of rows.
layout(push_constant) uniform Push {
    uint width;
    uint height;
    uint first_row;
    uint rows;
    // Samples along a side of a pixel.
    uint side;
};

const uint NONE = 0xffffffffu;

// The place of a sample, on the rotated grid of its pixel. `at`: its column and row, of `samples` in the whole picture.
vec2 place_of_sample(uvec2 at, uvec2 samples) {
    uvec2 cell = at % side;
    uvec2 within = side * cell + uvec2(side - 1 - cell.y, cell.x);
    vec2 place = vec2(2 * (at / side * side * side + within) + 1) / vec2(samples * side) - 1.0;
    return vec2(place.x, -place.y);
}

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (at.x >= width || at.y >= rows) return;
    uint tile = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    uint end = tile_start[tile + 1];
    uint begin = tile_start[tile];
    if (begin == end) return;

    vec2 p = place_of_sample(uvec2(at.x, first_row + at.y), uvec2(width, height));
    uint here = at.y * width + at.x;
    float best = inverse_depth[here];
    uint found = NONE;
    for (uint i = begin; i < end; i++) {
        uint face = tile_faces[i];
        vec4 e0 = faces[face].edge[0];
        vec4 e1 = faces[face].edge[1];
        vec4 e2 = faces[face].edge[2];
        float inside = min(min(dot(e0.xy, p) + e0.z, dot(e1.xy, p) + e1.z), dot(e2.xy, p) + e2.z);
        float near = e0.w * p.x + e1.w * p.y + e2.w;
        // Lists are in the scene's order: of faces at equal depth the first one wins.
        if (inside >= 0.0 && near > best) {
            best = near;
            found = face;
        }
    }
    if (found != NONE) {
        inverse_depth[here] = best;
        sample_face[here] = number[found];
    }
}
