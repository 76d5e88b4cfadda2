//! Limits on the size of a scene and on that of its triangles relative to it.

use std::ops::RangeInclusive;

use glam::DVec3;

use super::{Scene, SceneError};

/// Metres. Beyond this range squares of areas, and with them normals, overflow or underflow in f64.
pub(super) const SIZES: RangeInclusive<f64> = 1e-60..=1e60;
/// Corners closer to a plane than about this fraction of the scene's size count as lying in it, so that triangles of this
/// size exchange no light.
const LEAST: f64 = 1e-6;

/// The corners of the box around some points; around none, +∞ and -∞.
pub fn bounds(points: impl IntoIterator<Item = DVec3>) -> (DVec3, DVec3) {
    let around = |(low, high): (DVec3, DVec3), x| (low.min(x), high.max(x));
    points.into_iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), around)
}

impl Scene {
    /// Checks the sizes of scene and triangles. Requires `degenerate` to be up to date.
    pub(super) fn check_size(&mut self) -> Result<(), SceneError> {
        let corners: Vec<DVec3> = (0..self.triangles.len()).flat_map(|t| self.corners(t)).collect();
        let (low, high) = bounds(corners.iter().copied());
        let size = (high - low).max_element();
        if !SIZES.contains(&size) {
            return Err(SceneError::Size { size });
        }
        let is_small = |t: &usize| {
            let [a, b, c] = self.corners(*t);
            [b - a, c - b, a - c].iter().all(|edge| edge.abs().max_element() < LEAST * size)
        };
        let has_area = |t: &usize| self.degenerate.binary_search(&(*t as u32)).is_err();
        let small: Vec<usize> = (0..self.triangles.len()).filter(has_area).filter(is_small).collect();
        if 2 * small.len() > self.triangles.len() - self.degenerate.len() {
            return Err(self.outlier(&corners, size));
        }
        if let Some(&first) = small.first() {
            self.warn(format!(
                "{} triangle(s) are smaller than {LEAST:.0e} of the scene, which measures {size:.3e} m, \
                 and exchange no light with their neighbours; the first is triangle {first} of mesh \"{}\".",
                small.len(),
                self.mesh_name(first)
            ));
        }
        Ok(())
    }

    /// The error for the corner farthest from the median of all corners.
    fn outlier(&self, corners: &[DVec3], size: f64) -> SceneError {
        let median = DVec3::from([0, 1, 2].map(|axis| {
            let mut along: Vec<f64> = corners.iter().map(|corner| corner[axis]).collect();
            let middle = along.len() / 2;
            *along.select_nth_unstable_by(middle, f64::total_cmp).1
        }));
        let distance = |at: usize| (corners[at] - median).abs().max_element();
        let farthest = (0..corners.len()).max_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
        let triangle = farthest / 3;
        SceneError::Outlier {
            mesh: self.mesh_name(triangle),
            triangle,
            vertex: self.triangles[triangle].vertices[farthest % 3],
            position: corners[farthest],
            size,
        }
    }
}
