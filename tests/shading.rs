//! Pictures with gathered light: against path tracing, and their derivatives against central differences.

mod support;

use antirad::image::{Coverage, Picture, Rasterizer};
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::scene::{BinLayout, Camera, Material, Precision, Scene, SceneBuilder, Shape};
use antirad::shading::{Light, SeenFrom, backward};
use antirad::{Engine, SolveParams};
use glam::{DAffine3, DVec3};
use std::ops::ControlFlow;
use support::{device, finish, load, path, solve};

/// A tilted blocker over a floor and beside a wall, under a lamp.
fn scene() -> Scene {
    let grey = |name: &str, albedo: [f64; 3]| Material { albedo, ..Material::named(name) };
    let floor = Material { specular: [0.08, 0.1, 0.12], power: 15.0, ..grey("floor", [0.7, 0.6, 0.5]) };
    let lamp = Material { emission: [5.0, 4.0, 3.0], ..Material::named("lamp") };
    let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
    let small = DAffine3::from_scale(DVec3::splat(0.4));
    let down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
    let tilt = DAffine3::from_rotation_x(0.3) * DAffine3::from_rotation_z(0.2);
    let wall = DAffine3::from_rotation_z(-1.4);
    let mut builder = SceneBuilder::new();
    builder
        .shape("floor", Shape::Quad { cells: 3 }, &floor, at(0.0, 0.0, 0.0))
        .shape("wall", Shape::Quad { cells: 2 }, &grey("wall", [0.3, 0.7, 0.4]), at(-0.55, 0.5, 0.0) * wall)
        .shape(
            "blocker",
            Shape::Quad { cells: 1 },
            &grey("blocker", [0.5; 3]),
            at(0.1, 0.45, 0.07) * tilt * small,
        )
        .shape("lamp", Shape::Quad { cells: 1 }, &lamp, at(0.05, 1.0, 0.0) * down * small);
    let mut scene = builder.finish("gathered").expect("a scene");
    for (k, vertex) in scene.vertices.iter_mut().enumerate() {
        let wave = |by: f64| 0.01 * (by * (k as f64 + 1.0)).sin();
        *vertex += DVec3::new(wave(1.7), 0.0, wave(2.9));
    }
    scene.settings =
        scene.settings.bins(BinLayout::Concentric { n: 6 }).precision(Precision::F64).tolerance(1e-11);
    scene
}

fn camera() -> Camera {
    Camera {
        name: String::from("above"),
        position: DVec3::new(0.9, 1.3, 1.4),
        target: DVec3::new(0.0, 0.1, 0.0),
        up: DVec3::Y,
        fov_x_degrees: 40.0,
        width: 24,
        height: 18,
    }
}

/// relMSE = mean((I - R)² / (R² + .01)) against another path tracer's picture, whose own noise is about 5e-5.
#[test]
fn a_picture_of_the_cornell_room_is_that_of_another_path_tracer() {
    let device = device();
    let scene = load("scenes/cornell_boxes.toml");
    let camera = &scene.cameras[0];
    let truth = Picture::read_exr(path("scenes/cornell_boxes.exr")).expect("a picture");
    let (mut engine, solution) = solve(&device, &scene, &scene.settings);
    let light = Light::new(&mut engine, &solution, &scene, &scene.cameras).expect("light");
    let coverage = Rasterizer::new(&device).expect("kernels").coverage(&scene, camera, 8).expect("a view");
    let pixels = light.pixels(0, &coverage).expect("pixels");
    let error = |(found, truth): (&[f64; 4], &[f32; 4])| {
        let of = |c: usize| {
            let truth = f64::from(truth[c]);
            (found[c] - truth).powi(2) / (truth * truth + 0.01)
        };
        (of(0) + of(1) + of(2)) / 3.0
    };
    let error = pixels.iter().zip(&truth.pixels).map(error).sum::<f64>() / pixels.len() as f64;
    println!("relMSE {error:.3e}");
    assert!(pixels.len() == truth.pixels.len() && error <= 1.7e-4, "{error:e}");
    drop((engine, solution));
    finish(&device);
}

#[test]
fn derivatives_of_pictures_are_those_of_central_differences() {
    let device = device();
    let scene = scene();
    let camera = camera();
    let options = PlanOptions::of(&device).gradients(GradientRequest::EVERYTHING);
    let engine = |scene: &Scene| {
        let plan = Plan::new(scene, &options, &scene.settings).expect("a plan");
        Engine::new(&device, scene, plan).expect("an engine")
    };
    let params = SolveParams::from(&scene.settings);
    let coverage = Rasterizer::new(&device).expect("kernels").coverage(&scene, &camera, 4).expect("a view");
    let weight = |pixel: usize, channel: usize| ((pixel * 3 + channel) as f64).sin() + 0.3;
    // The coverage is held fixed: silhouettes have tests of their own.
    let base = scene.clone();
    let loss = |scene: &Scene, coverage: &Coverage| {
        // At the same points of each triangle.
        let mut engine = engine(&base).rebuilt(scene).expect("an engine");
        let solution = engine.solve(&params).expect("a solution");
        let light = Light::new(&mut engine, &solution, scene, std::slice::from_ref(&camera)).expect("light");
        let pixels = light.pixels(0, coverage).expect("pixels");
        let of = |(p, rgb): (usize, &[f64; 4])| (0..3).map(|c| weight(p, c) * rgb[c]).sum::<f64>();
        pixels.iter().enumerate().map(of).sum::<f64>()
    };
    let by_pixels: Vec<[f64; 4]> =
        (0..24 * 18).map(|p| [weight(p, 0), weight(p, 1), weight(p, 2), 0.0]).collect();
    let mut own = engine(&scene);
    assert_eq!(own.plan().lamps().len(), 1);
    let solution = own.solve(&params).expect("a solution");
    let light = Light::new(&mut own, &solution, &scene, std::slice::from_ref(&camera)).expect("light");
    let view = SeenFrom { coverage: &coverage, by_pixels: &by_pixels };
    let request = GradientRequest::EVERYTHING;
    let (gradients, targets) =
        backward(&mut own, &solution, &light, &[view], request, &params, &mut |_, _| {
            ControlFlow::Continue(())
        })
        .expect("gradients");
    let materials = gradients.by_material(&scene);
    let difference = |change: &dyn Fn(&mut Scene, f64), step: f64| {
        let at = |by: f64| {
            let mut scene = scene.clone();
            change(&mut scene, by);
            loss(&scene, &coverage)
        };
        (at(step) - at(-step)) / (2.0 * step)
    };
    let check = |what: &str, found: f64, expected: f64, tolerance: f64| {
        let error = (found / expected - 1.0).abs();
        println!("{what}: {found:.8e} {expected:.8e} {error:.1e}");
        assert!(error <= tolerance, "{what}: {found} instead of {expected}");
    };
    for (m, material) in scene.materials.iter().enumerate().filter(|(_, m)| m.name != "lamp") {
        let albedo = |scene: &mut Scene, by: f64| scene.materials[m].albedo[1] += by;
        check(
            &format!("albedo of {}", material.name),
            materials[m].albedo[1],
            difference(&albedo, 1e-5),
            1e-7,
        );
    }
    let lamp = scene.materials.iter().position(|m| m.name == "lamp").expect("a lamp");
    let emission = |scene: &mut Scene, by: f64| scene.materials[lamp].emission[0] += by;
    check("emission", materials[lamp].emission[0], difference(&emission, 1e-4), 1e-7);
    let floor = scene.materials.iter().position(|m| m.name == "floor").expect("a floor");
    let specular = |scene: &mut Scene, by: f64| scene.materials[floor].specular[2] += by;
    check("specular", materials[floor].specular[2], difference(&specular, 1e-5), 1e-7);
    let power = |scene: &mut Scene, by: f64| scene.materials[floor].power += by;
    check("power", materials[floor].power, difference(&power, 1e-3), 1e-6);
    let vertices = gradients.vertices.as_ref().expect("vertices");
    for mesh in ["blocker", "lamp", "floor", "wall"] {
        let mesh = scene.meshes.iter().find(|m| m.name == mesh).expect("a mesh");
        let mut moved: Vec<u32> =
            mesh.range.clone().flat_map(|t| scene.triangles[t as usize].vertices).collect();
        moved.sort_unstable();
        moved.dedup();
        let found: DVec3 = moved.iter().map(|&v| vertices[v as usize]).sum();
        for axis in 0..3 {
            let shift = |scene: &mut Scene, by: f64| {
                moved.iter().for_each(|&v| scene.vertices[v as usize][axis] += by);
            };
            check(&format!("{} along {axis}", mesh.name), found[axis], difference(&shift, 1e-4), 1e-3);
        }
    }
    // The same faces in each pixel.
    let from = |own: &mut Engine, camera: &Camera| {
        let light = Light::new(own, &solution, &scene, std::slice::from_ref(camera)).expect("light");
        let pixels = light.pixels(0, &coverage).expect("pixels");
        let of = |(p, rgb): (usize, &[f64; 4])| (0..3).map(|c| weight(p, c) * rgb[c]).sum::<f64>();
        pixels.iter().enumerate().map(of).sum::<f64>()
    };
    let position = gradients.camera_positions.as_ref().expect("cameras")[0];
    for axis in 0..3 {
        let moved = |by: DVec3, to: DVec3| Camera {
            position: camera.position + by,
            target: camera.target + to,
            ..camera.clone()
        };
        let step = 1e-5 * DVec3::AXES[axis];
        let none = DVec3::ZERO;
        let [above, below] = [step, -step].map(|by| from(&mut own, &moved(by, none)));
        check(&format!("position along {axis}"), position[axis], (above - below) / 2e-5, 1e-4);
        let [above, below] = [step, -step].map(|to| from(&mut own, &moved(none, to)));
        check(&format!("target along {axis}"), targets[0][axis], (above - below) / 2e-5, 1e-4);
    }
    finish(&device);
}
