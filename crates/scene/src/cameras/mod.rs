//! Sets of cameras: the poses and lenses of photographs, from the files of other programs.

mod colmap;
mod frame;
mod intrinsics;
mod lens;
mod pictures;
mod similarity;
mod transforms;

pub use frame::Frame;
pub use intrinsics::{Focal, Intrinsics};
pub use lens::{Distortion, Lens, Projection};
pub use similarity::Similarity;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::SceneError;
use antirad_base::output::FileNames;

/// The frames of a `transforms.json` (NeRF, Blender, instant-ngp, nerfstudio) or of a COLMAP folder.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSet {
    /// The file, or the folder in which the files of COLMAP were found.
    pub path: PathBuf,
    /// Where its pictures are, unless stated otherwise: beside the JSON file, or in the folder `images` of COLMAP.
    pub pictures: PathBuf,
    /// At least one, in the order of the file, with names that differ.
    pub frames: Vec<Frame>,
}

impl CameraSet {
    /// Reads a JSON file, or a folder of COLMAP with `cameras` and `images` as `.txt` or `.bin`, in it or in its `sparse/0` or
    /// `sparse`.
    ///
    /// # Errors
    /// Fails if a file cannot be read or breaks off, if a pose is not rigid or not finite, or if a model of lenses is none of
    /// pinhole or radial and tangential distortion. The error names the file, the frame and the remedy.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let mut set = match path {
            folder if folder.is_dir() => match colmap::find(folder) {
                Some(files) => colmap::read(folder, &files)?,
                None if folder.join(transforms::USUAL_NAME).is_file() => {
                    transforms::read(&folder.join(transforms::USUAL_NAME))?
                }
                None => return Err(colmap::missing(folder)),
            },
            file if has_extension(file, "json") => transforms::read(file)?,
            file if colmap::is_file_of(file) => {
                let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
                return Self::read(folder.unwrap_or(Path::new(".")));
            }
            other if !other.exists() => {
                let reason = std::io::Error::from(std::io::ErrorKind::NotFound);
                return Err(SceneError::Read { path: other.to_path_buf(), reason });
            }
            other => {
                return Err(refuse(
                    other,
                    "no set of cameras; give a transforms.json, or the folder of COLMAP's cameras and images",
                ));
            }
        };
        if set.frames.is_empty() {
            return Err(refuse(&set.path, "it has no frames; give one with at least one posed picture"));
        }
        set.name_frames();
        Ok(set)
    }

    /// The frame with a name.
    pub fn frame(&self, name: &str) -> Option<&Frame> {
        self.frames.iter().find(|frame| frame.name == name)
    }

    /// An error in a frame of this set.
    pub fn error(&self, frame: &Frame, message: impl std::fmt::Display) -> SceneError {
        refuse(&self.path, format!("frame \"{}\": {message}", frame.name))
    }

    /// Frames are named after their pictures: by the stem, or by the whole path where several have the same stem.
    fn name_frames(&mut self) {
        let stems: Vec<String> = self.frames.iter().map(|frame| pictures::stem(&frame.picture)).collect();
        let mut count: HashMap<&str, usize> = HashMap::new();
        for stem in &stems {
            *count.entry(stem).or_default() += 1;
        }
        // Names become those of files.
        let mut names = FileNames::default();
        for (frame, stem) in self.frames.iter_mut().zip(&stems) {
            let name = match count.get(stem.as_str()) {
                Some(1) => stem.clone(),
                _ => pictures::path_as_name(&frame.picture),
            };
            frame.name = names.of(&name);
        }
    }
}

fn has_extension(path: &Path, wanted: &str) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(wanted))
}

fn refuse(path: &Path, message: impl Into<String>) -> SceneError {
    SceneError::File { path: path.to_path_buf(), message: message.into() }
}

fn cannot_be_read(path: &Path) -> impl Fn(std::io::Error) -> SceneError {
    move |reason| SceneError::Read { path: path.to_path_buf(), reason }
}
