//! Triangulates the polygons of a mesh file.

use earcut::Earcut;
use glam::{DVec2, DVec3};

/// Triangles of a polygon with three corners or more, as indices into `corners`, with its winding.
///
/// Convex polygons become a fan from the first corner. Concave ones are triangulated by ear clipping, which omits
/// coincident corners. Polygons without ears (collinear or self-intersecting) become a fan too: no triangulation is right.
pub(super) fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let ears = if corners.len() > 3 { ears(&project(corners)) } else { Vec::new() };
    match ears.is_empty() {
        true => (2..corners.len()).map(|at| [0, at - 1, at]).collect(),
        false => ears.chunks_exact(3).map(|ear| [ear[0], ear[1], ear[2]]).collect(),
    }
}

/// The triangles of a concave polygon, three corners each; none of a convex one.
fn ears(flat: &[DVec2]) -> Vec<usize> {
    let n = flat.len();
    let is_concave = |at: usize| turn(flat[(at + n - 1) % n], flat[at], flat[(at + 1) % n]) < 0.0;
    let mut ears = Vec::new();
    if (0..n).any(is_concave) {
        Earcut::new().earcut(flat.iter().map(DVec2::to_array), &[], &mut ears);
    }
    ears
}

/// The polygon projected to its plane, counter-clockwise. Newell's normal also suits slightly non-planar polygons.
fn project(corners: &[DVec3]) -> Vec<DVec2> {
    // Relative to the first corner, to keep digits far from the origin, and in units of the polygon's size, to keep areas
    // within the range of f64.
    let relative: Vec<DVec3> = corners.iter().map(|&c| c - corners[0]).collect();
    let size = relative.iter().map(|r| r.abs().max_element()).fold(f64::MIN_POSITIVE, f64::max);
    let relative: Vec<DVec3> = relative.into_iter().map(|r| r / size).collect();
    let normal: DVec3 = relative.iter().zip(relative.iter().cycle().skip(1)).map(|(a, b)| a.cross(*b)).sum();
    let (u, v) = normal.try_normalize().unwrap_or(DVec3::Z).any_orthonormal_pair();
    relative.iter().map(|r| DVec2::new(r.dot(u), r.dot(v))).collect()
}

/// Twice the signed area of abc: positive for a left turn at b.
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> f64 {
        let signed = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|i| corners[i]);
            (b - a).cross(c - a).z / 2.0
        };
        assert!(triangles.iter().all(|t| signed(t) > 0.0), "a triangle is turned: {triangles:?}");
        triangles.iter().map(signed).sum()
    }

    fn polygon(points: &[[f64; 2]]) -> Vec<DVec3> {
        points.iter().map(|&[x, y]| DVec3::new(x, y, 7.0)).collect()
    }

    #[test]
    fn convex_polygons_are_fans() {
        let square = polygon(&[[0., 0.], [1., 0.], [1., 1.], [0., 1.]]);
        assert_eq!(triangulate(&square), [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn concave_polygons_keep_their_area() {
        let arrow = polygon(&[[0., 0.], [2., -1.], [0., 2.], [-2., -1.]]);
        let l = polygon(&[[0., 0.], [3., 0.], [3., 1.], [1., 1.], [1., 3.], [0., 3.]]);
        for (corners, expected) in [(arrow, 4.0), (l, 5.0)] {
            for start in 0..corners.len() {
                let mut turned = corners.clone();
                turned.rotate_left(start);
                let triangles = triangulate(&turned);
                assert_eq!(triangles.len(), corners.len() - 2);
                assert!((area(&turned, &triangles) - expected).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn polygons_without_a_right_answer_still_give_triangles() {
        let point = vec![DVec3::ONE; 5];
        assert_eq!(triangulate(&point).len(), 3);
        let bow_tie = polygon(&[[0., 0.], [1., 1.], [1., 0.], [0., 1.]]);
        assert!(!triangulate(&bow_tie).is_empty());
        // An edge whose length overflows.
        let endless = polygon(&[[-1., 0.], [0., -0.5], [1., 0.], [0., -1.]])
            .iter()
            .map(|&c| c * 1.7e308)
            .collect::<Vec<_>>();
        assert_eq!(triangulate(&endless).len(), 2);
    }

    #[test]
    fn size_does_not_matter() {
        let star = |k: u32| {
            let turn = f64::from(k) / 200.0 * std::f64::consts::TAU;
            f64::from(1 + k % 2) * DVec3::new(turn.cos(), turn.sin(), turn.cos())
        };
        let star: Vec<DVec3> = (0..200).map(star).collect();
        let triangles = triangulate(&star);
        assert_eq!(triangles.len(), 198);
        assert!(area(&star, &triangles) > 0.0);
        for exponent in [-900, -100, 100, 900] {
            let scaled: Vec<DVec3> = star.iter().map(|&c| c * 2f64.powi(exponent)).collect();
            assert_eq!(triangulate(&scaled), triangles, "2^{exponent}");
        }
    }

    /// Two coincident corners, and a hole joined to the outline by a seam.
    #[test]
    fn corners_may_touch() {
        let twice = polygon(&[[0., 0.], [2., 0.], [2., 0.], [2., 2.], [1., 1.], [0., 2.]]);
        assert!((area(&twice, &triangulate(&twice)) - 3.0).abs() < 1e-12);
        let outline = [[0., 0.], [3., 0.], [3., 3.], [0., 3.], [0., 0.]];
        let frame = polygon(&[&outline[..], &[[1., 1.], [1., 2.], [2., 2.], [2., 1.], [1., 1.]]].concat());
        assert!((area(&frame, &triangulate(&frame)) - 8.0).abs() < 1e-12);
    }

    #[test]
    fn large_polygons_are_cut_at_once() {
        let spiral = |k: i32, radius: f64| {
            let turn = f64::from(k) * 0.1;
            (radius + turn) * DVec3::new(turn.cos(), turn.sin(), 0.0)
        };
        let corners: Vec<DVec3> =
            (0..5000).map(|k| spiral(k, 1.5)).chain((0..5000).rev().map(|k| spiral(k, 1.0))).collect();
        let begin = std::time::Instant::now();
        let triangles = triangulate(&corners);
        assert!((area(&corners, &triangles) / 62_300.0 - 1.0).abs() < 0.1 && triangles.len() == 9998);
        assert!(begin.elapsed().as_secs() < 10, "{:?}", begin.elapsed());
    }
}
