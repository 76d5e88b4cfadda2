//! The files of COLMAP: `cameras` and `images`, as text or binary.

mod binary;
mod model;
mod text;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};

use super::{CameraSet, Frame, Intrinsics, refuse};
use crate::SceneError;

/// Folders in which the files are looked for, within the one given.
const FOLDERS: [&str; 4] = ["", "sparse/0", "sparse", "0"];

/// The files of one model.
pub(super) struct Files {
    cameras: PathBuf,
    images: PathBuf,
    binary: bool,
}

/// The files in a folder, or in those that COLMAP makes in it. Binary ones go first, as in COLMAP.
pub(super) fn find(folder: &Path) -> Option<Files> {
    let both = |folder: &Path, suffix: &str| {
        let (cameras, images) =
            (folder.join(format!("cameras.{suffix}")), folder.join(format!("images.{suffix}")));
        let found = cameras.is_file() && images.is_file();
        found.then_some(Files { cameras, images, binary: suffix == "bin" })
    };
    FOLDERS
        .iter()
        .map(|inner| folder.join(inner))
        .find_map(|folder| both(&folder, "bin").or_else(|| both(&folder, "txt")))
}

/// The error for a folder without a set of cameras.
pub(super) fn missing(folder: &Path) -> SceneError {
    refuse(
        folder,
        "there is no set of cameras: neither cameras.txt and images.txt nor cameras.bin and images.bin, in it or in its sparse/0 or \
         sparse, nor a transforms.json; give the folder of COLMAP's model",
    )
}

/// Whether a file is one of a model, which is named by its folder.
pub(super) fn is_file_of(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    path.is_file()
        && name.is_some_and(|name| ["cameras.txt", "cameras.bin", "images.txt", "images.bin"].contains(&name))
}

/// An entry of the file of images: world to camera, y down, z forwards.
struct Image {
    /// w, x, y, z.
    rotation: [f64; 4],
    translation: [f64; 3],
    camera: u32,
    name: String,
}

pub(super) fn read(folder: &Path, files: &Files) -> Result<CameraSet, SceneError> {
    let cameras = match files.binary {
        true => binary::cameras(&files.cameras)?,
        false => text::cameras(&files.cameras)?,
    };
    let images = match files.binary {
        true => binary::images(&files.images)?,
        false => text::images(&files.images)?,
    };
    let frame = |image: &Image| {
        frame(image, &cameras)
            .map_err(|message| refuse(&files.images, format!("image \"{}\": {message}", image.name)))
    };
    let frames = images.iter().map(frame).collect::<Result<_, _>>()?;
    let own = files.images.parent().unwrap_or(folder);
    Ok(CameraSet { path: files.images.clone(), pictures: pictures(folder, own), frames })
}

/// The folder `images` in or beside the folder that was given, or that has the files.
fn pictures(given: &Path, own: &Path) -> PathBuf {
    let beside = |folder: &Path| match folder.parent() {
        Some(parent) if folder.file_name().is_some() => parent.join("images"),
        _ => folder.join("../images"),
    };
    let mut places = vec![given.join("images"), beside(given)];
    places.extend(own.ancestors().skip(1).take(2).map(|folder| folder.join("images")));
    let found = places.iter().position(|place| place.is_dir());
    places.swap_remove(found.unwrap_or(1))
}

fn frame(image: &Image, cameras: &HashMap<u32, Intrinsics>) -> Result<Frame, String> {
    let Some(intrinsics) = cameras.get(&image.camera) else {
        return Err(format!(
            "it refers to camera {}, which is not among the cameras; export both files again",
            image.camera
        ));
    };
    if Path::new(&image.name).file_name().is_none() {
        return Err("its name is that of no file; give that of its picture".to_owned());
    }
    let [w, x, y, z] = image.rotation;
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let length = rotation.length();
    if !(length > 1e-6 && length.is_finite()) {
        return Err(format!(
            "its rotation ({w}, {x}, {y}, {z}) is no quaternion; correct it, or remove the image"
        ));
    }
    // Rows of the rotation are the axes of the camera in the world.
    let axes = DMat3::from_quat(rotation / length).transpose();
    let position = -(axes * DVec3::from(image.translation));
    Frame::new(PathBuf::from(&image.name), position, [axes.x_axis, -axes.y_axis, axes.z_axis], *intrinsics)
}
