//! Lambert's polygon formula, the integral of the near field. Twin of glsl/near_field.glsl.

use super::facet::quarters;
use glam::DVec3;

/// ∫ cosθ dω over a triangle seen from `point` with normal `normal`, clipped at the horizon, in [0, π] sr, by Lambert's
/// polygon formula. Independent of the triangle's orientation.
pub fn projected_solid_angle(point: DVec3, normal: DVec3, corners: [DVec3; 3]) -> f64 {
    let corner = corners.map(|c| c - point);
    let height = corner.map(|c| c.dot(normal));
    let mut sum = 0.0;
    let (mut enter, mut exit) = (DVec3::ZERO, DVec3::ZERO);
    for k in 0..3 {
        let next = (k + 1) % 3;
        let (mut a, mut b) = (corner[k], corner[next]);
        let (above_a, above_b) = (height[k] > 0.0, height[next] > 0.0);
        if !above_a && !above_b {
            continue;
        }
        if above_a != above_b {
            let crossing = a.lerp(b, height[k] / (height[k] - height[next]));
            if above_a {
                b = crossing;
                exit = crossing;
            } else {
                a = crossing;
                enter = crossing;
            }
        }
        sum += edge(a, b).dot(normal);
    }
    // The side of the clipped polygon that lies in the horizon.
    sum += edge(exit, enter).dot(normal);
    (0.5 * sum).abs()
}

/// The same for the quarters of a triangle, in the order of [`quarters`]: of their twelve sides, nine are different.
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
fn edge(a: DVec3, b: DVec3) -> DVec3 {
    let cross = a.cross(b);
    let sine = cross.length();
    if sine <= 1e-12 * (a.length_squared() + b.length_squared()) {
        // The point is on the side, or the side has no length: it bounds no solid angle.
        return DVec3::ZERO;
    }
    cross * (sine.atan2(a.dot(b)) / sine)
}
