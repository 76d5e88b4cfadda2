//! The faces that a camera may see.

use super::projection::{Projected, View};
use antirad_base::parallel;
use antirad_scene::{Camera, Scene, SceneError};
use bytemuck::{Pod, Zeroable};

/// Stands for a face in the background.
pub(super) const NONE: u32 = u32::MAX;

/// A face in single precision: the coefficients of its three edge functions, each with one coefficient of the inverse depth.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct Face {
    pub edges: [[f32; 4]; 3],
}

impl From<&Projected> for Face {
    fn from(face: &Projected) -> Self {
        let depth = face.inverse_depth.to_array();
        Self { edges: [0, 1, 2].map(|i| face.edges[i].extend(depth[i]).as_vec4().to_array()) }
    }
}

/// The faces that a camera may see, in the scene's order, unrounded. Fails if the scene or the camera is invalid.
pub(super) fn project(scene: &Scene, camera: &Camera) -> Result<Vec<Projected>, SceneError> {
    scene.check_geometry()?;
    camera.check()?;
    let view = View::new(camera);
    let mut skip = vec![false; scene.triangles.len()];
    for &number in &scene.degenerate {
        skip[number as usize] = true;
    }
    let project = |number: usize| match skip[number] {
        true => None,
        false => view.project(number as u32, scene.corners(number)),
    };
    Ok(parallel::flat_map(0..scene.triangles.len(), project))
}

/// The faces, rounded to what is compared at samples.
pub(super) fn rounded(faces: Vec<Projected>) -> Vec<Projected> {
    parallel::map(faces, Projected::rounded)
}
