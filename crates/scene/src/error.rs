//! Errors in scenes. Every message is one line: where, what is wrong, and the remedy.

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::size::SIZES;

/// Why a scene was rejected. Triangles are numbered from 0 over the whole scene, as in every per-face output.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A file cannot be read.
    #[error("{}: cannot be read: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        reason: std::io::Error,
    },

    /// The extension of a file is not that of a known format.
    #[error("{}: neither a scene (.toml, .gltf, .glb, .xml) nor a mesh (.obj, .ply); give a file with one of these extensions", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },

    /// A line of a TOML, OBJ or MTL file is invalid.
    #[error("{}:{line}: {message}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and the remedy.
        message: String,
    },

    /// A file is invalid as a whole, or has no lines to name.
    #[error("{}: {message}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong, and the remedy.
        message: String,
    },

    /// An MTL file that a mesh names cannot be read.
    #[error(
        "{}:{line}: material file {} cannot be read ({reason}); put it there, or load without strict for grey faces",
        path.display(), mtl.display()
    )]
    MaterialFile {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The material file.
        mtl: PathBuf,
        /// Error of the operating system.
        reason: std::io::Error,
    },

    /// The scene is empty.
    #[error("the scene has no triangles; it needs at least one mesh with one face")]
    NoTriangles,

    /// All triangles are points or lines.
    #[error("none of the scene's triangles has an area: check the meshes' coordinates and scale")]
    #[doc(hidden)]
    NoArea,

    /// The scene is too large or too small to compute with.
    #[error(
        "the scene measures {size:.3e} m; light can be computed from {:.0e} to {:.0e} m; scale its meshes, \
         which does not change irradiance",
        SIZES.start(), SIZES.end()
    )]
    Size {
        /// Longest side of the bounding box, m.
        size: f64,
    },

    /// One outlying vertex makes the scene so large that most triangles are negligible in size.
    #[error(
        "triangle {triangle} of mesh \"{mesh}\": vertex {vertex} is at ({:e}, {:e}, {:e}), so far off that the scene \
         measures {size:.3e} m and most triangles are too small to exchange light; correct or remove it",
        position.x, position.y, position.z
    )]
    Outlier {
        /// Name of the mesh.
        mesh: String,
        /// Index in the scene.
        triangle: usize,
        /// Index of the vertex.
        vertex: u32,
        /// Position of the vertex, m.
        position: DVec3,
        /// Longest side of the scene's bounding box, m.
        size: f64,
    },

    /// More triangles or vertices than 32-bit indices or memory allow.
    #[error("{count} {what}, but at most {limit} are possible; use fewer or a lower `subdivide`")]
    #[doc(hidden)]
    TooMany {
        /// What there are too many of.
        what: &'static str,
        /// How many there would be.
        count: u64,
        /// The most that are possible.
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
        /// Index in the scene.
        triangle: usize,
        /// Index of the vertex.
        vertex: u32,
        /// Position of the vertex, m.
        position: DVec3,
    },

    /// A vertex that no triangle uses is not finite.
    #[error("vertex {vertex}, which no triangle uses, is not finite; remove it")]
    #[doc(hidden)]
    UnusedVertex {
        /// Index of the vertex.
        vertex: usize,
    },

    /// A triangle has an index out of range.
    #[error(
        "triangle {triangle} of mesh \"{mesh}\": {what} index {index} is out of range; there are {count}, from 0"
    )]
    Index {
        /// Name of the mesh.
        mesh: String,
        /// Index in the scene.
        triangle: usize,
        /// "vertex" or "material".
        what: &'static str,
        /// The index out of range.
        index: u32,
        /// How many there are.
        count: usize,
    },

    /// The meshes' ranges do not cover the triangles in order.
    #[error("the meshes do not cover the triangles: {message}")]
    Meshes {
        /// What is wrong, and the remedy.
        message: String,
    },

    /// Triangles have no area, and the scene is loaded strictly.
    #[error(
        "{count} triangle(s) without area, the first is triangle {triangle} of mesh \"{mesh}\"; \
         remove them or load without strict"
    )]
    #[doc(hidden)]
    Degenerate {
        /// How many.
        count: usize,
        /// Name of the mesh.
        mesh: String,
        /// Index in the scene.
        triangle: usize,
    },

    /// [`Scene::degenerate`](super::Scene::degenerate) has an index out of range.
    #[error(
        "triangle {triangle} is listed as degenerate, but there are only {count}; call Scene::check to update the list"
    )]
    #[doc(hidden)]
    UnknownDegenerate {
        /// The index out of range.
        triangle: u32,
        /// How many triangles there are.
        count: usize,
    },

    /// A material has a value that is not physical.
    #[error("material \"{name}\": {message}")]
    Material {
        /// Name of the material in the file.
        name: String,
        /// What is wrong, and the remedy.
        message: String,
    },

    /// A sun has a value that is not physical.
    #[error("sun {number}: {message}")]
    Sun {
        /// Its place in [`Scene::suns`](super::Scene::suns), from 0.
        number: usize,
        /// What is wrong, and the remedy.
        message: String,
    },

    /// A name stands for no lamp, or its light cannot be changed as stated.
    #[error("lamp \"{name}\": {message}")]
    Lamp {
        /// The name.
        name: String,
        /// What is wrong, and the remedy.
        message: String,
    },

    /// A camera has invalid parameters.
    #[error("camera \"{name}\": {message}")]
    Camera {
        /// Name of the camera in the file.
        name: String,
        /// What is wrong, and the remedy.
        message: String,
    },

    /// A setting of the solve is out of range.
    #[error("settings: {message}")]
    SolveSettings {
        /// What is wrong, and the remedy.
        message: String,
    },

    /// An error found by the check of a scene that came from a file.
    // Not a `source`: the message contains it already, and a printed chain would repeat it.
    #[error("{}{}: {problem}", path.display(), line.map(|n| format!(":{n}")).unwrap_or_default())]
    In {
        /// The file.
        path: PathBuf,
        /// Line number from 1, where known.
        line: Option<usize>,
        /// The error.
        problem: Box<SceneError>,
    },
}

/// A line of a file, for error messages.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// The file.
    pub path: &'a Path,
    /// Number of the line, from 1.
    pub line: usize,
}

impl Place<'_> {
    /// An error at this line.
    pub fn error(self, message: impl Into<String>) -> SceneError {
        SceneError::Line { path: self.path.to_path_buf(), line: self.line, message: message.into() }
    }
}

impl std::fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.path.display(), self.line)
    }
}

/// A list of names in quotes, cut short if it is long.
pub(super) fn quoted<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    const MOST: usize = 8;
    let names: Vec<&str> = names.into_iter().collect();
    let mut list: Vec<String> = names.iter().take(MOST).map(|name| format!("\"{name}\"")).collect();
    if names.len() > MOST {
        list.push(format!("and {} more", names.len() - MOST));
    }
    list.join(", ")
}

/// The candidate that `word` is most likely a misspelling of, if any is close.
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|c| (strsim::damerau_levenshtein(word, c), c))
        .min_by_key(|&(distance, _)| distance)
        .filter(|&(distance, c)| distance <= 1 + c.len() / 3)
        .map(|(_, c)| c)
}
