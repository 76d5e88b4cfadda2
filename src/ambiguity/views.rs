//! What some cameras see.

use crate::image::{Coverage, ImageError, Rasterizer};
use crate::scene::{Camera, Scene};

/// The triangles whose fronts at least one camera sees, in one sample at least.
pub struct Views {
    /// Per triangle of the scene.
    pub seen: Vec<bool>,
    /// By camera.
    pub coverage: Vec<Coverage>,
}

impl Views {
    /// `supersample` x `supersample` samples a pixel.
    pub fn new(
        rasterizer: &Rasterizer,
        scene: &Scene,
        cameras: &[&Camera],
        supersample: u32,
    ) -> Result<Self, ImageError> {
        let look = |camera: &&Camera| rasterizer.coverage(scene, camera, supersample);
        let coverage = cameras.iter().map(look).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { seen: Coverage::seen(&coverage, scene.triangles.len()), coverage })
    }

    /// The triangles that no camera sees, ascending; those without area are not counted, as they send no light.
    pub fn unseen(&self, scene: &Scene) -> Vec<usize> {
        let sends = |i: &usize| !self.seen[*i] && scene.degenerate.binary_search(&(*i as u32)).is_err();
        (0..self.seen.len()).filter(sends).collect()
    }
}
