//! Geometry of a triangle, in f64. Twin of crates/core/glsl/geometry.glsl.

use super::vector::Vector;
use antirad_scene::Rays;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// A triangle with the quantities that the operators read.
#[derive(Clone, Copy, Debug)]
pub struct Facet<V: Vector = DVec3> {
    /// Counter-clockwise, seen from the front.
    pub corners: [V; 3],
    /// The mean of the corners.
    pub centroid: V,
    /// Unit normal; zero for a triangle without area.
    pub normal: V,
    /// Area, in the square of the corners' unit.
    pub area: V::Scalar,
    /// s = Σl²/(4√3): the area of the equilateral triangle with the same sum of squared edges. At least `area`
    /// (Weitzenböck's inequality), equal for equilateral triangles, and large for needles, whose area says little
    /// about their size.
    pub characteristic_area: V::Scalar,
}

/// Rays among triangles, of which those without area stop none.
pub fn rays_among(facets: &[Facet]) -> Arc<Rays> {
    let corners = facets.iter().map(|facet| facet.corners).collect();
    Rays::shared(corners, |i| facets[*i as usize].area > 0.0)
}

impl Facet {
    /// The facet of three corners in any unit of length; areas are in its square.
    pub fn new(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let squares = (b - a).length_squared() + (c - b).length_squared() + (a - c).length_squared();
        Self {
            corners,
            centroid: centroid(corners),
            normal: cross.normalize_or_zero(),
            area: 0.5 * cross.length(),
            characteristic_area: squares / (4.0 * 3.0_f64.sqrt()),
        }
    }
}

impl<V: Vector> Facet<V> {
    /// A direction of the world in this triangle's frame, z along the normal.
    pub fn to_local(&self, direction: V) -> V {
        let [x, y] = tangents(self.normal);
        V::from_array([x, y, self.normal].map(|axis| axis.dot(direction)))
    }
}

/// The mean of three corners.
pub fn centroid<V: Vector>([a, b, c]: [V; 3]) -> V {
    (a + b + c) / 3.0
}

/// The four triangles that the midpoints of the edges cut a triangle into, each a quarter of the area.
pub fn quarters<V: Vector>([a, b, c]: [V; 3]) -> [[V; 3]; 4] {
    let [ab, bc, ca] = [a + b, b + c, c + a].map(|sum| sum * 0.5);
    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
}

/// Columns: two tangents and the normal.
pub fn orthonormal_basis(n: DVec3) -> DMat3 {
    let [x, y] = tangents(n);
    DMat3::from_cols(x, y, n)
}

/// After Duff et al. (JCGT 2017), continuous except at n.z = `FRAME_SWITCH`.
fn tangents<V: Vector>(n: V) -> [V; 2] {
    let sign = basis_sign(n.value());
    let [x, y, z] = n.to_array();
    let a = V::Scalar::from(-1.0) / (z + sign);
    let b = x * y * a;
    [V::from_array([x * x * a * sign + 1.0, b * sign, -x * sign]), V::from_array([b, y * y * a + sign, -y])]
}

/// The n.z at which the frame is discontinuous: no wall, floor or roof of a usual slope has it, nor a triangle of a
/// round shape. At 0, as in Duff et al., rounding in the slope of a wall would rotate its bins, unseen by any
/// derivative.
const FRAME_SWITCH: f64 = -0.6543;

/// The sign that keeps the frame away from its singular normal.
pub fn basis_sign(n: DVec3) -> f64 {
    if n.z < FRAME_SWITCH { -1.0 } else { 1.0 }
}
