//! Gradients with respect to the quantities that the operators read of a triangle, and from these to its corners.

use super::facet::Facet;
use glam::DVec3;
use std::ops::AddAssign;

/// Derivative of a scalar with respect to a [`Facet`], each field with the others held fixed. The centroid is the
/// mean of the corners: a third of its gradient is added to each.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
pub struct FacetGradient {
    /// Per metre.
    pub corners: [DVec3; 3],
    /// With respect to the unit normal as three free numbers; the component along the normal is meaningless.
    pub normal: DVec3,
    /// Per square metre.
    pub area: f64,
    /// Per square metre.
    pub characteristic_area: f64,
}

impl FacetGradient {
    /// From the numbers of a slot, as both backends hold them: corners and areas by fours, then the normal.
    pub fn of_slot(numbers: &[f64]) -> Self {
        let vector = |at: usize| DVec3::new(numbers[at], numbers[at + 1], numbers[at + 2]);
        Self {
            corners: [vector(0), vector(4), vector(8)],
            normal: vector(12),
            area: numbers[3],
            characteristic_area: numbers[7],
        }
    }

    /// Adds a gradient with respect to the centroid.
    pub fn add_centroid(&mut self, gradient: DVec3) {
        for corner in &mut self.corners {
            *corner += gradient / 3.0;
        }
    }

    /// The total derivative with respect to the three corners, per metre: with n = c/|c|, a = |c|/2, c the cross
    /// product of two edges, and s = Σl²/(4√3).
    pub fn to_corners(&self, facet: &Facet) -> [DVec3; 3] {
        let [a, b, c] = facet.corners;
        let mut corners = self.corners;
        if facet.area > 0.0 {
            let n = facet.normal;
            let cross = 0.5 * self.area * n + (self.normal - n * n.dot(self.normal)) / (2.0 * facet.area);
            let (at_b, at_c) = ((c - a).cross(cross), cross.cross(b - a));
            corners[0] -= at_b + at_c;
            corners[1] += at_b;
            corners[2] += at_c;
        }
        // Of Σl²: 2 (a - b) + 2 (a - c) at corner a.
        let scale = self.characteristic_area / (2.0 * 3.0_f64.sqrt());
        for (gradient, corner) in corners.iter_mut().zip([a, b, c]) {
            *gradient += scale * (3.0 * corner - (a + b + c));
        }
        corners
    }
}

impl AddAssign for FacetGradient {
    fn add_assign(&mut self, other: Self) {
        for (to, from) in self.corners.iter_mut().zip(other.corners) {
            *to += from;
        }
        self.normal += other.normal;
        self.area += other.area;
        self.characteristic_area += other.characteristic_area;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central differences at 1e-6: their own error is 1e-10.
    #[test]
    fn corners_move_normal_area_and_characteristic_area() {
        let corners = [DVec3::new(0.1, 0.2, -0.3), DVec3::new(1.0, 0.4, 0.1), DVec3::new(0.3, 1.2, 0.5)];
        let gradient = FacetGradient {
            corners: [DVec3::new(0.3, 0.1, 0.7), DVec3::new(-0.2, 0.5, 0.4), DVec3::new(0.9, -0.8, 0.1)],
            normal: DVec3::new(0.5, -1.3, 0.8),
            area: 1.7,
            characteristic_area: -0.6,
        };
        let value = |corners: [DVec3; 3]| {
            let f = Facet::new(corners);
            let at_corners: f64 = corners.iter().zip(gradient.corners).map(|(c, g)| c.dot(g)).sum();
            at_corners
                + f.normal.dot(gradient.normal)
                + f.area * gradient.area
                + f.characteristic_area * gradient.characteristic_area
        };
        let found = gradient.to_corners(&Facet::new(corners));
        for k in 0..3 {
            for axis in DVec3::AXES {
                let moved = |step: f64| {
                    let mut corners = corners;
                    corners[k] += step * axis;
                    value(corners)
                };
                let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!((found[k].dot(axis) - slope).abs() <= 1e-9, "{k} {axis}: {} {slope}", found[k]);
            }
        }
    }

    #[test]
    fn a_triangle_without_area_has_a_finite_gradient() {
        let gradient =
            FacetGradient { normal: DVec3::ONE, area: 1.0, characteristic_area: 1.0, ..Default::default() };
        for corners in [[DVec3::ONE; 3], [DVec3::ZERO, DVec3::X, 2.0 * DVec3::X]] {
            assert!(gradient.to_corners(&Facet::new(corners)).iter().all(|g| g.is_finite()));
        }
    }
}
