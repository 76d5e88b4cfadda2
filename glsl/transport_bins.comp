#version 450 core
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
// U where source, receiver or both have bins, point to point:
//     H_j(b) += T_b(ω_j) max(cos_j, 0) |cos_i| g_ij a_i · (front: L_i(ω_i); back: -A_i(ω_i)).
// A workgroup is one subgroup; a lane owns one receiver. Every lane loads one source, and all lanes take it from there
// by broadcast. Twin: src/reference/transport.rs.

#include "geometry.glsl"
#include "near_field.glsl"
#include "bins.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 0) const uint LANES = 8;
layout(constant_id = 1) const uint TILE = 64;

layout(std430, binding = 0) readonly buffer Facets { Facet facets[]; };
layout(std430, binding = 1) readonly buffer Radiance { vec4 radiance[]; };
layout(std430, binding = 2) readonly buffer TilePairs { uint tile_pairs[]; };
layout(std430, binding = 3) buffer Irradiance { vec4 irradiance[]; };
layout(std430, binding = 4) readonly buffer Antiradiance { float antiradiance[]; };
layout(scalar, binding = 4) readonly buffer AntiradianceRgb { vec3 antiradiance_rgb[]; };
layout(std430, binding = 5) readonly buffer Specular { float specular[]; };
layout(scalar, binding = 5) readonly buffer SpecularRgb { vec3 specular_rgb[]; };
layout(std430, binding = 6) buffer Arriving { float arriving[]; };
layout(scalar, binding = 6) buffer ArrivingRgb { vec3 arriving_rgb[]; };
// Centre of each bin in the frame of the triangle, and c_b.
layout(std430, binding = 7) readonly buffer BinTable { vec4 bin_table[]; };

#include "far_push.glsl"
#include "source_bins.glsl"
#include "receiver_bins.glsl"

void main() {
    uint tile = receiver_tile + gl_WorkGroupID.x;
    uint j = tile * TILE + gl_WorkGroupID.y * LANES + gl_LocalInvocationID.x;
    Facet receiver = facets[j];
    vec3 sum = vec3(0.0);
    clear_deposits();
    for (uint source_tile = source_begin; source_tile < source_end; source_tile++) {
        uint flags = pair_flags(tile, source_tile);
        bool fronts = (flags & PAIR_FRONT) != 0;
        bool backs = SOURCE_BACK && (flags & PAIR_BACK) != 0;
        bool near = (flags & PAIR_NEAR) != 0;
        uint batches = fronts || backs ? TILE / LANES : 0;
        for (uint batch = 0; batch < batches; batch++) {
            uint mine = source_tile * TILE + batch * LANES + gl_LocalInvocationID.x;
            Facet f = facets[mine];
            vec3 light = radiance[mine].rgb;
            for (uint lane = 0; lane < LANES; lane++) {
                uint i = source_tile * TILE + batch * LANES + lane;
                vec3 x = subgroupBroadcast(f.centre, lane);
                vec3 n = subgroupBroadcast(f.normal, lane);
                vec3 l = subgroupBroadcast(light, lane);
                float area = subgroupBroadcast(f.area, lane);
                float extent = subgroupBroadcast(f.extent, lane);
                vec3 d = receiver.centre - x;
                float r2 = max(dot(d, d), R2_MIN);
                float from = dot(d, n);
                float to = max(-dot(d, receiver.normal), 0.0);
                float share = near ? far_share(r2, half_range * (extent + receiver.extent)) : 1.0;
                float side = from > 0.0 ? float(fronts) : float(backs);
                float weight = side * share * abs(from) * to * area / (r2 * (r2 + area * INV_PI));
                // A loop, for the same reason as elsewhere: it is skipped where no lane has anything to add.
                for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
                    vec3 direction = d * inversesqrt(r2);
                    bool front = from > 0.0;
                    vec3 binned = binned_radiance(n, (i - source_page) * BINS, direction, front);
                    vec3 value = weight * (front ? l + binned : binned);
                    deposit(receiver.normal, -direction, value);
                    sum += value;
                }
            }
        }
    }
    irradiance[j].rgb += sum;
    flush_deposits((j - receiver_page) * BINS);
}
