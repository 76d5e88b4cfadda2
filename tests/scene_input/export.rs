//! Exported scenes come back.

use antirad::export::{Format, export};
use antirad::scene::{LoadOptions, Orient, Scene};
use std::path::Path;

/// The room with two boxes, glossy in part.
fn room() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell_boxes.toml");
    let mut scene = Scene::load(&path, &LoadOptions::default()).expect("a scene");
    scene.materials[0].specular = [0.03; 3];
    scene.materials[0].power = 20.0;
    scene
}

fn again(scene: &Scene, format: Format, light: Option<&[[f64; 3]]>) -> Scene {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("out").with_extension(format.extension());
    export(scene, format, &path, light).expect("written");
    Scene::load(&path, &LoadOptions::default().orient(Orient::Keep)).unwrap_or_else(|error| panic!("{error}"))
}

/// Triangles by their corners, in order of those, with their materials.
fn surfaces(scene: &Scene) -> Vec<([[i64; 3]; 3], usize)> {
    let rounded = |x: f64| (x * 1e5).round() as i64;
    let corners = |t: usize| scene.corners(t).map(|corner| corner.to_array().map(rounded));
    let mut all: Vec<_> = (0..scene.triangles.len()).map(|t| (corners(t), t)).collect();
    all.sort_unstable();
    all
}

#[test]
fn gltf_keeps_everything_in_single_precision() {
    let scene = room();
    let copy = again(&scene, Format::Gltf, None);
    let (before, after) = (surfaces(&scene), surfaces(&copy));
    assert_eq!(before.len(), after.len());
    for ((a, t), (b, u)) in before.iter().zip(&after) {
        assert_eq!((a, scene.material(*t)), (b, copy.material(*u)));
    }
    assert_eq!(copy.cameras.len(), scene.cameras.len());
    for (a, b) in scene.cameras.iter().zip(&copy.cameras) {
        assert_eq!((&a.name, a.width, a.height), (&b.name, b.width, b.height));
        assert!(a.position.abs_diff_eq(b.position, 1e-5) && (a.fov_x_degrees - b.fov_x_degrees).abs() < 1e-4);
        let [ahead, other] = [a, b].map(|c| (c.target - c.position).normalize());
        assert!(ahead.abs_diff_eq(other, 1e-5));
    }
}

#[test]
fn mitsuba_keeps_geometry_lamps_and_diffuse_materials() {
    let scene = room();
    let copy = again(&scene, Format::Mitsuba, None);
    let (before, after) = (surfaces(&scene), surfaces(&copy));
    assert_eq!(before.len(), after.len());
    for ((a, t), (b, u)) in before.iter().zip(&after) {
        let (old, new) = (scene.material(*t), copy.material(*u));
        assert_eq!((a, old.diffuse_albedo(), old.emission), (b, new.diffuse_albedo(), new.emission));
        assert_eq!(old.is_glossy(), new.is_glossy());
        assert!(!old.is_glossy() || (old.power - new.power).abs() < 1e-9);
    }
    let (a, b) = (&scene.cameras[0], &copy.cameras[0]);
    assert_eq!((&a.name, a.width, a.height), (&b.name, b.width, b.height));
    assert!((a.fov_x_degrees - b.fov_x_degrees).abs() < 1e-9 && a.position.abs_diff_eq(b.position, 1e-12));
}

#[test]
fn ply_keeps_vertices_to_the_bit_and_colours() {
    let scene = room();
    let copy = again(&scene, Format::Ply, None);
    for t in 0..scene.triangles.len() {
        assert_eq!(scene.corners(t), copy.corners(t));
        let [old, new] = [scene.material(t).diffuse_albedo(), copy.material(t).albedo];
        assert!(old.iter().zip(new).all(|(a, b)| (a - b).abs() < 1e-6), "{old:?} {new:?}");
    }
    // Light in place of colours, here one below 1, which the reader takes for an albedo.
    let light: Vec<[f64; 3]> = (0..scene.triangles.len()).map(|t| [0.5, t as f64 * 1e-5, 0.25]).collect();
    let lit = again(&scene, Format::Ply, Some(&light));
    assert!((0..light.len()).all(|t| (lit.material(t).albedo[1] - light[t][1]).abs() < 1e-7));
    let lit = again(&scene, Format::Gltf, Some(&light));
    assert_eq!(lit.triangles.len(), scene.triangles.len());
}
