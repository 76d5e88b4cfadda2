#ifndef OCCLUSION_GLSL
#define OCCLUSION_GLSL
// Whether a triangle stands between two points. Expects `boxes`, two corners per node of a tree over the triangles, in the order of a walk,
// each node before its branches; `branches`, where the walk goes on behind those of each node, and the triangles of a leaf; and
// `blockers`, three corners per triangle, with its unit normal in their fourth components.

#include "real.glsl"

// Changes of a coordinate along a segment count as no less.
const real LEAST_CHANGE = 1e-12;

// Whether a triangle has the two points on different sides, farther than `tolerance` from its plane, and the segment between them in it:
// surfaces do not block what lies on them.
bool separates(uint triangle, real3 from, real3 to, real tolerance) {
    real4 a = blockers[3 * triangle], b = blockers[3 * triangle + 1], c = blockers[3 * triangle + 2];
    real3 normal = real3(a.w, b.w, c.w);
    real before = dot(from - a.xyz, normal), behind = dot(to - a.xyz, normal);
    real3 ab = b.xyz - a.xyz, ac = c.xyz - a.xyz;
    real3 at = mix(from, to, before / (before - behind)) - a.xyz;
    // Barycentric coordinates, times twice the area.
    real v = dot(cross(at, ac), normal), w = dot(cross(ab, at), normal);
    return before * behind < 0.0 && min(abs(before), abs(behind)) > tolerance
        && min(v, w) >= 0.0 && v + w <= dot(cross(ab, ac), normal);
}

// Whether any triangle does. `nodes`: those of the tree.
bool occluded(uint nodes, real3 from, real3 to, real tolerance) {
    real3 along = to - from;
    real3 inverse = 1.0 / mix(max(along, real3(LEAST_CHANGE)), min(along, real3(-LEAST_CHANGE)), lessThan(along, real3(0.0)));
    bool found = false;
    uint node = 0;
    while (node < nodes) {
        real3 s = (boxes[2 * node].xyz - from) * inverse, t = (boxes[2 * node + 1].xyz - from) * inverse;
        real3 enter = min(s, t), leave = max(s, t);
        bool meets = max(max(enter.x, enter.y), max(enter.z, 0.0)) <= min(min(leave.x, leave.y), min(leave.z, 1.0));
        uvec4 branch = branches[node];
        uint end = meets ? branch.y + branch.z : branch.y;
        for (uint triangle = branch.y; triangle < end; triangle++) {
            found = found || separates(triangle, from, to, tolerance);
        }
        node = found ? nodes : meets ? node + 1 : branch.x;
    }
    return found;
}

#endif
