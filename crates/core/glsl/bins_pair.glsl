#ifndef BINS_PAIR_GLSL
#define BINS_PAIR_GLSL
// U from one source to one receiver where either has bins, point to point. Expects near_field.glsl, source_bins.glsl,
// receiver_bins.glsl, `half_range`, and `real3 light(uint at)`, the diffuse radiance of the source at a place.
// Where SPREAD is defined, sources may be clusters, or volumes if `volumes` is not 0; then also spread.glsl, `real spread_of(Facet
// source)`, and `Moment moment(uint at)`, the first moment of that radiance.

// `bins`: first bin of the source in its page. Adds to the scattered, and the sum of all bins to `sum`.
void receive(
    Facet receiver,
    Facet source,
    uint at,
    uint bins,
    bool fronts,
    bool backs,
    bool near,
    inout real3 sum
) {
    real3 d = receiver.centre - source.centre;
    real r2 = max(dot(d, d), R2_MIN);
    real from = dot(d, source.normal);
    real to = -dot(d, receiver.normal);
    real blend = 1.0;
    // A loop, to skip it for sources that are far away, nearly all.
    for (uint once = near ? 1 : 0; once > 0; once--) {
        blend = far_weight(r2, half_range * (source.characteristic_area + receiver.characteristic_area));
    }
#ifdef SPREAD
    real tilt = from > 0.0 ? dot(receiver.normal, source.normal) : -dot(receiver.normal, source.normal);
    Spread seen = volumes != 0
        ? spread_in_space(to, spread_of(source))
        : spread_over(to, abs(from), tilt, spread_of(source), r2);
    to = seen.cosine;
    // The intensity of volumes is net of cosines.
    real sent = volumes != 0 ? sqrt(r2) : abs(from);
#else
    to = max(to, 0.0);
    real sent = abs(from);
#endif
    real side = from > 0.0 ? real(fronts) : real(backs);
    real weight = side * blend * sent * to * source.area / (r2 * (r2 + source.area * INV_PI));
    // A loop, to skip it where no lane has anything to add.
    for (uint once = weight > 0.0 ? 1 : 0; once > 0; once--) {
        real3 direction = d * inversesqrt(r2);
        bool front = from > 0.0;
        real3 binned = binned_radiance(source.normal, bins, direction, front);
        real3 value = weight * (front ? light(at) + binned : binned);
#ifdef SPREAD
        real3 uneven = along(moment(at), weight / to * spread_slope(seen, receiver.normal, d, r2));
        value += front ? uneven : real3(0.0);
#endif
        scatter(0, receiver.normal, -direction, value);
        sum += value;
    }
}

#endif
