#ifndef DIRECTIONAL_GRADIENT_GLSL
#define DIRECTIONAL_GRADIENT_GLSL
// The product of the radiance L of a source in a direction and the importance λ at the receiver, with its
// derivatives. Expects the bins of the source (source_bins.glsl), and those of the receiver, `cotangent` and
// `cotangent_rgb`: the cotangent of H(b).

layout(constant_id = 9) const bool RECEIVER_BINS = false;

// What depends on the direction between source and receiver.
struct Exchanged {
    // L without blend weights, diffuse and binned; λ.
    real3 diffuse;
    real3 binned;
    real3 adjoint;
    // ∂⟨weight_d diffuse + weight_b binned, λ⟩ with respect to the direction and to both normals.
    real3 by_direction;
    real3 by_source_normal;
    real3 by_receiver_normal;
};

// `direction`: unit, from source to receiver. `diffuse_weight` and `binned_weight`: blend weights of the two kinds of
// radiance.
Exchanged exchanged(
    real3 source_normal, uint source_first, real3 source_diffuse, bool front, real3 receiver_normal,
    uint receiver_first, real3 receiver_adjoint, real3 direction, real diffuse_weight, real binned_weight
) {
    Exchanged e;
    e.diffuse = front ? source_diffuse : real3(0.0);
    e.binned = real3(0.0);
    e.adjoint = receiver_adjoint;
    e.by_direction = real3(0.0);
    e.by_source_normal = real3(0.0);
    e.by_receiver_normal = real3(0.0);
    real3 sent[4] = real3[4](real3(0.0), real3(0.0), real3(0.0), real3(0.0));
    real3 adjoint[4] = real3[4](real3(0.0), real3(0.0), real3(0.0), real3(0.0));
    bool directional = front ? SOURCE_FRONT : SOURCE_BACK;
    real3 outward = front ? direction : -direction;
    Taps from, to;
    real3 from_local, to_local;
    for (uint once = directional ? 1 : 0; once > 0; once--) {
        from_local = in_frame(source_normal, outward);
        from = taps(from_local);
        for (uint tap = 0; tap < 4; tap++) {
            uint at = source_first + from.bin[tap];
            if (SOURCE_FRONT && front) {
                sent[tap] = specular_rgb[at];
            }
            if (SOURCE_BACK && !front) {
                sent[tap] = -antiradiance_rgb[at];
            }
            e.binned += from.weight[tap] * sent[tap];
        }
    }
    if (RECEIVER_BINS) {
        to_local = in_frame(receiver_normal, -direction);
        to = taps(to_local);
        for (uint tap = 0; tap < 4; tap++) {
            adjoint[tap] = cotangent_rgb[receiver_first + to.bin[tap]];
            e.adjoint += to.weight[tap] * adjoint[tap];
        }
    }
    for (uint once = directional ? 1 : 0; once > 0; once--) {
        real4 value = binned_weight * real4(dot(sent[0], e.adjoint), dot(sent[1], e.adjoint), dot(sent[2], e.adjoint), dot(sent[3], e.adjoint));
        real3 by_local = taps_gradient(from_local, from, value);
        real3 by_outward = orthonormal_basis(source_normal) * by_local;
        e.by_direction += front ? by_outward : -by_outward;
        e.by_source_normal = frame_gradient(source_normal, outward, by_local);
    }
    if (RECEIVER_BINS) {
        real3 radiance = diffuse_weight * e.diffuse + binned_weight * e.binned;
        real4 value = real4(dot(adjoint[0], radiance), dot(adjoint[1], radiance), dot(adjoint[2], radiance), dot(adjoint[3], radiance));
        real3 by_local = taps_gradient(to_local, to, value);
        e.by_direction -= orthonormal_basis(receiver_normal) * by_local;
        e.by_receiver_normal = frame_gradient(receiver_normal, -direction, by_local);
    }
    return e;
}

// From the gradient with respect to d/|d| to that with respect to d.
real3 through_normalization(real3 by_direction, real3 direction, real length) {
    return (by_direction - direction * dot(direction, by_direction)) / length;
}

#endif
