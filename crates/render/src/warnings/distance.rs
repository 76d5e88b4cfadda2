//! Distances between triangles.

use glam::DVec3;

/// The shortest vector from one triangle to another; zero where they touch or intersect.
pub fn between(a: [DVec3; 3], b: [DVec3; 3]) -> DVec3 {
    if crosses(a, b) || crosses(b, a) {
        return DVec3::ZERO;
    }
    let mut shortest = DVec3::INFINITY;
    let mut take = |v: DVec3| {
        if v.length_squared() < shortest.length_squared() {
            shortest = v;
        }
    };
    for k in 0..3 {
        take(to_triangle(a[k], b));
        take(-to_triangle(b[k], a));
        for l in 0..3 {
            take(between_segments([a[k], a[(k + 1) % 3]], [b[l], b[(l + 1) % 3]]));
        }
    }
    shortest
}

/// The shortest vector from a point to a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
pub fn to_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a - p;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b - p;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3)) - p;
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c - p;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6)) - p;
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))) - p;
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum) - p
}

/// The shortest vector from one segment to another (Ericson, 5.1.9).
fn between_segments([p, p_end]: [DVec3; 2], [q, q_end]: [DVec3; 2]) -> DVec3 {
    let (d, e, r) = (p_end - p, q_end - q, p - q);
    let (dd, ee, de) = (d.length_squared(), e.length_squared(), d.dot(e));
    let (dr, er) = (d.dot(r), e.dot(r));
    let fraction = |x: f64, whole: f64| if whole > 0.0 { (x / whole).clamp(0.0, 1.0) } else { 0.0 };
    let determinant = dd * ee - de * de;
    let s = fraction(de * er - dr * ee, determinant);
    let t = fraction(de * s + er, ee);
    // Where t was clamped, the best s changes.
    let s = fraction(t * de - dr, dd);
    (q + e * t) - (p + d * s)
}

/// Whether an edge of `a` passes through the interior of `b`.
fn crosses(a: [DVec3; 3], b: [DVec3; 3]) -> bool {
    let normal = (b[1] - b[0]).cross(b[2] - b[0]);
    (0..3).any(|k| {
        let (from, to) = (a[k], a[(k + 1) % 3]);
        let (above, below) = ((from - b[0]).dot(normal), (to - b[0]).dot(normal));
        if above * below >= 0.0 {
            return false;
        }
        let point = from.lerp(to, above / (above - below));
        let inside = |l: usize| (b[(l + 1) % 3] - b[l]).cross(point - b[l]).dot(normal) >= 0.0;
        (0..3).all(inside)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_kit::Random;

    const UNIT: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    fn moved(by: DVec3) -> [DVec3; 3] {
        UNIT.map(|c| c + by)
    }

    #[test]
    fn distances_by_hand() {
        for (other, distance) in [
            (moved(DVec3::new(0.1, 0.1, 0.3)), 0.3),
            (moved(DVec3::new(3.0, 0.0, 0.0)), 2.0),
            (moved(DVec3::X), 0.0),
            // Edges cross in projection only.
            ([DVec3::new(0.5, -1.0, 0.2), DVec3::new(0.5, 1.0, 0.2), DVec3::new(0.5, 0.0, 2.0)], 0.2),
            // Through the middle.
            ([DVec3::new(0.2, 0.2, -1.0), DVec3::new(0.3, 0.2, 1.0), DVec3::new(0.2, 0.3, 1.0)], 0.0),
            (moved(DVec3::new(1.0, 1.0, 0.0)), 0.5f64.sqrt()),
        ] {
            let found = between(UNIT, other);
            assert!((found.length() - distance).abs() <= 1e-12, "{found} instead of {distance}");
            assert!((between(other, UNIT) + found).length() <= 1e-12);
        }
    }

    /// No point of a grid on one triangle is closer to the other than the distance, and some point is nearly as close.
    #[test]
    fn distances_by_sampling() {
        let mut random = Random::new(7);
        for _ in 0..200 {
            let mut triangle = || [0; 3].map(|_| random.point());
            let (a, b) = (triangle(), triangle());
            let distance = between(a, b).length();
            let mut sampled = f64::INFINITY;
            for (u, v) in (0..=40).flat_map(|u| (0..=40 - u).map(move |v| (u as f64 / 40.0, v as f64 / 40.0)))
            {
                let point = a[0] + (a[1] - a[0]) * u + (a[2] - a[0]) * v;
                sampled = sampled.min(to_triangle(point, b).length());
            }
            assert!(sampled >= distance - 1e-12 && sampled <= distance + 0.05, "{sampled} and {distance}");
        }
    }
}
