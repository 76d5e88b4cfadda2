#version 450 core
#extension GL_GOOGLE_include_directive : require
// What points see of lamps, by rays: the vector irradiance of a lamp as if nothing stood in between, and the sums of weights of rays to it, of
// all and of those that arrive. RAYS lanes share a pair of a point and a lamp, and take a ray each. Twin:
// crates/core/src/direct/sampling.rs.

#include "near_field.glsl"

const uint WORKGROUP = 64;
const uint RAYS = 16;
const uint PAIRS = WORKGROUP / RAYS;

layout(local_size_x = 64) in;

layout(std430, binding = 0) readonly buffer Boxes { real4 boxes[]; };
layout(std430, binding = 1) readonly buffer Branches { uvec4 branches[]; };
layout(std430, binding = 2) readonly buffer Blockers { real4 blockers[]; };
// Where the triangles of each lamp begin, and the end of the last.
layout(std430, binding = 3) readonly buffer Lamps { uint lamps[]; };
// Three corners per triangle of a lamp, with its unit normal in their fourth components.
layout(std430, binding = 4) readonly buffer Emitters { real4 emitters[]; };
// Area up to the end of each of these, as a share of its lamp's, in units of 2^-32.
layout(std430, binding = 5) readonly buffer Ends { uint ends[]; };
// Point and unit normal of each pair.
layout(std430, binding = 6) readonly buffer Points { real4 points[]; };
// Lamp of each pair, and the numbers of its rays: the first, and the end of the last.
layout(std430, binding = 7) readonly buffer Wanted { uvec4 wanted[]; };
// Per pair, the vector irradiance and the sum of all weights, then the sum of those that arrive.
layout(std430, binding = 8) buffer Found { real4 found[]; };

layout(push_constant) uniform LampRaysPush {
    // Height up to which a point counts as in a plane.
    real tolerance;
    // First pair, and the end of the last.
    uint first;
    uint end;
    // Numbers of the rays of this dispatch, as far as wanted: the first, a multiple of RAYS, and the end of the last.
    uint first_ray;
    uint end_ray;
    // 1 to add to the sums of an earlier dispatch.
    uint add;
    // Nodes of the tree.
    uint nodes;
};

#include "occlusion.glsl"

const real UNIT = real(1.0) / real(4294967296.0);

shared real4 seen[WORKGROUP];
shared real arrives[WORKGROUP];

// A number that mixes all bits of another.
uint mixed(uint x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

// A point of the sequence of Sobol' in the unit square, in units of 2^-32.
uvec2 sobol(uint index) {
    uint second = index ^ (index >> 16);
    second ^= (second & 0xff00ff00u) >> 8;
    second ^= (second & 0xf0f0f0f0u) >> 4;
    second ^= (second & 0xccccccccu) >> 2;
    second ^= (second & 0xaaaaaaaau) >> 1;
    return bitfieldReverse(uvec2(index, second));
}

// The digits that the sequence of a point and a lamp has flipped.
uvec2 shifts(real3 point, uint lamp) {
    uvec3 bits = floatBitsToUint(vec3(point));
    uint state = mixed(mixed(mixed(mixed(lamp) ^ bits.x) ^ bits.y) ^ bits.z);
    uint first = mixed(state + 1);
    return uvec2(first, mixed(first + 1));
}

// The triangle of a lamp in which a place lies, from `low` on and below `high`.
uint triangle_at(uint place, uint low, uint high) {
    while (low + 1 < high) {
        uint middle = (low + high - 1) / 2;
        bool beyond = ends[middle] <= place;
        low = beyond ? middle + 1 : low;
        high = beyond ? high : middle + 1;
    }
    return low;
}

void main() {
    uint at = gl_LocalInvocationID.x;
    uint lane = at % RAYS;
    uint pair = first + gl_WorkGroupID.x * PAIRS + at / RAYS;
    bool exists = pair < end;
    pair = min(pair, end - 1);
    uint lamp = wanted[pair].x, first_wanted = wanted[pair].y, end_wanted = wanted[pair].z;
    uint begin = lamps[lamp], behind = lamps[lamp + 1];
    real3 point = points[2 * pair].xyz, normal = points[2 * pair + 1].xyz;

    real3 irradiance = real3(0.0);
    for (uint i = max(first_ray, first_wanted) == 0 ? begin + lane : behind; i < behind; i += RAYS) {
        real4 a = emitters[3 * i], b = emitters[3 * i + 1], c = emitters[3 * i + 2];
        bool before = dot(point - a.xyz, real3(a.w, b.w, c.w)) > tolerance;
        real3 whole = vector_irradiance(normal, a.xyz - point, b.xyz - point, c.xyz - point);
        irradiance += before ? whole : real3(0.0);
    }

    real all = 0.0, arrive = 0.0;
    uvec2 shift = shifts(point, lamp);
    uint last = exists ? min(end_ray, end_wanted) : first_ray;
    for (uint ray = max(first_ray, first_wanted) + lane; ray < last; ray += RAYS) {
        uvec2 place = sobol(ray) ^ shift;
        uint i = triangle_at(place.x, begin, behind);
        uint before = i > begin ? ends[i - 1] : 0;
        real share = real(place.x - before) / max(real(ends[i] - before), real(1.0));
        real4 a = emitters[3 * i], b = emitters[3 * i + 1], c = emitters[3 * i + 2];
        real3 across = (b.xyz - a.xyz) + UNIT * real(place.y) * (c.xyz - b.xyz);
        real3 to = a.xyz + sqrt(min(share, real(1.0))) * across;
        real3 towards = to - point;
        real squared = dot(towards, towards);
        real received = max(dot(towards, normal), real(0.0));
        real sent = max(-dot(towards, real3(a.w, b.w, c.w)), real(0.0));
        // cosθ cosθ' / r², up to a factor.
        real weight = squared > 0.0 ? received * sent / (squared * squared) : real(0.0);
        all += weight;
        // A loop, since an `if` would not skip the work on a device that executes both sides.
        for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
            arrive += occluded(nodes, point, to, tolerance) ? real(0.0) : weight;
        }
    }

    seen[at] = real4(irradiance, all);
    arrives[at] = arrive;
    for (uint beside = RAYS / 2; beside > 0; beside /= 2) {
        barrier();
        if (lane < beside) {
            seen[at] += seen[at + beside];
            arrives[at] += arrives[at + beside];
        }
    }
    if (exists && lane == 0) {
        real4 before = add != 0 ? found[2 * pair] : real4(0.0);
        real arrived_before = add != 0 ? found[2 * pair + 1].x : real(0.0);
        found[2 * pair] = before + seen[at];
        found[2 * pair + 1] = real4(arrived_before + arrives[at], 0.0, 0.0, 0.0);
    }
}
