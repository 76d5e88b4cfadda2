//! The triangles that cameras see.

use crate::image::{Coverage, ImageError, Rasterizer};
use antirad_scene::{Camera, Scene};

/// The triangles whose fronts at least one camera sees, in at least one sample.
pub struct Views {
    /// Whether any camera sees it, per triangle of the scene.
    pub seen: Vec<bool>,
    /// Coverage of the pixels, per camera.
    #[doc(hidden)]
    pub coverage: Vec<Coverage>,
}

impl Views {
    /// Rasterises each camera's view with `supersample` x `supersample` samples per pixel.
    ///
    /// # Errors
    /// Fails if the scene, a camera or `supersample` is invalid, or if the device fails.
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

    /// The triangles that no camera sees, ascending, except those without area, which emit no light.
    pub fn unseen(&self, scene: &Scene) -> Vec<usize> {
        let sends = |i: &usize| !self.seen[*i] && scene.degenerate.binary_search(&(*i as u32)).is_err();
        (0..self.seen.len()).filter(sends).collect()
    }
}
