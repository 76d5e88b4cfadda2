//! How large a scene may be, and how small its triangles beside it.

use std::ops::RangeInclusive;

use glam::DVec3;

use super::{Scene, SceneError};

/// Metres. Beyond it, squares of areas leave the range of f64, and with them normals and what they decide.
pub(super) const SIZES: RangeInclusive<f64> = 1e-60..=1e60;
/// Corners nearer to a plane than about this share of the scene count as lying in it, so that triangles of this size see
/// nothing of each other.
const LEAST: f64 = 1e-6;

impl Scene {
    /// Checks the sizes of scene and triangles; expects to know which ones have no area.
    pub(super) fn check_size(&mut self) -> Result<(), SceneError> {
        let corners: Vec<DVec3> = (0..self.triangles.len()).flat_map(|t| self.corners(t)).collect();
        let (low, high) = corners
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
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
                "{} triangle(s) are smaller than {LEAST:.0e} of the scene, which measures {size:.3e} m: \
                 they exchange no light with their neighbours; the first is triangle {first} of mesh \"{}\".",
                small.len(),
                self.mesh_name(first)
            ));
        }
        Ok(())
    }

    /// The corner farthest from where most are.
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
