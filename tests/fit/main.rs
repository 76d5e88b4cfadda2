//! Tests of fitting, without a device where possible.

mod cameras;
mod double;
mod job_files;
mod jobs;
mod parameters;
mod scenes;
mod segments;
#[path = "../support/mod.rs"]
mod support;
mod textures;

use antirad::scene::{LoadOptions, Scene};

/// A room, a box of two materials in it, a lamp, a glossy table.
const SCENE: &str = r#"[[mesh]]
shape = { kind = "room", cells = 2 }
material = "wall"
scale = 2

[[mesh]]
name = "box"
shape = { kind = "box", cells = 1 }
material = "red"
scale = 0.4
translate = [0.3, 0.1, 0.5]

[[mesh]]
name = "table"
shape = { kind = "quad", cells = 2 }
material = "gloss"
scale = 0.5
translate = [1.1, 0.6, 1.0]

[[mesh]]
name = "shelf"
shape = { kind = "quad", cells = 1 }
material = "red"
scale = 0.5
translate = [1.1, 1.2, 1.0]

[[mesh]]
name = "lamp"
shape = { kind = "quad", cells = 1 }
material = "lamp"
rotate_degrees = [180, 0, 0]
translate = [0.5, 1.9, 1.5]

[material.wall]
albedo = [0.7, 0.5, 0.3]

[material.red]
albedo = [0.6, 0.1, 0.2]
diffuse = 0.9

[material.gloss]
albedo = 0.1
specular = [0.2, 0.1, 0.05]
power = 12

[material.lamp]
emission = [10, 9, 5]

[camera.main]
position = [1, 1, 0.1]
target = [1, 0.8, 2]
fov_x_degrees = 85
width = 16
height = 12
"#;

fn scene() -> Scene {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.toml");
    std::fs::write(&path, SCENE).expect("written");
    Scene::load(&path, &LoadOptions::default()).expect("a scene")
}

#[track_caller]
fn says(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is missing in: {text}");
    }
}
