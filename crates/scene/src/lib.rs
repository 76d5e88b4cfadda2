//! Input: triangle meshes, Blinn-Phong materials, pinhole cameras and the settings of a solve.
//!
//! Everything from outside is validated here, once ([`Scene::load`], [`Scene::check`]); later layers rely on finite
//! vertices, indices in range and physical materials. SI units: metres, W/(m² sr).
#![warn(missing_docs)]

mod adjacency;
mod albedo;
mod albedo_texture;
mod assembly;
mod atlas;
mod backend;
mod builder;
mod camera;
mod cameras;
mod check;
mod contacts;
mod covered;
mod creases;
mod cut;
mod energy;
mod error;
mod file;
mod geometry;
mod given;
mod gltf_file;
mod material;
mod mesh_file;
mod mitsuba;
mod movable;
mod mtl;
mod obj;
mod orient;
mod outlook;
mod painting;
mod pattern;
mod ply;
mod point_lights;
mod refine;
mod refine_texture;
mod relight;
mod save;
mod second_side;
mod settings;
mod shapes;
mod simplify;
mod size;
mod sky;
mod snap;
mod split;
mod statements;
mod statue;
mod sun;
mod tables;
mod texture;
mod toml_file;
mod triangulate;

pub use albedo_texture::AlbedoTexture;
pub use atlas::Crowded;
pub use backend::{BackendChoice, BackendKind};
pub use builder::SceneBuilder;
pub use camera::Camera;
pub use cameras::{CameraSet, Distortion, Focal, Frame, Intrinsics, Lens, Projection, Similarity};
pub use cut::Cut;
pub use error::SceneError;
pub use file::{LoadOptions, Orient};
pub use given::GivenMeshes;
pub use material::{Material, Normalization};
pub use movable::Movable;
pub use painting::Painting;
pub use pattern::Patterns;
pub use refine_texture::TextureRefined;
pub use relight::LampFactor;
pub use settings::{
    BinLayout, Lamps, Precision, SolveSettings, SolverChoice, VisibilityChoice, check_target_error,
};
pub use shapes::Shape;
pub use sky::Sky;
pub use sun::Sun;

pub use antirad_rays::Rays;

pub use adjacency::{Edges, Fans, Welded, sides};
pub use antirad_base::output::free_name;
pub use creases::SAME_SURFACE;
pub use error::{Place, nearest};
pub use pattern::Factors;
pub use size::bounds;
pub use tables::{CameraTable, Triple};
pub use texture::{Wrap, linear_from_srgb, srgb_from_linear};
pub use toml_file::TomlFile;

use glam::DVec3;
use std::path::PathBuf;
use std::sync::Arc;

/// One triangle: counter-clockwise seen from its front, which emits, reflects and blocks light. The back is black: it blocks what comes
/// straight from exact lamps, and lets other light pass.
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
    /// Name, by which fits and messages refer to it.
    pub name: String,
    /// Triangles `range.start..range.end` of [`Scene::triangles`].
    pub range: std::ops::Range<u32>,
}

/// The file, and the lines in it, that the triangles of a mesh come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// The mesh's own file, or the scene file that defines a shape.
    pub file: PathBuf,
    /// Line of the face that each triangle was cut from; empty for a shape.
    pub lines: Vec<u32>,
}

/// A checked scene. Triangles are in file order, mesh by mesh, and so is every per-face output.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name, for messages and files.
    pub name: String,
    /// Positions, m.
    pub vertices: Vec<DVec3>,
    /// Corners and material of each.
    pub triangles: Vec<Triangle>,
    /// Meshes, whose ranges of triangles cover all of them, in order.
    pub meshes: Vec<Mesh>,
    /// One per mesh if the scene came from files, else empty.
    #[doc(hidden)]
    pub origins: Vec<Origin>,
    /// Materials, which triangles refer to by index.
    pub materials: Vec<Material>,
    /// How materials vary within triangles, which pictures show.
    #[doc(hidden)]
    pub patterns: Arc<Patterns>,
    /// Suns, in file order.
    pub suns: Vec<Sun>,
    /// Cameras, in file order.
    pub cameras: Vec<Camera>,
    /// Settings of a solve.
    pub settings: SolveSettings,
    /// Relative L2 error of irradiance and pictures for which rays, mesh and tolerance are to be chosen; `None`: they are as
    /// `settings` says.
    pub target_error: Option<f64>,
    /// Indices of triangles without area: they keep their row in every output, but take no part in light transport.
    #[doc(hidden)]
    pub degenerate: Vec<u32>,
    /// Of each triangle, the sides (from corner k to the next) along which another surface meets its own: pictures interpolate nothing across.
    /// Empty where none are known; [`Self::cut_along_contacts`] finds them.
    #[doc(hidden)]
    pub creases: Vec<[bool; 3]>,
    /// Warnings for the user, in whole sentences (a default camera, no light, albedo near one).
    pub warnings: Vec<String>,
    /// The meshes that were simplified, as their files have them; see [`Self::with_given_meshes`].
    #[doc(hidden)]
    pub given: Option<Arc<GivenMeshes>>,
}

impl Scene {
    /// The three corners of a triangle, in metres.
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].vertices.map(|v| self.vertices[v as usize])
    }

    /// Rays among the triangles, except those without area. Requires [`Self::degenerate`] to be up to date.
    #[doc(hidden)]
    pub fn rays(&self) -> Arc<Rays> {
        let corners = (0..self.triangles.len()).map(|i| self.corners(i)).collect();
        Rays::shared(corners, |i| self.degenerate.binary_search(i).is_err())
    }

    /// The origin of a triangle as text for messages, as far as known, such as
    /// `room.obj:17 (triangle 5 of mesh "room")`.
    #[doc(hidden)]
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

    /// The camera with a name.
    pub fn camera(&self, name: &str) -> Option<&Camera> {
        self.cameras.iter().find(|camera| camera.name == name)
    }

    /// The material of a triangle.
    pub fn material(&self, triangle: usize) -> &Material {
        &self.materials[self.triangles[triangle].material as usize]
    }
}
