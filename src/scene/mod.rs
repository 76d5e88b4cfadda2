//! What is given: triangle meshes, Blinn-Phong materials, pinhole cameras, and the accuracy asked for.
//!
//! Everything that comes from outside is checked here, once ([`Scene::load`], [`Scene::check`]); the layers behind
//! may rely on finite vertices, indices in range and physical materials. SI units: metres, W/(m² sr).

mod adjacency;
mod albedo;
mod assembly;
mod builder;
mod camera;
mod check;
mod error;
mod file;
mod geometry;
mod material;
mod mtl;
mod obj;
mod refine;
mod save;
mod settings;
mod shapes;
mod size;
mod split;
mod statements;
mod statue;
mod tables;
mod toml_file;
mod triangulate;

pub use builder::SceneBuilder;
pub use camera::Camera;
pub use error::SceneError;
pub use file::LoadOptions;
pub use material::{Material, Normalization};
pub use settings::{BinLayout, Choice, Precision, SolveSettings, SolverChoice, Weights};
pub use shapes::Shape;

pub(crate) use adjacency::{Edges, Fans, Welded, sides};
pub(crate) use error::{Place, nearest};
pub(crate) use tables::{CameraTable, Triple};
pub(crate) use toml_file::TomlFile;

use glam::DVec3;
use std::path::PathBuf;

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
    /// For messages and choices of meshes.
    pub name: String,
    /// Triangles `range.start..range.end` of [`Scene::triangles`].
    pub range: std::ops::Range<u32>,
}

/// Where the triangles of a mesh stand in files.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// The mesh's own file, or the scene file that asks for a shape.
    pub file: PathBuf,
    /// Line of the face that each triangle was cut from; empty for a shape.
    pub lines: Vec<u32>,
}

/// A scene, checked. Triangles stand in file order, mesh after mesh; every per-face output has that order.
#[derive(Clone, Debug)]
pub struct Scene {
    /// For messages and files.
    pub name: String,
    /// Metres.
    pub vertices: Vec<DVec3>,
    /// Corners and material of each.
    pub triangles: Vec<Triangle>,
    /// They cover all triangles, in order.
    pub meshes: Vec<Mesh>,
    /// One for each mesh of a scene that came from files, else none.
    pub origins: Vec<Origin>,
    /// That triangles refer to by index.
    pub materials: Vec<Material>,
    /// In the order of the file.
    pub cameras: Vec<Camera>,
    /// How exact a solve is to be.
    pub settings: SolveSettings,
    /// What of it is left open.
    pub choice: Choice,
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

    /// Where a triangle is, for people: `room.obj:17 (triangle 5 of mesh "room")`, as far as is known.
    pub fn place_of(&self, triangle: usize) -> String {
        let holds = |m: &Mesh| (m.range.start as usize..m.range.end as usize).contains(&triangle);
        let Some(mesh) = self.meshes.iter().position(holds) else {
            return format!("triangle {triangle}");
        };
        let Mesh { name, range } = &self.meshes[mesh];
        let named = format!("triangle {triangle} of mesh \"{name}\"");
        let line = |origin: &Origin| {
            let line = origin.lines.get(triangle - range.start as usize)?;
            Some(format!("{}:{line}", origin.file.display()))
        };
        match self.origins.get(mesh).and_then(line) {
            Some(line) => format!("{line} ({named})"),
            None => named,
        }
    }

    /// Normal times area of a triangle, m².
    pub fn area_vector(&self, triangle: usize) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        0.5 * (b - a).cross(c - a)
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
