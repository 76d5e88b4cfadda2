//! Files of meshes, by their extension.

use std::path::Path;

use super::error::SceneError;
use super::geometry::RawMesh;
use super::{Camera, Sky, Sun, gltf_file, mitsuba, obj, ply};

/// Most triangles of all instances of a file together.
pub(super) const MOST_TRIANGLES: usize = 10_000_000;

/// What a file holds.
#[derive(Default)]
pub(super) struct Contents {
    /// Meshes, with their names.
    pub meshes: Vec<(String, RawMesh)>,
    pub cameras: Vec<Camera>,
    pub sky: Option<Sky>,
    pub suns: Vec<Sun>,
}

impl Contents {
    /// All meshes as one, of which they are objects unless they have some, without cameras, sky and suns.
    pub fn into_one(self) -> RawMesh {
        let mut meshes = self.meshes.into_iter().map(|(name, mut mesh)| {
            if mesh.objects.is_empty() {
                mesh.objects.push((name, 0));
            }
            mesh
        });
        let mut one = meshes.next().unwrap_or_else(RawMesh::empty);
        meshes.for_each(|mesh| one.append(mesh));
        one
    }
}

/// Extensions of the formats.
pub(super) const EXTENSIONS: [&str; 5] = ["obj", "ply", "gltf", "glb", "xml"];

/// Reads a mesh file; one without a known extension is an OBJ. A material for which `defined_elsewhere` holds may be missing; others are grey, or with `strict` an error.
pub(super) fn read(
    path: &Path,
    strict: bool,
    defined_elsewhere: &dyn Fn(&str) -> bool,
    warnings: &mut Vec<String>,
) -> Result<Contents, SceneError> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let one = |mesh| Contents { meshes: vec![(stem.clone(), mesh)], ..Contents::default() };
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    match extension.as_deref() {
        Some("ply") => ply::read(path, &stem, defined_elsewhere(&stem), warnings).map(one),
        Some("gltf" | "glb") => gltf_file::read(path, warnings),
        Some("xml") => mitsuba::read(path, strict, warnings),
        _ => obj::read(path, strict, defined_elsewhere, warnings).map(one),
    }
}
