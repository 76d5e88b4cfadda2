//! A ray, and where it meets a triangle in f64.

use super::frame::{Frame, GROWN};
use glam::DVec3;

/// Rays begin so close to the middle of the frame at most, along them, that f32 is accurate.
const AROUND: f64 = 2.0;
/// Nothing is farther from where a ray begins, in units of the frame: [`AROUND`] and a radius of 1, and what rounding adds.
pub const FARTHEST: f32 = 4.0;

/// Where a ray starts, and its unit direction.
#[derive(Clone, Copy)]
pub struct Way {
    pub origin: DVec3,
    pub direction: DVec3,
}

/// A ray with what is the same for all boxes and triangles.
pub struct Ray {
    /// Where it begins in the frame, and its direction.
    pub begin: [f32; 3],
    pub direction: [f32; 3],
    /// A distance becomes a limit by this factor and term.
    limit: [f64; 2],
    origin: [f64; 3],
    /// The axes, in the order of a right hand, the one along which the ray goes most last.
    axes: [usize; 3],
    /// By how much the other two are sheared so that the ray goes along the last, and one over the direction along that.
    shear: [f64; 2],
    inverse: f64,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub distance: f64,
    /// Whether the ray comes from the front of the triangle.
    pub front: bool,
}

impl Ray {
    /// The ray; `None` if it has no direction.
    #[inline(always)]
    pub fn new(frame: &Frame, Way { origin, direction }: Way) -> Option<Self> {
        let [x, y, z] = direction.abs().to_array();
        let last = if x > y && x > z { 0 } else { 1 + usize::from(z > y) };
        let axes = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][last];
        let along = direction.to_array();
        let inverse = 1.0 / along[axes[2]];
        let at = frame.point(origin);
        // From far away it begins close by.
        let skipped = (-at.dot(direction) - AROUND).max(0.0);
        let begin = at + skipped * direction;
        let is_ray = inverse.is_finite() && begin.is_finite();
        is_ray.then(|| Self {
            begin: begin.as_vec3().to_array(),
            direction: direction.as_vec3().to_array(),
            limit: [frame.scale * (1.0 + GROWN), GROWN - skipped * (1.0 + GROWN)],
            origin: origin.to_array(),
            axes,
            shear: [along[axes[0]] * inverse, along[axes[1]] * inverse],
            inverse,
        })
    }

    /// What hits up to a distance may have in f32 at most.
    #[inline(always)]
    pub fn limit(&self, distance: f64) -> f32 {
        (distance * self.limit[0] + self.limit[1]).min(f64::from(FARTHEST)) as f32
    }

    /// Where the ray meets a triangle, if it does so farther away than a distance.
    ///
    /// Corners are seen along the ray: each becomes a point of the plane, the same for all triangles that share it, and of the ray remains the origin
    /// (Woop, Benthin and Wald 2013, "Watertight ray/triangle intersection"). On which side of an edge that is, is decided exactly, so no ray passes
    /// between triangles that share edges and corners. In its own plane a triangle is not met.
    #[inline(always)]
    pub fn hit(&self, corners: &[[f64; 3]; 3], epsilon: f64) -> Option<Hit> {
        let [i, j, k] = self.axes;
        let seen = |corner: &[f64; 3]| {
            let depth = corner[k] - self.origin[k];
            let place = [
                corner[i] - self.origin[i] - self.shear[0] * depth,
                corner[j] - self.origin[j] - self.shear[1] * depth,
            ];
            (place, depth)
        };
        let [(a, a_depth), (b, b_depth), (c, c_depth)] =
            [seen(&corners[0]), seen(&corners[1]), seen(&corners[2])];
        let (of_a, of_b, of_c) = (cross(b, c), cross(c, a), cross(a, b));
        let some_negative = (of_a < 0.0) | (of_b < 0.0) | (of_c < 0.0);
        let some_positive = (of_a > 0.0) | (of_b > 0.0) | (of_c > 0.0);
        if some_negative & some_positive {
            return None;
        }
        let area = of_a + of_b + of_c;
        let distance = (of_a * a_depth + of_b * b_depth + of_c * c_depth) * self.inverse / area;
        // Neither is true where the area is zero.
        (distance > epsilon).then_some(Hit { distance, front: area * self.inverse < 0.0 })
    }
}

/// a × b, with the right sign.
#[inline(always)]
fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    let (plus, minus) = (a[0] * b[1], a[1] * b[0]);
    if plus == minus {
        // They differ by what rounding took from them.
        return a[0].mul_add(b[1], -plus) - a[1].mul_add(b[0], -minus);
    }
    plus - minus
}
