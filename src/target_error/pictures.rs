//! The visible triangles of each camera.

use crate::gpu::Device;
use crate::image::{ImageError, Rasterizer};
use crate::scene::{Camera, Scene};
use glam::DVec3;

/// The triangles of a scene that a camera sees, by index.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Visible {
    /// Name of the camera.
    pub camera: String,
    /// Number of pixels at whose centre the triangle is visible.
    pub samples: Vec<f64>,
    /// Whether the camera is in front of the triangle.
    pub fronts: Vec<bool>,
}

impl Visible {
    /// One per camera.
    pub fn of(device: &Device, scene: &Scene, cameras: &[Camera]) -> Result<Vec<Self>, ImageError> {
        let rasterizer = Rasterizer::new(device)?;
        let triangles = scene.triangles.len();
        let visible = |camera: &Camera| {
            let mut samples = vec![0.0; triangles];
            for face in rasterizer.visible_samples(scene, camera, 1)? {
                // The background has a number beyond all triangles.
                if let Some(count) = samples.get_mut(face as usize) {
                    *count += 1.0;
                }
            }
            let front = |i: usize| {
                let centroid = scene.corners(i).iter().sum::<DVec3>() / 3.0;
                scene.area_vector(i).dot(camera.position - centroid) > 0.0
            };
            Ok(Self { camera: camera.name.clone(), samples, fronts: (0..triangles).map(front).collect() })
        };
        cameras.iter().map(visible).collect()
    }
}
