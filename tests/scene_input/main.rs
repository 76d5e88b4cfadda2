//! Valid and invalid input to the scene layer.

mod against_tobj;
mod as_they_come;
mod cameras;
mod checks;
mod export;
mod gltf;
mod gltf_extensions;
mod gltf_forms;
mod meshes;
mod mitsuba;
mod mitsuba_files;
mod mitsuba_lights;
mod mitsuba_textures;
#[path = "../support/obj.rs"]
mod obj;
mod ply;
mod save;
mod scene_file;
mod shipped;
mod sky;
mod sun;
mod textures;

use antirad::scene::{LoadOptions, Scene, SceneError};
use tempfile::TempDir;

const MTL: &str = "newmtl white\nKd .5 .5 .5\nnewmtl lamp\nKd .5 .5 .5\nKe 1 1 1\n";
const OBJ: &str =
    "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl lamp\nf 1 2 3\nusemtl white\nf 1 3 4\n";
const TOML: &str = "[[mesh]]\npath = \"m.obj\"\n[camera.main]\nposition = [0, 0, 5]\ntarget = [0, 0, 0]\n\
                    fov_x_degrees = 40\nwidth = 64\nheight = 48\n";

/// A folder with a valid `s.toml`, `m.obj` and `m.mtl`, plus or overridden by the files given.
struct Folder(TempDir);

impl Folder {
    fn with(files: &[(&str, &str)]) -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        for (name, text) in [("s.toml", TOML), ("m.obj", OBJ), ("m.mtl", MTL)].iter().chain(files) {
            std::fs::write(folder.path().join(name), text).expect("a file in it");
        }
        Self(folder)
    }

    fn load(&self, name: &str, strict: bool) -> Result<Scene, SceneError> {
        Scene::load(&self.0.path().join(name), &LoadOptions::default().strict(strict))
    }
}

fn load(name: &str, files: &[(&str, &str)]) -> Result<Scene, SceneError> {
    Folder::with(files).load(name, false)
}

fn good(name: &str, files: &[(&str, &str)]) -> Scene {
    load(name, files).unwrap_or_else(|error| panic!("{error}"))
}

#[track_caller]
fn assert_says(message: &str, parts: &[&str]) {
    assert!(!message.contains('\n'), "more than a line: {message}");
    for part in parts {
        assert!(message.contains(part), "`{part}` is missing in: {message}");
    }
}

/// Asserts an error for a scene whose `file` holds `text`; the other files are valid.
#[track_caller]
fn assert_refused(file: &str, text: &str, parts: &[&str]) {
    match load(if file.ends_with("obj") { "m.obj" } else { "s.toml" }, &[(file, text)]) {
        Ok(_) => panic!("{file} was not refused: {text}"),
        Err(error) => assert_says(&error.to_string(), parts),
    }
}

/// A TOML scene of one valid mesh, followed by `more`.
fn with_mesh(more: &str) -> String {
    format!("{TOML}{more}")
}

#[test]
fn the_good_files_load_without_a_warning() {
    let scene = good("s.toml", &[]);
    assert_eq!(scene.name, "s");
    assert_eq!(scene.warnings, [""; 0]);
    assert_eq!((scene.vertices.len(), scene.triangles.len(), scene.cameras.len()), (4, 2, 1));
    assert_eq!(scene.material(0).name, "lamp");
    assert_eq!(scene.material(1).albedo, [0.5; 3]);
    assert_eq!((scene.meshes[0].name.as_str(), scene.meshes[0].range.clone()), ("m", 0..2));
}

/// Names of the files in a folder.
fn names(folder: &std::path::Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8")).collect()
}
