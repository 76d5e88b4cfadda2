//! Choice of cameras: those of a scene by name, or the frames of a set.

use crate::Failure;
use antirad::image::Photo;
use antirad::scene::{Camera, CameraSet, Frame, Scene};
use std::path::Path;

/// The cameras with these names; without names, all of the scene.
pub fn choose<'a>(scene: &'a Scene, names: &[String]) -> Result<Vec<&'a Camera>, Failure> {
    by_name(scene.cameras.iter().collect(), |camera| &camera.name, names, "the scene has no camera")
}

/// The frames with these names, all without names, of a `transforms.json` or a COLMAP folder, as centred pinholes with the horizontal
/// field of view of their lenses.
pub fn of_set(path: &Path, names: &[String]) -> Result<Vec<Camera>, Failure> {
    let set = CameraSet::read(path)?;
    let missing = format!("{} has no frame", set.path.display());
    let frames = by_name(set.frames.iter().collect(), |frame| &frame.name, names, &missing)?;
    frames.into_iter().map(|frame| of_frame(&set, frame)).collect()
}

fn of_frame(set: &CameraSet, frame: &Frame) -> Result<Camera, Failure> {
    let size = match frame.intrinsics.size() {
        Some(size) => size,
        // That of the picture.
        None => Photo::size(&set.picture(frame, None, None)?).map_err(|error| {
            set.error(frame, format!("the set has no w and h, so they are those of its picture: {error}"))
        })?,
    };
    let lens = frame.intrinsics.lens(size).map_err(|message| set.error(frame, message))?;
    let camera = frame.camera(&lens, lens.width, lens.height);
    camera.check().map_err(|error| set.error(frame, error))?;
    Ok(camera)
}

/// Those with the names, in the order of the names; all without.
fn by_name<'a, T>(
    all: Vec<&'a T>,
    name_of: fn(&T) -> &String,
    names: &[String],
    missing: &str,
) -> Result<Vec<&'a T>, Failure> {
    /// Names that a message lists, of a set of many.
    const LISTED: usize = 20;
    if names.is_empty() {
        return Ok(all);
    }
    let find = |name: &String| {
        all.iter().find(|one| name_of(one) == name).copied().ok_or_else(|| {
            let known: Vec<&str> = all.iter().take(LISTED).map(|one| name_of(one).as_str()).collect();
            let more = match all.len().saturating_sub(LISTED) {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            Failure::Error(format!("{missing} \"{name}\"; it has: {}{more}", known.join(", ")).into())
        })
    };
    names.iter().map(find).collect()
}
