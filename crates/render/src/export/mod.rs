//! Scenes for other programs: binary glTF, Mitsuba 3 and PLY, with materials, and optionally light as colours of faces.

mod gltf;
mod mitsuba;
mod ply;

use antirad_base::output::OutputError;
use antirad_scene::Scene;
use std::path::Path;

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// glTF 2.0 in one binary file (`.glb`): all meshes, materials, textures of albedo, suns and cameras. What (ρ, σ, p) of glTF cannot express stands in
    /// `extras`, from which [`Scene::load`] restores it.
    Gltf,
    /// A scene of Mitsuba 3 (`.xml`) with a PLY for each mesh and material beside it. Lobes become rough plastic about as wide, suns
    /// directional emitters without width.
    Mitsuba,
    /// One mesh in binary PLY, with the albedo of faces, or their light, as colours.
    Ply,
}

impl Format {
    /// The extension of its files.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Gltf => "glb",
            Self::Mitsuba => "xml",
            Self::Ply => "ply",
        }
    }
}

/// Writes a scene. `light`: per triangle, a radiance to show as its colour (radiosity over π, for example), which a Mitsuba scene does
/// not take.
///
/// Positions are written in single precision, save in PLY.
///
/// # Errors
/// Fails if a file cannot be written.
pub fn export(
    scene: &Scene,
    format: Format,
    path: &Path,
    light: Option<&[[f64; 3]]>,
) -> Result<(), OutputError> {
    match format {
        Format::Gltf => gltf::write(scene, path, light),
        Format::Mitsuba => mitsuba::write(scene, path),
        Format::Ply => ply::write_scene(scene, path, light),
    }
}
