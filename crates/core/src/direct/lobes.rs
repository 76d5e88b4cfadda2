//! The first bounce of the light of lamps off glossy triangles, per outgoing bin: what they send into transport.
//!
//! At each point of a triangle the light of a lamp counts as coming from the direction of its vector irradiance Φ, with the irradiance
//! ⟨n, Φ⟩; the outgoing directions are the centres of the bins. Pictures show highlights at exact directions instead (`highlight`).

use crate::model::{FrameGradient, orthonormal_basis, pull_local, pull_unit};
use glam::DVec3;

/// The lobe ⟨h, z⟩^p of a direction in the frame of a triangle, and its derivatives by that direction and by p.
fn lobe(to_lamp: DVec3, outgoing: DVec3, power: f64) -> (f64, DVec3, f64) {
    let sum = to_lamp + outgoing;
    let length = sum.length().max(1e-12);
    let cosine = (sum.z / length).max(1e-20);
    let value = if power > 0.0 { cosine.powf(power) } else { 1.0 };
    let by_direction = (DVec3::Z - cosine * sum / length) * (power * value / cosine / length);
    (value, by_direction, cosine.ln() * value)
}

/// Adds weight · ⟨n, Φ⟩ ⟨h, n⟩^p to each outgoing bin.
pub fn add(phi: DVec3, normal: DVec3, weight: f64, bins: &[DVec3], power: f64, to: &mut [f64]) {
    let incident = phi.dot(normal);
    if incident <= 0.0 {
        return;
    }
    let local = orthonormal_basis(normal).transpose() * (phi / phi.length());
    for (to, &outgoing) in to.iter_mut().zip(bins) {
        *to += weight * incident * lobe(local, outgoing, power).0;
    }
}

/// Derivatives of a loss by Φ, n and p, from those by what [`add`] adds to each bin.
pub fn pull_back(
    phi: DVec3,
    normal: DVec3,
    bins: &[DVec3],
    power: f64,
    cotangent: impl Fn(usize) -> f64,
) -> (DVec3, DVec3, f64) {
    let incident = phi.dot(normal);
    if incident <= 0.0 {
        return (DVec3::ZERO, DVec3::ZERO, 0.0);
    }
    let (length, unit) = (phi.length(), phi.normalize());
    let local = orthonormal_basis(normal).transpose() * unit;
    let (mut by_incident, mut by_local, mut by_power) = (0.0, DVec3::ZERO, 0.0);
    for (b, &outgoing) in bins.iter().enumerate() {
        let by = cotangent(b);
        let (value, by_direction, by_exponent) = lobe(local, outgoing, power);
        by_incident += by * value;
        by_local += by * incident * by_direction;
        by_power += by * incident * by_exponent;
    }
    let FrameGradient { direction, normal: by_normal } = pull_local(normal, unit, by_local);
    (by_incident * normal + pull_unit(unit, length, direction), by_incident * phi + by_normal, by_power)
}
