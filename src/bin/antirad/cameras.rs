//! Choice of cameras: those of a scene by name, or the frames of a set.

use crate::Failure;
use antirad::fit::Photographs;
use antirad::scene::{Camera, CameraSet, Scene};
use std::path::Path;

/// The cameras with these names; without names, all of the scene.
pub fn choose<'a>(scene: &'a Scene, names: &[String]) -> Result<Vec<&'a Camera>, Failure> {
    by_name(scene.cameras.iter().collect(), |camera| &camera.name, names, "the scene has no camera")
}

/// The frames with these names, all without names, of a `transforms.json` or a COLMAP folder, as centred pinholes with the horizontal
/// field of view of their lenses.
pub fn of_set(path: &Path, names: &[String]) -> Result<Vec<Camera>, Failure> {
    let photographs = Photographs::new(CameraSet::read(path)?);
    let set = &photographs.set;
    let missing = format!("{} has no frame", set.path.display());
    let frames = by_name(set.frames.iter().collect(), |frame| &frame.name, names, &missing)?;
    Ok(frames.into_iter().map(|frame| photographs.camera_of(frame)).collect::<Result<_, _>>()?)
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
