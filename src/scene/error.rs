//! What can be wrong with a scene. Every message is one line that says where, what, and the way out.

use std::path::{Path, PathBuf};

use glam::DVec3;

/// Why a scene was refused. Triangles are numbered from 0 over the whole scene, as in every per-face output.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    #[error("{}: cannot be read: {reason}", path.display())]
    Read { path: PathBuf, reason: std::io::Error },

    #[error("{}: neither a scene (.toml) nor a mesh (.obj); give a file with one of these endings", path.display())]
    UnknownFormat { path: PathBuf },

    /// A line of a TOML, OBJ or MTL file does not say what it should.
    #[error("{}:{line}: {message}", path.display())]
    Line {
        path: PathBuf,
        /// From 1.
        line: usize,
        message: String,
    },

    #[error(
        "{}:{line}: material file {} cannot be read ({reason}); put it there or remove the mtllib line for grey faces",
        path.display(), mtl.display()
    )]
    MaterialFile { path: PathBuf, line: usize, mtl: PathBuf, reason: std::io::Error },

    #[error("the scene has no triangles; it needs at least one mesh with one face")]
    NoTriangles,

    #[error("none of the scene's triangles has an area: check the meshes' coordinates and scale")]
    NoArea,

    #[error("{count} {what}, but at most {limit} are possible; use fewer or a lower `subdivide`")]
    TooMany { what: &'static str, count: u64, limit: u64 },

    #[error(
        "triangle {triangle} of mesh \"{mesh}\": vertex {vertex} is at ({}, {}, {}); coordinates must be finite",
        position.x, position.y, position.z
    )]
    Vertex { mesh: String, triangle: usize, vertex: u32, position: DVec3 },

    #[error(
        "the scene reaches from {from} to {to} m: that is more than f64 can tell; use smaller coordinates"
    )]
    Extent { from: f64, to: f64 },

    #[error(
        "triangle {triangle} of mesh \"{mesh}\" is {size:.1e} m long and the scene {extent:.1e} m: one solve cannot tell \
         both. Look for a stray coordinate or a wrong unit, in triangle {far} of mesh \"{far_mesh}\" first"
    )]
    Scales { mesh: String, triangle: usize, size: f64, extent: f64, far: usize, far_mesh: String },

    #[error("vertex {vertex}, which no triangle uses, is not finite; remove it")]
    UnusedVertex { vertex: usize },

    #[error(
        "triangle {triangle} of mesh \"{mesh}\": {what} index {index} is out of range; there are {count}, from 0"
    )]
    Index { mesh: String, triangle: usize, what: &'static str, index: u32, count: usize },

    #[error("the meshes do not cover the triangles: {message}")]
    Meshes { message: String },

    #[error(
        "{count} triangle(s) without area, the first is triangle {triangle} of mesh \"{mesh}\"; \
         remove them or load without strict"
    )]
    Degenerate { count: usize, mesh: String, triangle: usize },

    #[error("material \"{name}\": {message}")]
    Material { name: String, message: String },

    #[error("camera \"{name}\": {message}")]
    Camera { name: String, message: String },

    #[error("accuracy: {message}")]
    Accuracy { message: String },

    /// A problem found by the check of a scene that came from a file.
    // Not a `source`: the message holds it already, and a printed chain would say it twice.
    #[error("{}{}: {problem}", path.display(), line.map(|n| format!(":{n}")).unwrap_or_default())]
    In { path: PathBuf, line: Option<usize>, problem: Box<SceneError> },
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
