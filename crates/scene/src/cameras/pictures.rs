//! Where the pictures of frames are.

use std::path::{Component, Path, PathBuf};

use super::{CameraSet, Frame};
use crate::SceneError;

/// Suffixes of pictures that are looked for, in this order, where a file leaves them out.
const PICTURE_SUFFIXES: [&str; 7] = ["png", "jpg", "jpeg", "exr", "tif", "tiff", "hdr"];

impl CameraSet {
    /// The file of a frame's picture: in `folder`, or where the set has its pictures; with another suffix if one is given.
    ///
    /// # Errors
    /// Fails if there is no such file.
    pub fn picture(
        &self,
        frame: &Frame,
        folder: Option<&Path>,
        suffix: Option<&str>,
    ) -> Result<PathBuf, SceneError> {
        let folder_or_usual = folder.unwrap_or(&self.pictures);
        let written = match suffix {
            Some(suffix) => with_suffix(&frame.picture, suffix),
            None => frame.picture.clone(),
        };
        let mut places = vec![folder_or_usual.join(&written)];
        // Paths of a file often name a folder that `folder` is already.
        if let (Some(folder), Some(name)) = (folder, written.file_name()) {
            places.push(folder.join(name));
        }
        if let Some(found) = places.iter().find_map(|place| look_for(place, suffix.is_some())) {
            return Ok(found);
        }
        let place = places.swap_remove(0);
        let suffixes = match has_picture_suffix(&place) || suffix.is_some() {
            true => String::new(),
            false => format!(", with any of the suffixes {}", PICTURE_SUFFIXES.join(", ")),
        };
        let other = match look_for(&without_suffix(&place), false) {
            Some(other) if suffix.is_none_or(|s| !s.is_empty()) => format!(
                "; there is {}: choose it with `suffix`",
                other.file_name().unwrap_or_default().to_string_lossy()
            ),
            _ => "; put it there, or name its folder with `images`".to_owned(),
        };
        Err(self.error(frame, format!("there is no picture {}{suffixes}{other}", place.display())))
    }
}

/// The file, or the first of those with a suffix and in whatever case.
fn look_for(path: &Path, exact: bool) -> Option<PathBuf> {
    if path.is_file() {
        return Some(path.to_path_buf());
    }
    let name = path.file_name()?.to_str()?;
    let wanted: Vec<String> = match exact || has_picture_suffix(path) {
        true => vec![name.to_owned()],
        false => PICTURE_SUFFIXES.iter().map(|suffix| format!("{name}.{suffix}")).collect(),
    };
    // The usual forms do without a list of the folder, which may be long.
    let usual = wanted.iter().flat_map(|wanted| {
        let (stem, suffix) = wanted.rsplit_once('.').unwrap_or((wanted, ""));
        [wanted.clone(), format!("{stem}.{}", suffix.to_ascii_uppercase())]
    });
    let folder = path.parent()?;
    if let Some(found) = usual.map(|name| folder.join(name)).find(|path| path.is_file()) {
        return Some(found);
    }
    let list = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let names: Vec<_> =
        std::fs::read_dir(list).ok()?.filter_map(|entry| Some(entry.ok()?.file_name())).collect();
    wanted.iter().find_map(|wanted| {
        let wanted = wanted.to_lowercase();
        let same =
            names.iter().filter(|name| name.to_str().is_some_and(|name| name.to_lowercase() == wanted));
        // The first by name, since a folder has no order.
        same.min().map(|name| folder.join(name)).filter(|path| path.is_file())
    })
}

fn has_picture_suffix(path: &Path) -> bool {
    let suffix = path.extension().and_then(|suffix| suffix.to_str()).map(str::to_ascii_lowercase);
    suffix.is_some_and(|suffix| PICTURE_SUFFIXES.contains(&suffix.as_str()))
}

/// The path without the suffix of a picture. Other dots belong to the name.
fn without_suffix(path: &Path) -> PathBuf {
    if has_picture_suffix(path) { path.with_extension("") } else { path.to_path_buf() }
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut whole = without_suffix(path).into_os_string();
    if !suffix.contains('.') && !suffix.is_empty() {
        whole.push(".");
    }
    whole.push(suffix);
    whole.into()
}

/// The name of a picture without folders and suffix.
pub(super) fn stem(path: &Path) -> String {
    let name = without_suffix(path);
    name.file_name().map_or_else(|| "frame".to_owned(), |name| name.to_string_lossy().into_owned())
}

/// The path of a picture without suffix as one name.
pub(super) fn path_as_name(path: &Path) -> String {
    let path = without_suffix(path);
    let parts = path.components().filter_map(|part| match part {
        Component::Normal(part) => Some(part.to_string_lossy().into_owned()),
        _ => None,
    });
    let name = parts.collect::<Vec<_>>().join("_");
    if name.is_empty() { "frame".to_owned() } else { name }
}
