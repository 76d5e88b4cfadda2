//! The scenes of this repository.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use antirad::scene::{LoadOptions, Scene};
use glam::DVec3;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
}

/// True if every edge between two positions occurs once in each direction.
fn is_closed(scene: &Scene) -> bool {
    let mut balance: HashMap<[[i64; 3]; 2], i32> = HashMap::new();
    let weld = |v: DVec3| (v * 1e7).round().to_array().map(|c| c as i64);
    for triangle in 0..scene.triangles.len() {
        let [a, b, c] = scene.corners(triangle).map(weld);
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (edge, sign) = if from < to { ([from, to], 1) } else { ([to, from], -1) };
            *balance.entry(edge).or_default() += sign;
        }
    }
    balance.values().all(|&sum| sum == 0)
}

#[test]
fn shipped_scenes_load() {
    let mut seen = 0;
    let folder = |name| std::fs::read_dir(shipped(name)).expect("a folder of scenes").flatten();
    for entry in folder("").chain(folder("weaknesses")) {
        let path = entry.path();
        if path.extension().is_some_and(|e| e == "toml") {
            let scene = Scene::load(&path, &LoadOptions::default().strict(true))
                .unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(scene.warnings, [""; 0], "{}", scene.name);
            assert!(scene.camera("main").is_some(), "{}", scene.name);
            seen += 1;
        }
    }
    assert!(seen >= 10);
}

/// Jobs, and the scenes that only they use.
#[test]
fn shipped_jobs_name_scenes_that_load() {
    let mut jobs = 0;
    for entry in std::fs::read_dir(shipped("fits")).expect("the folder of jobs").flatten() {
        let text = std::fs::read_to_string(entry.path()).expect("a file");
        let table: toml::Table = text.parse().expect("TOML");
        let Some(scene) = table.get("scene").and_then(toml::Value::as_str) else { continue };
        let scene =
            Scene::load(&shipped("fits").join(scene), &LoadOptions::default().strict(true)).expect("a scene");
        for target in table["target"].as_array().expect("targets") {
            let camera = target["camera"].as_str().expect("a name");
            assert!(scene.camera(camera).is_some(), "{camera} of {:?}", entry.path());
        }
        jobs += 1;
    }
    assert_eq!(jobs, 10);
}

#[test]
fn shipped_scenes_are_as_large_and_as_closed_as_they_say() {
    for (name, triangles, closed) in [
        ("cornell_boxes.toml", 3092..3093, false),
        ("cornell_boxes_fine.toml", 12368..12369, false),
        ("closed_box.toml", 1200..1201, true),
        ("integrating_sphere.toml", 1280..1281, true),
        ("two_rooms.toml", 2000..4000, true),
        ("glossy_floor.toml", 1500..4000, false),
        ("statue.toml", 11000..11500, false),
    ] {
        let scene =
            Scene::load(&shipped(name), &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
        assert!(triangles.contains(&scene.triangles.len()), "{name}: {}", scene.triangles.len());
        assert_eq!(is_closed(&scene), closed, "{name}");
    }
}
