//! What is given: triangle meshes, Blinn-Phong materials, pinhole cameras, and the accuracy asked for.
//!
//! Everything that comes from outside is checked here, once ([`Scene::load`], [`Scene::check`]); the layers behind
//! may rely on finite vertices, indices in range and physical materials. SI units: metres, W/(m² sr).

mod accuracy;
mod albedo;
mod assembly;
mod camera;
mod check;
mod error;
mod file;
mod geometry;
mod material;
mod mtl;
mod obj;
mod save;
mod shapes;
mod split;
mod statements;
mod statue;
mod tables;
mod toml_file;
mod triangulate;

pub use accuracy::{Accuracy, BinLayout, Precision, SolverChoice, Weights};
pub use camera::Camera;
pub use error::SceneError;
pub use file::LoadOptions;
pub use material::{Material, Normalization};
pub use shapes::Shape;

pub(crate) use error::{Place, nearest};
pub(crate) use tables::{CameraTable, Triple};
pub(crate) use toml_file::TomlFile;

use glam::DVec3;

/// One triangle: counter-clockwise seen from its front, which emits and reflects; the back is black and opaque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Indices into [`Scene::vertices`].
    pub vertices: [u32; 3],
    /// Index into [`Scene::materials`].
    pub material: u32,
}

/// A run of consecutive triangles that came from one file or shape.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mesh {
    pub name: String,
    /// Triangles `range.start..range.end` of [`Scene::triangles`].
    pub range: std::ops::Range<u32>,
}

/// A scene, checked. Triangles stand in file order, mesh after mesh; every per-face output has that order.
#[derive(Clone, Debug)]
pub struct Scene {
    pub name: String,
    /// Metres.
    pub vertices: Vec<DVec3>,
    pub triangles: Vec<Triangle>,
    pub meshes: Vec<Mesh>,
    pub materials: Vec<Material>,
    pub cameras: Vec<Camera>,
    pub accuracy: Accuracy,
    /// Indices of triangles without area: they keep their row in every output, and take no part.
    pub degenerate: Vec<u32>,
    /// What the user should know, in whole sentences (a camera that was made up, no light, albedo near one).
    pub warnings: Vec<String>,
}

impl Scene {
    /// The three corners of a triangle, in metres.
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].vertices.map(|v| self.vertices[v as usize])
    }

    /// The camera of a name.
    pub fn camera(&self, name: &str) -> Option<&Camera> {
        self.cameras.iter().find(|camera| camera.name == name)
    }

    /// The material of a triangle.
    pub fn material(&self, triangle: usize) -> &Material {
        &self.materials[self.triangles[triangle].material as usize]
    }
}
