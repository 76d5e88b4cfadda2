//! Choice of cameras by name.

use crate::Failure;
use antirad::scene::{Camera, Scene};

/// The cameras with these names; without names, all of the scene.
pub fn choose<'a>(scene: &'a Scene, names: &[String]) -> Result<Vec<&'a Camera>, Failure> {
    if names.is_empty() {
        return Ok(scene.cameras.iter().collect());
    }
    let find = |name: &String| {
        scene.camera(name).ok_or_else(|| {
            let known: Vec<&str> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
            Failure::Error(format!("the scene has no camera \"{name}\"; it has: {}", known.join(", ")).into())
        })
    };
    names.iter().map(find).collect()
}
