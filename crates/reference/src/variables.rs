//! Triangles as variables, by whose numbers is derived.

use antirad_core::model::{Dual, DualVector, Facet, FacetGradient, centroid};
use glam::DVec3;

/// Numbers of a triangle that the operators read, in the order of [`FacetGradient`].
pub const NUMBERS: usize = 14;

/// A triangle whose numbers are those by which is derived from an index on. Its centroid is the mean of its corners.
pub fn variable<const N: usize>(facet: &Facet, first: usize) -> Facet<DualVector<N>> {
    let corners = std::array::from_fn(|k| DualVector::variable(facet.corners[k], first + 3 * k));
    Facet {
        corners,
        centroid: centroid(corners),
        normal: DualVector::variable(facet.normal, first + 9),
        area: Dual::variable(facet.area, first + 12),
        characteristic_area: Dual::variable(facet.characteristic_area, first + 13),
    }
}

/// The derivatives by these numbers.
pub fn gradient(slopes: &[f64]) -> FacetGradient {
    let vector = |first: usize| DVec3::from_slice(&slopes[first..]);
    FacetGradient {
        corners: [vector(0), vector(3), vector(6)],
        normal: vector(9),
        area: slopes[12],
        characteristic_area: slopes[13],
    }
}
