//! `antirad export`.

use crate::Failure;
use crate::settings::SceneFile;
use antirad::export::{self, Format};
use antirad::output::prepare_directory;
use antirad_base::npy::{self, Floats};
use clap::{Args, ValueEnum};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

#[derive(Args)]
#[command(after_help = "Examples:
  antirad export out/fits/cornell/scene.toml --format gltf
  antirad export scenes/two_rooms.toml --format ply --light out/two_rooms/radiosity.npy
  antirad export scenes/cornell_boxes.toml --format mitsuba --output out/cornell.xml")]
pub struct Arguments {
    #[command(flatten)]
    file: SceneFile,
    /// glTF 2.0 (.glb), a scene of Mitsuba 3 (.xml, with meshes beside it), or one mesh (.ply)
    #[arg(long, value_enum)]
    format: Kind,
    /// Show light in place of materials' colours, from the radiosity.npy of `antirad render` for this scene: radiosity over π
    #[arg(long, value_name = "NPY")]
    light: Option<PathBuf>,
    /// The file to write [default: out/SCENE, with the format's extension]
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    Gltf,
    Mitsuba,
    Ply,
}

pub fn run(arguments: &Arguments, quiet: bool) -> Result<(), Failure> {
    let format = match arguments.format {
        Kind::Gltf => Format::Gltf,
        Kind::Mitsuba => Format::Mitsuba,
        Kind::Ply => Format::Ply,
    };
    if format == Format::Mitsuba && arguments.light.is_some() {
        return Err(Failure::Error("a scene of Mitsuba takes no --light; export it as gltf or ply".into()));
    }
    let scene = arguments.file.load()?;
    let light = arguments.light.as_deref().map(|path| light(path, scene.triangles.len())).transpose()?;
    // Simplified meshes are written as given, with the values of the triangles near theirs.
    let (scene, light) = match scene.with_given_meshes() {
        None => (scene, light),
        Some((given, rows)) => {
            (given, light.map(|light| rows.into_iter().map(|row| light[row as usize]).collect::<Vec<_>>()))
        }
    };
    let path = arguments
        .output
        .clone()
        .unwrap_or_else(|| Path::new("out").join(&scene.name).with_extension(format.extension()));
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        prepare_directory(folder)?;
    }
    export::export(&scene, format, &path, light.as_deref())?;
    if !quiet {
        antirad::say!(
            "written     {}: {} triangles, {} materials",
            path.display(),
            scene.triangles.len(),
            scene.materials.len()
        );
    }
    Ok(())
}

/// The radiance of each triangle from its radiosity.
fn light(path: &Path, triangles: usize) -> Result<Vec<[f64; 3]>, Failure> {
    let refuse = |what: String| Failure::Error(format!("{}: {what}", path.display()).into());
    let bytes =
        antirad_base::input::read(path).map_err(|error| refuse(format!("cannot be read: {error}")))?;
    let Floats { shape, numbers } = npy::read(&bytes).map_err(refuse)?;
    if shape != [triangles as u64, 3] {
        return Err(refuse(format!(
            "has the shape {shape:?}; the scene has {triangles} triangles, so [{triangles}, 3] is expected: render the same scene"
        )));
    }
    Ok(numbers.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]].map(|x| x / PI)).collect())
}
