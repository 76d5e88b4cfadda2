//! Saved scenes load unchanged.

use antirad::backend::BackendChoice;
use antirad::scene::{
    BinLayout, Camera, LoadOptions, Material, Mesh, Normalization, Precision, Scene, SolveSettings,
    SolverChoice, Triangle,
};
use glam::DVec3;
use std::path::Path;

#[track_caller]
fn same(a: &Scene, b: &Scene) {
    // Except for the sign of zero.
    let bits = |scene: &Scene| -> Vec<[u64; 3]> {
        scene.vertices.iter().map(|v| v.to_array().map(|x| (x + 0.0).to_bits())).collect()
    };
    assert_eq!(bits(a), bits(b));
    assert_eq!(a.triangles, b.triangles);
    assert_eq!(a.meshes, b.meshes);
    assert_eq!(a.materials, b.materials);
    assert_eq!(a.cameras, b.cameras);
    assert_eq!(a.settings, b.settings);
    assert_eq!(a.target_error, b.target_error);
    assert_eq!(a.degenerate, b.degenerate);
}

fn load(path: &Path) -> Scene {
    Scene::load(path, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn every_scene_of_the_project() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a copy.toml");
    for entry in std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes")).expect("scenes") {
        let file = entry.expect("an entry").path();
        if file.extension().is_some_and(|end| end == "toml") {
            let scene = load(&file);
            scene.save(&path).expect("written");
            let copy = load(&path);
            same(&scene, &copy);
            assert_eq!(copy.warnings, scene.warnings);
        }
    }
}

/// Numbers without short decimals, names in need of quotes, all settings different from their defaults, meshes without
/// faces, triangles without area, unused vertices and materials.
#[test]
fn awkward_scenes() {
    let third = 1.0 / 3.0;
    let vertices: Vec<DVec3> = [
        [0.1 + 0.2, -0.0, 1e-320],
        [third, 1e17 / 3.0, f64::MIN_POSITIVE],
        [-1e-7, 2e22, 5.0],
        [9.0, 9.0, 9.0],
        [0.0, 0.0, 1e22 * third],
        [1e22, 0.0, 0.0],
        [0.0, 1e22, 0.0],
        [7.0, 7.0, 7.0],
    ]
    .map(DVec3::from)
    .to_vec();
    let triangle = |vertices, material| Triangle { vertices, material };
    let triangles = vec![triangle([0, 1, 2], 1), triangle([4, 5, 6], 0), triangle([5, 4, 4], 2)];
    let material = |name: &str, diffuse, normalization| Material {
        diffuse,
        albedo: [third, 0.1, 1e-300],
        specular: [0.0, third / 7.0, 0.0],
        power: 12.345678901234567,
        emission: [1e99, 0.0, 17.0 / 9.0],
        normalization,
        ..Material::named(name)
    };
    let materials = vec![
        material("white #2\"'.[x]", 0.7, Normalization::Phong),
        material("wood#2 = é", third, Normalization::Energy),
        material("odd\nname\\", 1.0, Normalization::Phong),
        Material::named("spare"),
    ];
    let mut scene = Scene::new("awkward", vertices, triangles, materials).expect("a scene");
    let mesh = |name: &str, range| Mesh { name: name.to_owned(), range };
    scene.meshes = vec![mesh("a \"b\"\n", 0..1), mesh("none", 1..1), mesh("c", 1..3)];
    for name in ["zoo", "a.b"] {
        let camera = Camera {
            name: name.to_owned(),
            fov_x_degrees: 100.0 / 3.0,
            ..Camera::framing(&scene.vertices[3..])
        };
        scene.set_camera(camera).expect("a camera");
    }
    scene.settings = SolveSettings::default()
        .bins(BinLayout::Concentric { n: 8 })
        .near_field(third)
        .tolerance(1e-7)
        .max_passes(77)
        .solver(SolverChoice::FixedPoint)
        .precision(Precision::F64)
        .backend(BackendChoice::Vulkan);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.toml");
    scene.save(&path).expect("written");
    // What MTL cannot express, and nothing else.
    scene.materials[0].name = "white _2\"'.[x]".to_owned();
    scene.materials[2].name = "odd_name_".to_owned();
    same(&scene, &load(&path));
    let mut files = crate::names(folder.path());
    files.sort();
    assert_eq!(files, ["s.mtl", "s.toml", "s_1.obj", "s_2.obj", "s_3.obj"]);

    // A target error is saved alone, without the settings that are chosen for it.
    scene.target_error = Some(0.05);
    scene.save(&path).expect("written");
    let SolveSettings { bins, near_field, tolerance, .. } = SolveSettings::default();
    scene.settings = scene.settings.bins(bins).near_field(near_field).tolerance(tolerance);
    same(&scene, &load(&path));
}

/// Meshes in memory that share vertices: every corner keeps its position.
#[test]
fn meshes_that_share_vertices() {
    let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let triangles = [[0, 1, 2], [1, 3, 2]].map(|vertices| Triangle { vertices, material: 0 }).to_vec();
    let mut scene = Scene::new("s", vertices, triangles, vec![Material::named("m")]).expect("a scene");
    let mesh = |name: &str, range| Mesh { name: name.to_owned(), range };
    scene.meshes = vec![mesh("a", 0..1), mesh("b", 1..2)];
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.toml");
    scene.save(&path).expect("written");
    let copy = load(&path);
    assert_eq!(copy.meshes, scene.meshes);
    for i in 0..2 {
        assert_eq!(copy.corners(i), scene.corners(i));
    }
}

#[test]
fn one_material_a_triangle_comes_back() {
    let mut scene = load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell_boxes.toml"));
    scene.split_materials(&(0..scene.triangles.len() as u64).collect::<Vec<_>>());
    assert_eq!(scene.materials.len(), scene.triangles.len());
    for (i, material) in scene.materials.iter_mut().enumerate() {
        material.albedo = [0.3 + 1e-9 * i as f64; 3];
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.toml");
    scene.save(&path).expect("written");
    let copy = load(&path);
    for i in 0..scene.triangles.len() {
        assert_eq!(copy.material(i), scene.material(i));
    }
    same(&scene, &copy);
}
