#version 450 core
#extension GL_GOOGLE_include_directive : require
// U from diffuse fronts to triangles without bins, point to point, over lists of clusters and triangles:
//     E_j += max(cos_j, 0) max(cos_i, 0) g_ij a_i L_i,   g = 1 / (r² + a_i/π).
// A workgroup owns the receivers of one list, LIST / LANES of them in the registers of each lane; or lanes share them (cooperative.glsl). Twin:
// crates/reference/src/lines.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "spread.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer FarLists { uint far_lists[]; };
layout(std430, binding = 2) buffer Irradiance { real4 irradiance[]; };
layout(std430, binding = 3) readonly buffer Radiance { real4 radiance[]; };

#include "far_list.glsl"

const uint PER_LANE = TARGETS_ARE_SHARED ? 1 : LIST / LANES;

void main() {
    uint list = target_list + gl_WorkGroupID.x;
    uint first = list * LIST + gl_WorkGroupID.y * TARGETS + lane_target();
    real3 centre[PER_LANE], normal[PER_LANE], sum[PER_LANE];
    real characteristic_area[PER_LANE];
    for (uint k = 0; k < PER_LANE; k++) {
        Facet f = facets[first + k * LANES];
        centre[k] = f.centre;
        normal[k] = f.normal;
        characteristic_area[k] = f.characteristic_area;
        sum[k] = real3(0.0);
    }
    uvec2 entries = part_of_list(list);
    for (uint at = entries.x; at < entries.y; at += STEP) {
        uint count = fetch(at, entries.y);
        for (uint i = 0; i < count; i++) {
            uint bits = fetched_entry(i) & passing;
            Facet f = fetched_facet(i);
            // Loops that may run zero times: an `if` would not skip the work on a device that executes both branches.
            for (uint once = (bits & PAIR_FRONT) != 0 ? 1 : 0; once > 0; once--) {
                real3 l = fetched_radiance(i) * f.area;
                real s = f.area * INV_PI;
                real spread = spread_of(f);
                bool near = (bits & PAIR_NEAR) != 0;
                for (uint k = 0; k < PER_LANE; k++) {
                    real3 d = centre[k] - f.centre;
                    real r2 = max(dot(d, d), R2_MIN);
                    real from = max(dot(d, f.normal), 0.0);
                    real tilt = dot(normal[k], f.normal);
                    Spread seen = spread_over(-dot(d, normal[k]), from, tilt, spread, r2);
                    for (uint close = near ? 1 : 0; close > 0; close--) {
                        from *= far_weight(r2, half_range * (f.characteristic_area + characteristic_area[k]));
                    }
                    real weight = from / (r2 * (r2 + s));
                    sum[k] += l * (weight * seen.cosine);
                    // A loop, to skip it for triangles.
                    for (uint once = clusters != 0 ? 1 : 0; once > 0; once--) {
                        real3 slope = spread_slope(seen, normal[k], d, r2);
                        sum[k] += along(fetched_moment(i), (f.area * weight) * slope);
                    }
                }
            }
        }
    }
    for (uint k = 0; k < PER_LANE; k++) {
        // Padding is within the horizon of everything.
        real3 all = total(sum[k]);
        if (lane_turn() == 0) {
            irradiance[first + k * LANES].rgb += characteristic_area[k] > 0.0 ? all : real3(0.0);
        }
    }
}
