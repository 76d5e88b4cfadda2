#ifndef LISTED_GRADIENT_GLSL
#define LISTED_GRADIENT_GLSL
// The derivative of w_ij ⟨L_i(ω_i), λ_ij⟩ by the geometry of a far source, triangle or cluster, and of its receiver, with
// w_ij = blend_ij max(cos_j, 0) |cos_i| g_ij a_i and the cosine of spread.glsl. Expects near_field_gradient.glsl,
// directional_gradient.glsl and `half_range`. Twin: crates/reference/src/lines.rs.

#include "moment.glsl"
#include "spread_gradient.glsl"

struct ListedGradient {
    // By the vector from source to receiver, by both normals, the source's area, its variance if it is a cluster, and the
    // characteristic area of either.
    real3 by_between;
    real3 by_source_normal;
    real3 by_receiver_normal;
    real by_area;
    real by_spread;
    real by_characteristic_area;
};

// `source_moment`, `spread`: the first moment of the light of a cluster, and its variance; 0 of a triangle. The light of each end is diffuse radiance or the cotangent of
// irradiance, and its first bin.
ListedGradient listed_gradient(
    Facet source, real3 source_light, Moment source_moment, uint source_bins, real spread, bool fronts, bool backs, bool near,
    Facet receiver, real3 receiver_light, uint receiver_bins
) {
    ListedGradient g = ListedGradient(real3(0.0), real3(0.0), real3(0.0), 0.0, 0.0, 0.0);
    real3 d = receiver.centre - source.centre;
    real r2 = max(dot(d, d), R2_MIN);
    real3 direction = d * inversesqrt(r2);
    real cos_i = dot(direction, source.normal);
    bool front = cos_i > 0.0;
    real sign_of = front ? 1.0 : -1.0;
    real from = abs(cos_i);
    real to = -dot(direction, receiver.normal);
    real tilt = sign_of * dot(receiver.normal, source.normal);
    real angle2 = spread / r2;
    Spread seen = spread_over(to, from, tilt, angle2, 1.0);
    real range = half_range * (source.characteristic_area + receiver.characteristic_area);
    real blend = 1.0;
    real2 slopes = real2(0.0);
    // A loop, to skip it for sources that are far away, nearly all.
    for (uint once = near ? 1 : 0; once > 0; once--) {
        blend = far_weight(r2, range);
        slopes = far_weight_slopes(r2, range);
    }
    real side = (front ? fronts : backs) ? 1.0 : 0.0;
    real wide = r2 + source.area * INV_PI;
    real kernel = source.area / wide;
    real sent = side * blend * from * kernel;
    real weight = sent * seen.cosine;
    for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
        // What the first moment adds, as radiance.
        real length = sqrt(r2);
        real3 uneven = along(source_moment, spread_slope(seen, receiver.normal, direction, 1.0)) / (length * seen.cosine);
        Exchanged e = exchanged(
            source.normal, source_bins, source_light + uneven, front, receiver.normal, receiver_bins, receiver_light,
            direction, 1.0, 1.0
        );
        real value = dot((front ? source_light : real3(0.0)) + e.binned, e.adjoint);
        // How the importance of light changes with its place in the cluster.
        real3 by_place = (front ? 1.0 / length : 0.0) * of_light(source_moment, e.adjoint);
        Spread by = Spread(value, dot(receiver.normal, by_place), 4.0 * dot(direction, by_place));
        real of_moment = seen.above * by.above + seen.mean * by.mean;
        real whole = seen.cosine * value + of_moment;
        real4 of_cosine = sent * spread_pull(by, to, from, tilt, angle2);
        real by_from = sign_of * (side * blend * kernel * whole + of_cosine[1]);
        real by_tilt = sign_of * of_cosine[2];
        real plain = side * whole * from * kernel;
        real by_r2 =
            slopes.x * plain - blend * plain / wide - (of_cosine[3] * angle2 + 0.5 * sent * of_moment) / r2;
        real3 by_direction = by_from * source.normal - of_cosine[0] * receiver.normal
            + (sent * 4.0 * seen.mean) * by_place + weight * e.by_direction;
        g.by_between = 2.0 * by_r2 * d + through_normalization(by_direction, direction, length);
        g.by_source_normal = by_from * direction + by_tilt * receiver.normal + weight * e.by_source_normal;
        g.by_receiver_normal = -of_cosine[0] * direction + by_tilt * source.normal
            + (sent * seen.above) * by_place + weight * e.by_receiver_normal;
        g.by_area = side * whole * blend * from * r2 / (wide * wide);
        g.by_spread = of_cosine[3] / r2;
        g.by_characteristic_area = slopes.y * plain * half_range;
    }
    return g;
}

#endif
