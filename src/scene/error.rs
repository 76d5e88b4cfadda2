//! What can be wrong with a scene. Every message is one line that says where, what, and the remedy.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::size::SIZES;

/// Why a scene was refused. Triangles are numbered from 0 over the whole scene, as in every per-face output.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A file cannot be read.
    #[error("{}: cannot be read: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },

    /// The ending of a file says no known format.
    #[error("{}: neither a scene (.toml) nor a mesh (.obj); give a file with one of these endings", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },

    /// A line of a TOML, OBJ or MTL file does not say what it should.
    #[error("{}:{line}: {message}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What is wrong there, and what would do.
        message: String,
    },

    /// An MTL file that a mesh names cannot be read.
    #[error(
        "{}:{line}: material file {} cannot be read ({reason}); put it there or remove the mtllib line for grey faces",
        path.display(), mtl.display()
    )]
    MaterialFile {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// The material file.
        mtl: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },

    /// There is nothing in the scene.
    #[error("the scene has no triangles; it needs at least one mesh with one face")]
    NoTriangles,

    /// All triangles are points or lines.
    #[error("none of the scene's triangles has an area: check the meshes' coordinates and scale")]
    NoArea,

    /// Too large or too small for any computation.
    #[error(
        "the scene measures {size:.3e} m, but light can be computed from {:.0e} to {:.0e} m; scale its meshes, \
         which changes no irradiance",
        SIZES.start(), SIZES.end()
    )]
    Size {
        /// Of its bounding box, along the longest side.
        size: f64,
    },

    /// One corner makes the scene so large that most triangles are nothing beside it.
    #[error(
        "triangle {triangle} of mesh \"{mesh}\": vertex {vertex} is at ({:e}, {:e}, {:e}), so far off that the scene \
         measures {size:.3e} m, beside which most triangles are too small for light between them; correct or remove it",
        position.x, position.y, position.z
    )]
    Outlier { mesh: String, triangle: usize, vertex: u32, position: DVec3, size: f64 },

    /// More than indices of 32 bits, or memory, can tell apart.
    #[error("{count} {what}, but at most {limit} are possible; use fewer or a lower `subdivide`")]
    TooMany {
        /// What there is too much of, or what is out of range.
        what: &'static str,
        /// How many there would be.
        count: u64,
        /// How many there may be.
        limit: u64,
    },

    /// A corner of a triangle is not finite.
    #[error(
        "triangle {triangle} of mesh \"{mesh}\": vertex {vertex} is at ({}, {}, {}); coordinates must be finite",
        position.x, position.y, position.z
    )]
    Vertex {
        /// Name of the mesh.
        mesh: String,
        /// Index within the mesh.
        triangle: usize,
        /// Index of the vertex.
        vertex: u32,
        /// Where it is, m.
        position: DVec3,
    },

    /// A vertex that no triangle uses is not finite.
    #[error("vertex {vertex}, which no triangle uses, is not finite; remove it")]
    UnusedVertex {
        /// Index of the vertex.
        vertex: usize,
    },

    /// A triangle refers to something that is not there.
    #[error(
        "triangle {triangle} of mesh \"{mesh}\": {what} index {index} is out of range; there are {count}, from 0"
    )]
    Index {
        /// Name of the mesh.
        mesh: String,
        /// Index within the mesh.
        triangle: usize,
        /// What there is too much of, or what is out of range.
        what: &'static str,
        /// What it refers to.
        index: u32,
        /// How many there are.
        count: usize,
    },

    /// Meshes do not cover the triangles one after the other.
    #[error("the meshes do not cover the triangles: {message}")]
    Meshes {
        /// What is wrong, and what would do.
        message: String,
    },

    #[error(
        "{count} triangle(s) without area, the first is triangle {triangle} of mesh \"{mesh}\"; \
         remove them or load without strict"
    )]
    /// Triangles have no area, and the scene is loaded strictly.
    Degenerate {
        /// How many.
        count: usize,
        /// Name of the mesh.
        mesh: String,
        /// Index within the mesh.
        triangle: usize,
    },

    /// A list that does not belong to the triangles.
    #[error(
        "triangle {triangle} is listed as degenerate, and there are {count}: Scene::check lists them anew"
    )]
    UnknownDegenerate { triangle: u32, count: usize },

    /// A material has a value that it cannot have.
    #[error("material \"{name}\": {message}")]
    Material {
        /// What it is called in the file.
        name: String,
        /// What is wrong, and what would do.
        message: String,
    },

    /// A camera cannot take pictures.
    #[error("camera \"{name}\": {message}")]
    Camera {
        /// What it is called in the file.
        name: String,
        /// What is wrong, and what would do.
        message: String,
    },

    /// The settings of a solve contradict each other.
    #[error("accuracy: {message}")]
    SolveSettings {
        /// What is wrong, and what would do.
        message: String,
    },

    /// A problem found by the check of a scene that came from a file.
    // Not a `source`: the message holds it already, and a printed chain would say it twice.
    #[error("{}{}: {problem}", path.display(), line.map(|n| format!(":{n}")).unwrap_or_default())]
    In {
        /// The file.
        path: PathBuf,
        /// From 1, where it is known.
        line: Option<usize>,
        /// What the check found.
        problem: Box<SceneError>,
    },
}

/// A line of a file, to say where something is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place<'a> {
    pub path: &'a Path,
    /// From 1.
    pub line: usize,
}

impl Place<'_> {
    /// The error that this line does not say what it should.
    pub fn error(self, message: impl Into<String>) -> SceneError {
        SceneError::Line { path: self.path.to_path_buf(), line: self.line, message: message.into() }
    }
}

impl std::fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.path.display(), self.line)
    }
}

/// The candidate that `word` is most likely a misspelling of, if one is near.
pub(crate) fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|c| (strsim::damerau_levenshtein(word, c), c))
        .min_by_key(|&(distance, _)| distance)
        .filter(|&(distance, c)| distance <= 1 + c.len() / 3)
        .map(|(_, c)| c)
}
