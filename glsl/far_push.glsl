#ifndef FAR_PUSH_GLSL
#define FAR_PUSH_GLSL
// What the point-to-point kernels are told, and the four bits the plan keeps for each pair of tiles. A lane owns a
// triangle, the receiver forwards and the source in the adjoint, and walks over the others.

layout(push_constant) uniform FarPush {
    // First tile of owners; the workgroup's index counts from it.
    uint owner_tile;
    // Tiles of others, from `other_begin` to before `other_end`.
    uint other_begin;
    uint other_end;
    // Words per row of `tile_pairs`.
    uint row_words;
    // Half of the near field's range in units of the extents: half_range · (s_i + s_j), area.
    float half_range;
    // First slots of the pages that are bound.
    uint owner_page;
    uint other_page;
    // What may pass: PAIR_BACK is left out in a pass of emission alone.
    uint passing;
};

const uint PAIR_FRONT = 1;
const uint PAIR_BACK = 2;
const uint PAIR_NEAR = 4;

uint pair_flags(uint receiver, uint source) {
    return tile_pairs[receiver * row_words + (source >> 3)] >> ((source & 7) * 4) & passing;
}

#endif
