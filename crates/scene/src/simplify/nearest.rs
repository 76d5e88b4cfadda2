//! The triangle of a surface that is nearest to a place.

use super::super::bounds;
use super::super::contacts::barycentric;
use antirad_rays::Boxes;
use glam::DVec3;

/// Of the surface's size: how much farther a triangle counts whose front faces away.
const AWAY: f64 = 0.02;
/// Of the surface's size: how far is searched first, and by how much farther each next time.
const FIRST: f64 = 1e-3;
const GROWTH: f64 = 4.0;
/// Barycentric coordinates of places beside a triangle are not taken beyond these.
const BESIDE: [f64; 2] = [-1.0, 2.0];

/// A surface, for searches.
pub(crate) struct Nearest {
    boxes: Boxes,
    middle: DVec3,
    size: f64,
    corners: Vec<[DVec3; 3]>,
}

impl Nearest {
    pub fn new(corners: Vec<[DVec3; 3]>) -> Self {
        let (low, high) = bounds(corners.iter().flatten().copied());
        let size = if corners.is_empty() { 1.0 } else { (high - low).length().max(f64::MIN_POSITIVE) };
        Self { boxes: Boxes::around(&corners), middle: 0.5 * (low + high), size, corners }
    }

    /// The nearest triangle to a place and its distance; those that face the other way than `normal` count as farther. `None` without
    /// any triangles.
    pub fn find(&self, place: DVec3, normal: DVec3) -> Option<(u32, f64)> {
        let mut best = (f64::INFINITY, u32::MAX);
        let mut reach = FIRST * self.size + self.beside(place);
        while !self.corners.is_empty() && best.0 > reach {
            if reach.is_infinite() {
                return None;
            }
            reach *= GROWTH;
            self.boxes.meet(&[place - reach, place + reach], |k| {
                let corners = self.corners[k as usize];
                let away = area_vector(corners).dot(normal) < 0.0;
                let found = distance(corners, place) + if away { AWAY * self.size } else { 0.0 };
                if (found, k) < best {
                    best = (found, k);
                }
                true
            });
        }
        let corners = *self.corners.get(best.1 as usize)?;
        Some((best.1, distance(corners, place)))
    }

    /// How far a place is from the ball around the surface, at most.
    fn beside(&self, place: DVec3) -> f64 {
        (place.distance(self.middle) - 0.5 * self.size).max(0.0)
    }
}

/// Normal times twice the area.
fn area_vector([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// Barycentric coordinates of a place's projection onto a triangle's plane; `None` without area.
fn projected(corners: [DVec3; 3], place: DVec3) -> Option<DVec3> {
    Some(barycentric(corners, area_vector(corners), place)).filter(|found| found.is_finite())
}

/// Barycentric coordinates of a place in the plane of a triangle, or near the triangle where the place is far beside it.
pub(crate) fn beside(corners: [DVec3; 3], place: DVec3) -> DVec3 {
    let [least, most] = BESIDE.map(DVec3::splat);
    let near = projected(corners, place).unwrap_or(DVec3::splat(1.0 / 3.0)).clamp(least, most);
    let sum = near.element_sum();
    if sum.abs() < 0.5 { DVec3::splat(1.0 / 3.0) } else { near / sum }
}

fn distance(corners: [DVec3; 3], place: DVec3) -> f64 {
    if let Some(inside) = projected(corners, place).filter(|b| b.min_element() >= 0.0) {
        let [a, b, c] = corners;
        return (a * inside.x + b * inside.y + c * inside.z).distance(place);
    }
    let to_side = |k: usize| {
        let [from, to] = [corners[k], corners[(k + 1) % 3]];
        let along = to - from;
        let share =
            ((place - from).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (from + share * along).distance(place)
    };
    to_side(0).min(to_side(1)).min(to_side(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_triangle_is_found_from_near_and_far() {
        let square = |z: f64| {
            [[DVec3::ZERO, DVec3::X, DVec3::Y], [DVec3::X, DVec3::X + DVec3::Y, DVec3::Y]]
                .map(|t| t.map(|p| p + z * DVec3::Z))
        };
        let back = square(0.01).map(|[a, b, c]| [a, c, b]);
        let surface = Nearest::new([square(0.0), back].concat());
        let find = |x: f64, y: f64, z: f64, up: f64| surface.find(DVec3::new(x, y, z), up * DVec3::Z);
        assert_eq!(find(0.2, 0.2, 0.003, 1.0), Some((0, 0.003)));
        // The front that faces the same way, though the other one is nearer.
        assert_eq!(find(0.9, 0.8, 0.008, 1.0), Some((1, 0.008)));
        assert_eq!(find(0.9, 0.8, 0.008, -1.0).map(|found| found.0), Some(3));
        assert_eq!(find(-3.0, 0.0, 4.0, 1.0), Some((0, 5.0)));
        assert_eq!(Nearest::new(Vec::new()).find(DVec3::ZERO, DVec3::Z), None);
        let b = beside(square(0.0)[0], DVec3::new(1.0, 1.0, 0.3));
        assert!(b.abs_diff_eq(DVec3::new(-1.0, 1.0, 1.0), 1e-12), "{b}");
    }
}
