//! Lambert's polygon formula, the integral of the near field. Twin of crates/core/glsl/near_field.glsl.

use super::facet::quarters;
use super::scalar::Scalar;
use super::vector::Vector;
use glam::DVec3;

/// ∫ cosθ dω over a triangle seen from `point` with normal `normal`, clipped at the horizon, in [0, π] sr, by Lambert's
/// polygon formula. Independent of the triangle's orientation.
///
/// The derivative does not depend on where a side ends in the horizon, since cosθ = 0 there: the share of the
/// side that is above is held fixed, which avoids the slope of a quotient of two heights that may vanish
/// together.
pub fn projected_solid_angle<V: Vector>(point: V, normal: V, corners: [V; 3]) -> V::Scalar {
    let corner = corners.map(|c| c - point);
    let height = corner.map(|c| c.value().dot(normal.value()));
    let mut sum = V::Scalar::from(0.0);
    let (mut enter, mut exit) = (V::from(DVec3::ZERO), V::from(DVec3::ZERO));
    for k in 0..3 {
        let next = (k + 1) % 3;
        let (mut a, mut b) = (corner[k], corner[next]);
        let (above_a, above_b) = (height[k] > 0.0, height[next] > 0.0);
        if !above_a && !above_b {
            continue;
        }
        if above_a != above_b {
            let t = height[k] / (height[k] - height[next]);
            let crossing = a * (1.0 - t) + b * t;
            if above_a {
                b = crossing;
                exit = crossing;
            } else {
                a = crossing;
                enter = crossing;
            }
        }
        sum = sum + edge(a, b).dot(normal);
    }
    // The side of the clipped polygon that lies in the horizon.
    sum = sum + edge(exit, enter).dot(normal);
    (sum * 0.5).abs()
}

/// Projected solid angles of the quarters of a triangle, sr, in the order of [`quarters`]. Of their twelve
/// sides, nine are different.
pub(crate) fn projected_quarters(point: DVec3, normal: DVec3, corners: [DVec3; 3]) -> [f64; 4] {
    let [a, b, c] = corners.map(|corner| corner - point);
    let lowest = a.dot(normal).min(b.dot(normal)).min(c.dot(normal));
    if lowest <= 0.0 {
        return quarters(corners).map(|quarter| projected_solid_angle(point, normal, quarter));
    }
    let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
    let side = |from: DVec3, to: DVec3| edge(from, to).dot(normal);
    let middle = [side(ca, ab), side(ab, bc), side(bc, ca)];
    [
        side(a, ab) - middle[0] + side(ca, a),
        side(ab, b) + side(b, bc) - middle[1],
        side(bc, c) + side(c, ca) - middle[2],
        middle[0] + middle[1] + middle[2],
    ]
    .map(|sum| (0.5 * sum).abs())
}

/// θ Γ of one side: the angle it subtends times the unit normal of its plane through the origin.
fn edge<V: Vector>(a: V, b: V) -> V {
    let cross = a.cross(b);
    let sine = cross.length();
    if sine <= 1e-12 * (a.value().length_squared() + b.value().length_squared()) {
        // The point is on the side, or the side has no length: it bounds no solid angle.
        return DVec3::ZERO.into();
    }
    cross * (sine.atan2(a.dot(b)) / sine)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::DualVector;

    /// The value, and its gradient by the point, the normal and the corners.
    fn gradient(point: DVec3, normal: DVec3, corners: [DVec3; 3]) -> (f64, [DVec3; 5]) {
        let [a, b, c] = corners;
        let mut all = [0, 1, 2, 3, 4].into_iter().zip([point, normal, a, b, c]);
        let mut next =
            || all.next().map_or_else(|| unreachable!(), |(k, v)| DualVector::<15>::variable(v, 3 * k));
        let found = projected_solid_angle(next(), next(), [next(), next(), next()]);
        (found.value, std::array::from_fn(|k| DVec3::from_slice(&found.slopes[3 * k..])))
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
        for [a, b, c] in triangles.into_iter().flat_map(|[a, b, c]| [[a, b, c], [b, c, a], [a, c, b]]) {
            let (value, found) = gradient(point, normal, [a, b, c]);
            assert_eq!(value, projected_solid_angle(point, normal, [a, b, c]));
            for (k, found) in found.into_iter().enumerate() {
                // The normal stays a unit vector.
                let ways = if k == 1 { vec![x, y] } else { DVec3::AXES.to_vec() };
                for way in ways {
                    let moved = |step: f64| {
                        let mut all = [point, normal, a, b, c];
                        all[k] += step * way;
                        projected_solid_angle(all[0], all[1].normalize(), [all[2], all[3], all[4]])
                    };
                    let expected = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                    let error = found.dot(way) - expected;
                    assert!(
                        error.abs() <= 1e-8 * expected.abs().max(1.0),
                        "{a} {b} {c}, {k} along {way}: {expected} {error:e}"
                    );
                }
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
            let (_, found) = gradient(o, z, corners);
            assert!(found.iter().all(|by| by.is_finite()), "{corners:?}");
            let size = found[2..].iter().map(|c| c.length()).fold(0.0, f64::max);
            assert!(size < 10.0, "{corners:?}: {found:?}");
        }
    }
}
