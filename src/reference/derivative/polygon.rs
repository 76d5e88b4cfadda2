//! Lambert's polygon formula, clipped at the horizon, with its gradient.

use glam::DVec3;

/// ∫ cosθ dω over a triangle, and its derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub struct Polygon {
    /// The value, as of [`projected_solid_angle`](crate::reference::projected_solid_angle), sr.
    pub projected: f64,
    /// Derivative with respect to the normal. Only the part perpendicular to the normal is valid, which is all that a unit vector
    /// needs; the part along it lacks the side in the horizon.
    pub normal: DVec3,
    /// Derivatives with respect to the corners, sr/m; that with respect to the point is minus their sum.
    pub corners: [DVec3; 3],
}

/// The projected solid angle by Lambert's polygon formula, and its derivatives. With a → b a side of the clipped triangle
/// relative to the point, u the unit normal of the plane through the point and the side, θ the angle that the side subtends, and
/// P = |Σ θ u·n|/2:
///
/// ```text
/// d(θ u·n) = θ u·dn + (φ b - a/|a|²) × q · da + q × (φ a - b/|b|²) · db,   φ = θ/|a × b|,   q = n - (u·n) u,
/// ```
///
/// up to a term n × b/|b|² · db - n × a/|a|² · da that cancels between neighbouring sides. Clipping is simple for two reasons.
/// The side in the horizon has q = 0: it contributes to the value only. And where a side ends in the horizon at a + t (b - a), P
/// does not depend on t, since cosθ = 0 there. The ends may therefore be held at fixed t, which avoids a quotient of two heights
/// that vanish together.
pub fn projected_solid_angle_gradient(point: DVec3, normal: DVec3, corners: [DVec3; 3]) -> Polygon {
    let corner = corners.map(|c| c - point);
    let height = corner.map(|c| c.dot(normal));
    let mut sum = 0.0;
    let mut gradient = Polygon::default();
    let (mut enter, mut exit) = (DVec3::ZERO, DVec3::ZERO);
    for k in 0..3 {
        let next = (k + 1) % 3;
        let (mut a, mut b) = (corner[k], corner[next]);
        let (above_a, above_b) = (height[k] > 0.0, height[next] > 0.0);
        if !above_a && !above_b {
            continue;
        }
        // Where the clipped side begins and ends, from 0 at one corner to 1 at the next.
        let (mut begin, mut end) = (0.0, 1.0);
        if above_a != above_b {
            let t = height[k] / (height[k] - height[next]);
            let crossing = a.lerp(b, t);
            if above_a {
                (b, end) = (crossing, t);
                exit = crossing;
            } else {
                (a, begin) = (crossing, t);
                enter = crossing;
            }
        }
        let side = Side::new(a, b, normal);
        sum += side.vector.dot(normal);
        gradient.normal += side.vector;
        gradient.corners[k] += (1.0 - begin) * side.at_a + (1.0 - end) * side.at_b;
        gradient.corners[next] += begin * side.at_a + end * side.at_b;
    }
    sum += Side::new(exit, enter, normal).vector.dot(normal);
    let sign = 0.5_f64.copysign(sum);
    Polygon {
        projected: sign * sum,
        normal: sign * gradient.normal,
        corners: gradient.corners.map(|c| sign * c),
    }
}

/// One side of the polygon.
#[derive(Clone, Copy, Default)]
struct Side {
    /// θ u.
    vector: DVec3,
    /// Derivative of θ u·n with respect to a, without the terms that cancel.
    at_a: DVec3,
    /// The same with respect to b.
    at_b: DVec3,
}

impl Side {
    fn new(a: DVec3, b: DVec3, n: DVec3) -> Self {
        let cross = a.cross(b);
        let sine = cross.length();
        if sine <= 1e-12 * (a.length_squared() + b.length_squared()) {
            // The point is on the side, or the side has no length: it bounds no solid angle.
            return Self::default();
        }
        let phi = sine.atan2(a.dot(b)) / sine;
        let u = cross / sine;
        let q = n - u * u.dot(n);
        Self {
            vector: cross * phi,
            at_a: (phi * b - a / a.length_squared()).cross(q),
            at_b: q.cross(phi * a - b / b.length_squared()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::projected_solid_angle;

    fn moved(vector: DVec3, axis: usize, step: f64) -> DVec3 {
        vector + step * DVec3::AXES[axis]
    }

    /// Triangles above the horizon, across it with one or two corners, and just touching it. Central differences with step 1e-6,
    /// whose error is below 1e-9 for slopes up to 14.
    #[test]
    fn gradients_are_those_of_the_value() {
        let point = DVec3::new(0.2, -0.1, 0.3);
        let normal = DVec3::new(0.3, -0.2, 0.9).normalize();
        let (x, y) = normal.any_orthonormal_pair();
        let at = |a: f64, b: f64, h: f64| point + a * x + b * y + h * normal;
        let triangles = [
            [at(1.0, 0.0, 0.8), at(0.1, 1.0, 1.2), at(-0.7, -0.8, 0.6)],
            [at(1.0, 0.0, 0.8), at(0.1, 1.0, 1.2), at(0.7, 0.8, -0.6)],
            [at(1.0, 0.0, -0.8), at(0.1, 1.0, -0.2), at(0.7, 0.8, 1.6)],
            [at(0.3, 0.1, 0.02), at(0.1, 0.3, -0.01), at(-0.2, -0.2, 0.05)],
            [at(1.0, 0.0, 1e-4), at(0.1, 1.0, -1e-4), at(0.7, 0.8, 1.6)],
        ];
        const STEP: f64 = 1e-6;
        for corners in triangles.into_iter().flat_map(|[a, b, c]| [[a, b, c], [b, c, a], [a, c, b]]) {
            let found = projected_solid_angle_gradient(point, normal, corners);
            assert_eq!(found.projected, projected_solid_angle(point, normal, corners));
            let slope = |value: &dyn Fn(f64) -> f64| (value(STEP) - value(-STEP)) / (2.0 * STEP);
            for axis in 0..3 {
                for k in 0..3 {
                    let expected = slope(&|step| {
                        let mut corners = corners;
                        corners[k] = moved(corners[k], axis, step);
                        projected_solid_angle(point, normal, corners)
                    });
                    let error = found.corners[k][axis] - expected;
                    assert!(
                        error.abs() <= 1e-8 * expected.abs().max(1.0),
                        "{corners:?} corner {k}, axis {axis}: {expected} {error:e}"
                    );
                }
                let expected =
                    slope(&|step| projected_solid_angle(moved(point, axis, step), normal, corners));
                let error = -found.corners.iter().sum::<DVec3>()[axis] - expected;
                assert!(
                    error.abs() <= 1e-8 * expected.abs().max(1.0),
                    "{corners:?} point, axis {axis}: {expected} {error:e}"
                );
            }
            for tangent in [x, y] {
                let expected = slope(&|step| {
                    projected_solid_angle(point, (normal + step * tangent).normalize(), corners)
                });
                let error = found.normal.dot(tangent) - expected;
                assert!(
                    error.abs() <= 1e-8 * expected.abs().max(1.0),
                    "{corners:?} normal: {expected} {error:e}"
                );
            }
        }
    }

    #[test]
    fn degenerate_triangles_have_finite_gradients() {
        let (o, x, y, z) = (DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z);
        // The point on a corner, on a side, inside; flat and collapsed triangles; two corners in the horizon up to rounding.
        let triangles = [
            [o, x, y + z],
            [-x, x, z],
            [x, y, -x - y],
            [x + z, x + z, y + z],
            [z, z, z],
            [x, x + y, z + x],
            [x + 1e-17 * z, x + y - 1e-17 * z, z + x],
            [x, 2.0 * x, 3.0 * x + 1e-9 * z],
            [o, o, o],
        ];
        for corners in triangles {
            let found = projected_solid_angle_gradient(o, z, corners);
            assert!(found.normal.is_finite() && found.corners.iter().all(|c| c.is_finite()), "{corners:?}");
            let size = found.corners.iter().map(|c| c.length()).fold(0.0, f64::max);
            assert!(size < 10.0, "{corners:?}: {found:?}");
        }
    }
}
