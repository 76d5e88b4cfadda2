//! Derivatives through the frame of a triangle, and through the normalisation of a vector.

use super::facet::{basis_sign, orthonormal_basis};
use glam::DVec3;

/// The gradient with respect to d, from that with respect to d/|d|. `unit` is d/|d|, `length` is |d|.
pub fn pull_unit(unit: DVec3, length: f64, gradient: DVec3) -> DVec3 {
    (gradient - unit * unit.dot(gradient)) / length
}

/// The gradient with respect to a world direction and the normal, each as an unconstrained vector.
pub struct FrameGradient {
    /// By the direction.
    pub direction: DVec3,
    /// By the normal.
    pub normal: DVec3,
}

/// The gradients with respect to d and n, from that with respect to Rᵀd, where R(n) is the frame of
/// [`orthonormal_basis`]. The sign in the frame is held constant, since the frame jumps where it changes.
pub fn pull_local(n: DVec3, d: DVec3, local: DVec3) -> FrameGradient {
    let sign = basis_sign(n);
    let a = -1.0 / (sign + n.z);
    let across = n.x * d.x + n.y * d.y;
    // Rᵀd = (d.x + sign a n.x across - sign d.z n.x, sign d.y + a n.y across - d.z n.y, n·d), with da/dn.z = a².
    let x = sign * DVec3::new(a * (across + n.x * d.x) - d.z, a * n.x * d.y, a * a * n.x * across);
    let y = DVec3::new(a * n.y * d.x, a * (across + n.y * d.y) - d.z, a * a * n.y * across);
    let basis = orthonormal_basis(n);
    FrameGradient { direction: basis * local, normal: local.x * x + local.y * y + local.z * d }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central differences with step 1e-6, whose error is 1e-10; along tangents for the normal, which stays a unit vector.
    #[test]
    fn frames_match_their_derivative() {
        let d = DVec3::new(0.3, -0.7, 0.2).normalize();
        let cotangent = DVec3::new(0.9, -0.4, 1.1);
        let normals =
            [(0.3, 0.5, 0.7), (-0.2, 0.9, -0.4), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.8, 0.6, 1e-3)];
        for n in normals.map(|(x, y, z)| DVec3::new(x, y, z).normalize()) {
            let value = |n: DVec3, d: DVec3| (orthonormal_basis(n).transpose() * d).dot(cotangent);
            let found = pull_local(n, d, cotangent);
            let basis = orthonormal_basis(n);
            for tangent in [basis.x_axis, basis.y_axis] {
                let at = |step: f64| value((n + step * tangent).normalize(), d);
                let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((found.normal.dot(tangent) - slope).abs() <= 1e-9, "{n}: {slope}");
            }
            for axis in DVec3::AXES {
                let at = |step: f64| value(n, d + step * axis);
                let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((found.direction.dot(axis) - slope).abs() <= 1e-9, "{n}: {slope}");
            }
        }
    }
}
