//! Cuts the polygons of a mesh file into triangles.

use glam::{DVec2, DVec3};

/// Triangles of a polygon with three corners or more, as indices into `corners`, wound like it.
///
/// Convex polygons become a fan from the first corner, concave ones are cut ear by ear. What has no ear left (corners
/// that cross or coincide) becomes a fan too: no triangulation of it is right, and the count stays corners - 2.
pub(super) fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let mut left: Vec<usize> = (0..corners.len()).collect();
    let mut triangles = Vec::with_capacity(corners.len().saturating_sub(2));
    if corners.len() > 3 {
        let flat = project(corners);
        let concave = |at: usize| {
            let n = flat.len();
            turn(flat[(at + n - 1) % n], flat[at], flat[(at + 1) % n]) < 0.0
        };
        if (0..corners.len()).any(concave) {
            while left.len() > 3 {
                let Some(ear) = (0..left.len()).find(|&at| is_ear(&flat, &left, at)) else {
                    break;
                };
                triangles.push(around(&left, ear));
                left.remove(ear);
            }
        }
    }
    triangles.extend(left.windows(2).skip(1).map(|pair| [left[0], pair[0], pair[1]]));
    triangles
}

/// The polygon in its own plane, counter-clockwise. The normal is Newell's, which also suits polygons that bend a bit.
fn project(corners: &[DVec3]) -> Vec<DVec2> {
    // Relative to the first corner, lest a scene far from the origin loses digits.
    let relative: Vec<DVec3> = corners.iter().map(|&c| c - corners[0]).collect();
    let normal: DVec3 = relative.iter().zip(relative.iter().cycle().skip(1)).map(|(a, b)| a.cross(*b)).sum();
    let (u, v) = normal.try_normalize().unwrap_or(DVec3::Z).any_orthonormal_pair();
    relative.iter().map(|r| DVec2::new(r.dot(u), r.dot(v))).collect()
}

/// Twice the signed area of abc: positive for a left turn at b.
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - b)
}

fn around(left: &[usize], at: usize) -> [usize; 3] {
    let n = left.len();
    [left[(at + n - 1) % n], left[at], left[(at + 1) % n]]
}

/// True where the corner turns left and its triangle holds no other corner.
fn is_ear(flat: &[DVec2], left: &[usize], at: usize) -> bool {
    let ear = around(left, at);
    let [a, b, c] = ear.map(|corner| flat[corner]);
    turn(a, b, c) > 0.0
        && left.iter().filter(|corner| !ear.contains(corner)).all(|&corner| {
            let p = flat[corner];
            turn(a, b, p) < 0.0 || turn(b, c, p) < 0.0 || turn(c, a, p) < 0.0
        })
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
        assert_eq!(triangulate(&bow_tie).len(), 2);
    }
}
