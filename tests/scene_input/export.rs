//! Exported scenes come back.

use antirad::export::{Format, export};
use antirad::scene::{LampFactor, LoadOptions, Material, Orient, Scene, SceneBuilder, Shape};
use glam::{DAffine3, DVec3};
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

/// A box with a texture over an atlas, one side of which emits: the same points have the same albedo and emission.
#[test]
fn gltf_and_scene_files_keep_textures() {
    let mut builder = SceneBuilder::new();
    let white = Material { albedo: [0.8; 3], ..Material::named("white") };
    builder.shape("box", Shape::Box { cells: 2 }, &white, DAffine3::IDENTITY);
    builder.shape("plate", Shape::Quad { cells: 1 }, &white, DAffine3::from_translation(DVec3::Y * 2.0));
    let mut scene = builder.finish("s").expect("a scene");
    let triangles: Vec<u32> = scene.meshes[0].range.clone().collect();
    scene.split_materials(&triangles.iter().map(|t| 1 + u64::from(*t)).collect::<Vec<_>>());
    let (painting, _) = scene.paint(&triangles, [32, 32]).expect("painted");
    let texels = (0..1024).map(|k| DVec3::new(0.5 + 0.4 * (2.3 * f64::from(k)).sin(), 0.3, 0.9)).collect();
    scene.set_painting(&painting, texels);
    for t in 40..48 {
        let material = scene.triangles[t].material as usize;
        scene.materials[material].emission = [3.0, 2.0, 1.0];
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.toml");
    assert_eq!(scene.save(&path).expect("written"), ["s_texture_1.png"]);
    scene.save_lamps(&folder.path().join("lamps.toml")).expect("written");
    let mut saved = Scene::load(&path, &LoadOptions::default()).expect("a scene");
    for copy in [&saved, &again(&scene, Format::Gltf, None)] {
        let (before, after) = (surfaces(&scene), surfaces(copy));
        assert_eq!(before.len(), after.len());
        for ((a, t), (b, u)) in before.iter().zip(&after) {
            assert_eq!((a, scene.material(*t).emission), (b, copy.material(*u).emission));
            for at in [[0.2, 0.3, 0.5], [0.6, 0.1, 0.3], [0.9, 0.05, 0.05]].map(DVec3::from) {
                let albedo = |scene: &Scene, t: usize| {
                    let factors = scene.patterns.at(t, at).map_or(DVec3::ONE, |factors| factors.value[0]);
                    factors * DVec3::from(scene.material(t).albedo)
                };
                let [a, b] = [albedo(&scene, *t), albedo(copy, *u)];
                assert!(a.abs_diff_eq(b, 1e-4), "{a} {b}");
            }
        }
    }
    let lamps = LampFactor::read(&folder.path().join("lamps.toml")).expect("factors");
    saved.scale_lamps(&lamps).unwrap_or_else(|error| panic!("{error}"));
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

/// Two triangles in one place would hide each other at random there: a sheet is one shape of two sides, and has two triangles again when it is read.
#[test]
fn sheets_are_shapes_of_two_sides_for_mitsuba() {
    let corners =
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]].map(DVec3::from).to_vec();
    let faces = vec![[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]];
    let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
    let lamp = Material { emission: [1.0; 3], ..Material::named("lamp") };
    let mut builder = SceneBuilder::new();
    builder.mesh("sheet", corners.clone(), faces.clone(), &grey, DAffine3::IDENTITY);
    builder.mesh("lamp", corners, faces, &lamp, DAffine3::from_translation(DVec3::Z));
    let scene = builder.finish("s").expect("a scene");
    let copy = again(&scene, Format::Mitsuba, None);
    assert_eq!(copy.triangles.len(), 8);
    assert!(copy.other_sides().iter().all(Option::is_some));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("out.xml");
    export(&scene, Format::Mitsuba, &path, None).expect("written");
    let text = std::fs::read_to_string(&path).expect("text");
    assert_eq!(text.matches("twosided").count(), 1, "{text}");
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
