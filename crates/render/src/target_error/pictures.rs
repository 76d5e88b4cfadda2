//! What each camera sees.

use crate::image::{Coverage, ImageError, Rasterizer};
use antirad_core::backend::Backend;
use antirad_scene::{Camera, Scene};
use glam::DVec3;

/// What a camera sees of a scene, one sample per pixel.
pub(super) struct Visible {
    /// Name of the camera.
    pub camera: String,
    /// The triangle at the centre of each pixel.
    pub coverage: Coverage,
    /// Per triangle, the number of pixels that show it.
    pub samples: Vec<f64>,
    /// Per triangle, whether the camera is in front of it.
    pub fronts: Vec<bool>,
}

impl Visible {
    /// What each camera sees.
    ///
    /// # Errors
    /// Fails if the scene or a camera is invalid, or if the device fails.
    pub fn of(backend: &Backend, scene: &Scene, cameras: &[Camera]) -> Result<Vec<Self>, ImageError> {
        let rasterizer = Rasterizer::new(backend)?;
        let triangles = scene.triangles.len();
        let visible = |camera: &Camera| {
            let mut samples = vec![0.0; triangles];
            let coverage = rasterizer.coverage(scene, camera, 1)?;
            coverage.faces_in_pixels().for_each(|seen| samples[seen.face] += seen.share);
            let front = |i: usize| {
                let centroid = scene.corners(i).iter().sum::<DVec3>() / 3.0;
                scene.area_vector(i).dot(camera.position - centroid) > 0.0
            };
            let fronts = (0..triangles).map(front).collect();
            Ok(Self { camera: camera.name.clone(), coverage, samples, fronts })
        };
        cameras.iter().map(visible).collect()
    }
}
