//! Pictures with gathered light: against path tracing, and their derivatives against central differences.

mod support;

use antirad::image::{Picture, Rasterizer};
use antirad::path_tracer::PathTracer;
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::render::{CameraGradient, Light, Reflections};
use antirad::scene::{
    BinLayout, Camera, Lamps, LoadOptions, Material, Precision, Scene, SceneBuilder, Shape, Sun, Triangle,
    VisibilityChoice,
};
use antirad::{Engine, SolveParams};
use antirad_render::image::Coverage;
use antirad_render::shading::{SeenFrom, ShadingError, backward};
use glam::{DAffine3, DVec3};
use std::ops::ControlFlow;
use support::{backend, finish, load, path, solve};

/// A tilted blocker over a floor and beside a wall, under a lamp.
fn scene() -> Scene {
    scene_with_lamps(1)
}

/// With a lamp of `cells` x `cells` squares. If there are several, vertices are so uneven that each triangle is a lamp of its own.
fn scene_with_lamps(cells: u32) -> Scene {
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
        .shape("lamp", Shape::Quad { cells }, &lamp, at(0.05, 1.0, 0.0) * down * small);
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
    let backend = backend();
    let scene = load("scenes/cornell_boxes.toml");
    let camera = &scene.cameras[0];
    let truth = Picture::read_exr(path("scenes/cornell_boxes.exr")).expect("a picture");
    let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
    let light = Light::new(&mut engine, &solution, &scene, &scene.cameras, Reflections::Bins).expect("light");
    let coverage = Rasterizer::new(&backend).expect("kernels").coverage(&scene, camera, 8).expect("a view");
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
    assert!(pixels.len() == truth.pixels.len() && error <= 1.2e-4, "{error:e}");
    drop((engine, solution));
    finish(&backend);
}

/// A polished floor under a striped wall and a box, with one lamp.
fn polished() -> (Scene, Camera) {
    let grey = |name: &str, albedo: [f64; 3]| Material { albedo, ..Material::named(name) };
    let floor = Material { specular: [0.15; 3], power: 400.0, ..grey("floor", [0.1; 3]) };
    let lamp = Material { emission: [9.0; 3], ..Material::named("lamp") };
    let mut builder = SceneBuilder::new();
    builder.shape("floor", Shape::Quad { cells: 4 }, &floor, DAffine3::from_scale(DVec3::new(2.0, 1.0, 2.0)));
    for stripe in 0..4 {
        let colour = [[0.8, 0.2, 0.1], [0.2, 0.3, 0.8]][stripe % 2];
        let place = DAffine3::from_translation(DVec3::new(-0.75 + 0.5 * stripe as f64, 0.5, -1.0))
            * DAffine3::from_rotation_x(std::f64::consts::FRAC_PI_2)
            * DAffine3::from_scale(DVec3::new(0.5, 1.0, 1.0));
        builder.shape("stripe", Shape::Quad { cells: 4 }, &grey(&format!("stripe {stripe}"), colour), place);
    }
    let down = DAffine3::from_translation(DVec3::new(0.2, 1.6, 0.3))
        * DAffine3::from_scale(DVec3::new(0.6, -1.0, 0.6));
    builder.shape("lamp", Shape::Quad { cells: 1 }, &lamp, down);
    let scene = builder.finish("polished").expect("a scene");
    let camera = Camera {
        position: DVec3::new(0.1, 0.8, 2.2),
        target: DVec3::new(0.0, 0.1, 0.0),
        fov_x_degrees: 50.0,
        width: 48,
        height: 36,
        ..camera()
    };
    (scene, camera)
}

/// What a floor mirrors of a wall: rays see stripes where bins see a blur.
#[test]
fn reflections_by_rays_are_those_of_path_tracing() {
    let backend = backend();
    let (scene, camera) = polished();
    let coverage = Rasterizer::new(&backend).expect("kernels").coverage(&scene, &camera, 4).expect("a view");
    let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
    let traced = PathTracer::new(&scene).picture(&camera, 256, 7);
    let floor: Vec<_> = coverage
        .faces_in_pixels()
        .filter(|seen| seen.share == 1.0 && scene.material(seen.face).is_glossy())
        .collect();
    assert!(floor.len() > 200, "{}", floor.len());
    let mut error = |reflections: Reflections| {
        let cameras = std::slice::from_ref(&camera);
        let light = Light::new(&mut engine, &solution, &scene, cameras, reflections).expect("light");
        let gathered = light.gathered(0, &coverage).expect("pixels");
        let (mut squares, mut noise, mut all) = (0.0, 0.0, 0.0);
        for seen in &floor {
            let truth = &traced.pixels[seen.pixel].radiance;
            squares += (DVec3::from_slice(&gathered.pixels[seen.pixel]) - truth.mean).length_squared();
            noise += truth.error.length_squared();
            all += truth.mean.length_squared();
        }
        let relative = |x: f64| (x.max(0.0) / all).sqrt();
        println!(
            "{reflections:?}: {:.4}, noise {:.4}, stated {:.4}",
            relative(squares - noise),
            relative(noise),
            gathered.error
        );
        [relative(squares - noise), gathered.error]
    };
    let [by_rays, stated] = error(Reflections::Rays);
    let [by_bins, none] = error(Reflections::Bins);
    assert!(by_rays <= 0.02 && by_bins >= 3.0 * by_rays, "{by_rays} {by_bins}");
    assert!(stated > 0.0 && stated <= 0.01 && none == 0.0, "{stated} {none}");
    // They have no derivatives, and say so.
    let cameras = std::slice::from_ref(&camera);
    let light = Light::new(&mut engine, &solution, &scene, cameras, Reflections::Rays).expect("light");
    let by_pixels = vec![[0.0; 4]; 48 * 36];
    let view = SeenFrom { coverage: &coverage, by_pixels: &by_pixels };
    let params = SolveParams::from(&scene.settings);
    let request = GradientRequest::EVERYTHING;
    let result = backward(&mut engine, &solution, &light, &[view], request, &[], &params, &mut |_, _| {
        ControlFlow::Continue(())
    });
    assert!(matches!(result, Err(ShadingError::Rays)));
    drop((engine, solution));
    finish(&backend);
}

/// A room that a sun lights through a window, against path tracing: relMSE without the noise of that. Walls vary within faces beside the patch on the
/// floor, which pictures without derivatives gather.
#[test]
fn a_sunlit_room_is_that_of_path_tracing() {
    let backend = backend();
    let scene = load("scenes/sunlit_room.toml");
    let camera = Camera { width: 64, height: 48, ..scene.cameras[0].clone() };
    let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
    let coverage = Rasterizer::new(&backend).expect("kernels").coverage(&scene, &camera, 8).expect("a view");
    let traced = PathTracer::new(&scene).picture(&camera, 256, 1);
    let [gathered, interpolated] = [Reflections::Rays, Reflections::FixedRays].map(|reflections| {
        let light = Light::new(&mut engine, &solution, &scene, std::slice::from_ref(&camera), reflections)
            .expect("light");
        let found = light.pixels(0, &coverage).expect("pixels");
        let error = found.iter().zip(&traced.pixels).map(|(&[r, g, b, _], pixel)| {
            let (truth, noise) = (pixel.radiance.mean, pixel.radiance.error);
            let squares = (DVec3::new(r, g, b) - truth).powf(2.0) - noise.powf(2.0);
            (squares / (truth * truth + 0.01)).element_sum() / 3.0
        });
        error.sum::<f64>() / found.len() as f64
    });
    println!(
        "sunlit room: relMSE {gathered:.2e}, interpolated {interpolated:.2e}, noise {:.2e}",
        traced.noise().powi(2)
    );
    assert!(gathered <= 4.3e-3 && gathered <= interpolated - 5e-4, "{gathered:e}, {interpolated:e}");
    drop((engine, solution));
    finish(&backend);
}

#[test]
fn derivatives_of_pictures_are_those_of_central_differences() {
    derivatives_are_those_of_central_differences(&scene());
}

/// In wide penumbras, and on a glossy floor.
#[test]
fn derivatives_of_sunlit_pictures_are_those_of_central_differences() {
    let mut scene = scene();
    let sun = Sun { angular_diameter: 12.0, ..Sun::new(DVec3::new(0.4, -1.0, 0.25), [3.0, 2.0, 4.0]) };
    scene.add_sun(sun).expect("a sun");
    derivatives_are_those_of_central_differences(&scene);
}

/// A sheet across a dark room, with a lamp on one side: what interpolates across its foot shows light of that side on the other.
#[test]
fn light_does_not_pass_the_foot_of_a_sheet() {
    let backend = backend();
    let grey = |name: &str| Material { albedo: [0.6; 3], ..Material::named(name) };
    let lamp = Material { emission: [10.0; 3], ..Material::named("lamp") };
    let placed = |size: [f64; 3], at: [f64; 3]| {
        DAffine3::from_translation(at.into()) * DAffine3::from_scale(size.into())
    };
    // Ten cells along the room, six high, of two sides.
    let corners = (0..7)
        .flat_map(|j| (0..11).map(move |i| DVec3::new(1.87, 2.2 * f64::from(j) / 6.0, 0.4 * f64::from(i))));
    let cells = (0..6).flat_map(|j| (0..10).map(move |i| 11 * j + i));
    let faces = cells
        .flat_map(|a| [[a, a + 1, a + 12], [a, a + 12, a + 11], [a, a + 12, a + 1], [a, a + 11, a + 12]]);
    let mut builder = SceneBuilder::new();
    builder
        .shape("room", Shape::Room { cells: 12 }, &grey("room"), placed([4.0, 3.0, 4.0], [0.0; 3]))
        .shape("lamp", Shape::Quad { cells: 2 }, &lamp, placed([0.8, -1.0, 0.8], [2.5, 1.6, 1.6]))
        .mesh("sheet", corners.collect(), faces.collect(), &grey("sheet"), DAffine3::IDENTITY);
    let mut scene = builder.finish("sheet").expect("a scene");
    scene.settings = scene.settings.bins(BinLayout::Concentric { n: 10 });
    scene.cut_along_contacts(10_000);
    let camera = Camera {
        position: DVec3::new(0.3, 1.6, 2.0),
        target: DVec3::new(2.0, 0.0, 2.0),
        fov_x_degrees: 60.0,
        width: 32,
        height: 24,
        ..camera()
    };
    let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
    let coverage = Rasterizer::new(&backend).expect("kernels").coverage(&scene, &camera, 4).expect("a view");
    let traced = PathTracer::new(&scene).picture(&camera, 256, 1);
    let floor: Vec<usize> = coverage
        .faces_in_pixels()
        .filter(|seen| seen.share == 1.0 && scene.corners(seen.face).iter().all(|p| p.y == 0.0))
        .map(|seen| seen.pixel)
        .collect();
    assert!(floor.len() > 100, "{}", floor.len());
    let mut error = |scene: &Scene| {
        let cameras = std::slice::from_ref(&camera);
        let light = Light::new(&mut engine, &solution, scene, cameras, Reflections::Bins).expect("light");
        let pixels = light.pixels(0, &coverage).expect("pixels");
        let (mut squares, mut all) = (0.0, 0.0);
        for &pixel in &floor {
            let truth = &traced.pixels[pixel].radiance;
            squares += (DVec3::from_slice(&pixels[pixel]) - truth.mean).length_squared()
                - truth.error.length_squared();
            all += truth.mean.length_squared();
        }
        f64::sqrt(f64::max(squares, 0.0) / all)
    };
    let found = error(&scene);
    let across = error(&Scene { creases: Vec::new(), ..scene.clone() });
    println!("the foot of a sheet: {:.1} %, across its foot {:.1} %", 100.0 * found, 100.0 * across);
    assert!(found <= 0.1 && across >= 0.5, "{found} {across}");
    drop((engine, solution));
    finish(&backend);
}

/// A crease from one border of the floor to the other.
#[test]
fn derivatives_beside_creases_are_those_of_central_differences() {
    let mut scene = scene();
    let on_line = |t: usize, k: usize| (scene.corners(t)[k].x - 1.0 / 3.0).abs() < 0.05;
    let creases: Vec<[bool; 3]> = (0..scene.triangles.len())
        .map(|t| [0, 1, 2].map(|k| t < 18 && on_line(t, k) && on_line(t, (k + 1) % 3)))
        .collect();
    assert_eq!(creases.iter().flatten().filter(|crease| **crease).count(), 6);
    scene.creases = creases;
    derivatives_are_those_of_central_differences(&scene);
}

type VectorOf = fn(&mut Camera) -> &mut DVec3;

/// The vectors of a camera with the derivatives by them.
fn vectors(by: CameraGradient) -> [(&'static str, VectorOf, DVec3); 3] {
    [
        ("position", |camera| &mut camera.position, by.position),
        ("target", |camera| &mut camera.target, by.target),
        ("up", |camera| &mut camera.up, by.up),
    ]
}

fn derivatives_are_those_of_central_differences(scene: &Scene) {
    let backend = backend();
    let camera = camera();
    let options = PlanOptions::of(&backend).gradients(GradientRequest::EVERYTHING);
    let engine = |scene: &Scene| {
        let settings = scene.settings.visibility(VisibilityChoice::Implicit);
        let plan = Plan::new(scene, &options, &settings).expect("a plan");
        Engine::new(&backend, scene, plan).expect("an engine")
    };
    let params = SolveParams::from(&scene.settings);
    let coverage = Rasterizer::new(&backend).expect("kernels").coverage(scene, &camera, 4).expect("a view");
    let weight = |pixel: usize, channel: usize| ((pixel * 3 + channel) as f64).sin() + 0.3;
    // The coverage is held fixed: silhouettes have tests of their own.
    let loss = |changed: &Scene, coverage: &Coverage| {
        // At the same points of each triangle.
        let mut engine = engine(scene).rebuilt(changed).expect("an engine");
        let solution = engine.solve(&params).expect("a solution");
        let light =
            Light::new(&mut engine, &solution, changed, std::slice::from_ref(&camera), Reflections::Bins)
                .expect("light");
        let pixels = light.pixels(0, coverage).expect("pixels");
        let of = |(p, rgb): (usize, &[f64; 4])| (0..3).map(|c| weight(p, c) * rgb[c]).sum::<f64>();
        pixels.iter().enumerate().map(of).sum::<f64>()
    };
    let by_pixels: Vec<[f64; 4]> =
        (0..24 * 18).map(|p| [weight(p, 0), weight(p, 1), weight(p, 2), 0.0]).collect();
    let mut own = engine(scene);
    assert_eq!(own.plan().lamps().len(), 1 + scene.suns.len());
    let solution = own.solve(&params).expect("a solution");
    let light = Light::new(&mut own, &solution, scene, std::slice::from_ref(&camera), Reflections::Bins)
        .expect("light");
    let view = SeenFrom { coverage: &coverage, by_pixels: &by_pixels };
    let request = GradientRequest::EVERYTHING;
    let (gradients, cameras, _) =
        backward(&mut own, &solution, &light, &[view], request, &[], &params, &mut |_, _| {
            ControlFlow::Continue(())
        })
        .expect("gradients");
    let materials = gradients.by_material(scene);
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
    let suns = gradients.suns.as_ref().expect("suns");
    assert_eq!(suns.len(), scene.suns.len());
    for (k, by) in suns.iter().enumerate() {
        let irradiance = |scene: &mut Scene, by: f64| scene.suns[k].irradiance[2] += by;
        check("irradiance", by[2], difference(&irradiance, 1e-4), 1e-7);
    }
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
            // A longer step takes a shadow's edge over a point.
            check(&format!("{} along {axis}", mesh.name), found[axis], difference(&shift, 1e-5), 1e-3);
        }
    }
    // The same faces in each pixel.
    let from = |own: &mut Engine, camera: &Camera| {
        let light = Light::new(own, &solution, scene, std::slice::from_ref(camera), Reflections::Bins)
            .expect("light");
        let pixels = light.pixels(0, &coverage).expect("pixels");
        let of = |(p, rgb): (usize, &[f64; 4])| (0..3).map(|c| weight(p, c) * rgb[c]).sum::<f64>();
        pixels.iter().enumerate().map(of).sum::<f64>()
    };
    let position = gradients.camera_positions.as_ref().expect("cameras")[0] + cameras[0].position;
    for (what, vector, found) in vectors(CameraGradient { position, ..cameras[0] }) {
        for axis in 0..3 {
            let [above, below] = [1e-5, -1e-5].map(|by| {
                let mut moved = camera.clone();
                vector(&mut moved)[axis] += by;
                from(&mut own, &moved)
            });
            // Relative to the whole derivative: by up, it is zero along some directions.
            let (difference, size) = ((above - below) / 2e-5, found.length());
            println!("{what} along {axis}: {:.8e} {difference:.8e}", found[axis]);
            let error = (found[axis] - difference).abs();
            assert!(error <= 1e-4 * size, "{what} along {axis}: {found}, but not {difference}");
        }
    }
    finish(&backend);
}

/// Emission and materials, where rays tell what glossy faces mirror of each other, of one lamp exactly and by antiradiance, and of many by rays
/// that are distributed over them.
#[test]
fn derivatives_of_reflections_by_rays_are_those_of_central_differences() {
    let backend = backend();
    for (cells, lamps) in [(1, Lamps::Auto), (1, Lamps::Antiradiance), (9, Lamps::Sampled)] {
        let mut scene = scene_with_lamps(cells);
        let wall = scene.materials.iter_mut().find(|m| m.name == "wall").expect("a wall");
        (wall.specular, wall.power) = ([0.1, 0.05, 0.15], 25.0);
        scene.settings = scene.settings.lamps(lamps);
        let camera = camera();
        let request = GradientRequest::EVERYTHING.positions(false).camera(false);
        let options = PlanOptions::of(&backend).gradients(request);
        let params = SolveParams::from(&scene.settings);
        let coverage =
            Rasterizer::new(&backend).expect("kernels").coverage(&scene, &camera, 4).expect("a view");
        let weight = |pixel: usize, channel: usize| ((pixel * 3 + channel) as f64).sin() + 0.3;
        let plan = Plan::new(&scene, &options, &scene.settings).expect("a plan");
        assert_eq!(plan.report().lamps.why.contains("distributed"), cells > 1);
        let mut engine = Engine::new(&backend, &scene, plan).expect("an engine");
        let mut light_of = |scene: &Scene| {
            engine.set_materials(scene).expect("materials");
            let solution = engine.solve(&params).expect("a solution");
            let cameras = std::slice::from_ref(&camera);
            let light =
                Light::new(&mut engine, &solution, scene, cameras, Reflections::FixedRays).expect("light");
            (solution, light)
        };
        let mut difference = |change: &dyn Fn(&mut Scene, f64), step: f64| {
            let mut at = |by: f64| {
                let mut scene = scene.clone();
                change(&mut scene, by);
                let pixels = light_of(&scene).1.pixels(0, &coverage).expect("pixels");
                let of = |(p, rgb): (usize, &[f64; 4])| (0..3).map(|c| weight(p, c) * rgb[c]).sum::<f64>();
                pixels.iter().enumerate().map(of).sum::<f64>()
            };
            (at(step) - at(-step)) / (2.0 * step)
        };
        let mut expected = Vec::new();
        for (m, material) in scene.materials.iter().enumerate() {
            let lamp = material.name == "lamp";
            let of = |what: &str| format!("{what} of {}", material.name);
            if lamp {
                let by = |scene: &mut Scene, by: f64| scene.materials[m].emission[0] += by;
                expected.push((of("emission"), m, difference(&by, 1e-4), 1e-7));
            } else {
                let by = |scene: &mut Scene, by: f64| scene.materials[m].albedo[1] += by;
                expected.push((of("albedo"), m, difference(&by, 1e-5), 1e-7));
            }
            if material.is_glossy() {
                let by = |scene: &mut Scene, by: f64| scene.materials[m].specular[2] += by;
                expected.push((of("specular"), m, difference(&by, 1e-5), 1e-7));
                let by = |scene: &mut Scene, by: f64| scene.materials[m].power += by;
                expected.push((of("power"), m, difference(&by, 1e-3), 1e-6));
            }
        }
        let (solution, light) = light_of(&scene);
        let by_pixels: Vec<[f64; 4]> =
            (0..24 * 18).map(|p| [weight(p, 0), weight(p, 1), weight(p, 2), 0.0]).collect();
        // Once with rays of its own, and once with those that pictures have found.
        for known in [false, true] {
            if known {
                light.pixels(0, &coverage).expect("pixels");
            }
            let view = SeenFrom { coverage: &coverage, by_pixels: &by_pixels };
            let go_on = &mut |_: u32, _: f64| ControlFlow::Continue(());
            let (gradients, ..) =
                backward(&mut engine, &solution, &light, &[view], request, &[], &params, go_on)
                    .expect("gradients");
            let materials = gradients.by_material(&scene);
            for (what, m, expected, tolerance) in &expected {
                let of = &materials[*m];
                let found = match what.split(' ').next() {
                    Some("emission") => of.emission[0],
                    Some("albedo") => of.albedo[1],
                    Some("specular") => of.specular[2],
                    _ => of.power,
                };
                let error = (found / expected - 1.0).abs();
                println!("{what}: {found:.8e} {expected:.8e} {error:.1e}");
                assert!(error <= *tolerance, "{what}: {found} instead of {expected}");
            }
        }
    }
    finish(&backend);
}

/// A texture that is smooth on the scale of its texels: (1 + share · sin) / 2 along both axes, by channel.
fn waves(u: f64, v: f64, channel: usize) -> f64 {
    let turns = std::f64::consts::TAU;
    0.5 + 0.2 * (turns * (2.0 + channel as f64) * u).sin() + 0.2 * (turns * 3.0 * v + channel as f64).cos()
}

/// A floor of two triangles with the waves as albedo, 4 m below a lamp of two triangles with the waves as emission, and a small wall between
/// them, without a texture.
fn textured_scene() -> Scene {
    let folder = tempfile::tempdir().expect("a folder");
    let obj = "mtllib m.mtl\nv -2 0 -2\nv -2 0 2\nv 2 0 2\nv 2 0 -2\nvt 0 0\nvt 0 1\nvt 1 1\nvt 1 0\nusemtl floor\n\
f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nv -1 4 -1\nv -1 4 1.1\nv 1 4 1\nv 1 4 -1\nusemtl lamp\nf 5/1 8/4 7/3\nf 5/1 7/3 6/2\n\
v .5 .2 .3\nv 1.4 .2 -.6\nv 1.2 1.3 0\nusemtl wall\nf 9 10 11\nf 9 11 10\n";
    let mtl = "newmtl floor\nKd 1 .9 .8\nmap_Kd waves.png\nnewmtl lamp\nKd 0 0 0\nKe 8 9 10\nmap_Ke waves.png\nnewmtl wall\nKd .5 .5 .5\n";
    let code = |light: f64| {
        let srgb = if light <= 0.0031308 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
        (srgb * 65535.0).round() as u16
    };
    let size = 128;
    let texture = image::ImageBuffer::<image::Rgb<u16>, Vec<u16>>::from_fn(size, size, |x, y| {
        let (u, v) = ((f64::from(x) + 0.5) / f64::from(size), 1.0 - (f64::from(y) + 0.5) / f64::from(size));
        image::Rgb([0, 1, 2].map(|c| code(waves(u, v, c))))
    });
    texture.save(folder.path().join("waves.png")).expect("a texture");
    std::fs::write(folder.path().join("s.obj"), obj).expect("written");
    std::fs::write(folder.path().join("m.mtl"), mtl).expect("written");
    let mut scene =
        Scene::load(&folder.path().join("s.obj"), &LoadOptions::default()).expect("a textured scene");
    scene.settings =
        scene.settings.bins(BinLayout::Concentric { n: 6 }).precision(Precision::F64).tolerance(1e-11);
    scene
}

fn above(width: u32, height: u32) -> Camera {
    Camera {
        position: DVec3::new(-0.7, 3.0, 1.9),
        target: DVec3::new(0.2, 0.0, -0.1),
        width,
        height,
        ..camera()
    }
}

/// Irradiance does not depend on the floor's texture but for what comes back, so the ratio to the picture of a uniform floor is the texture.
#[test]
fn pictures_show_textures() {
    let backend = backend();
    let mut scene = textured_scene();
    // Without light that comes back from the wall.
    let wall = scene.triangles.iter().filter(|t| scene.materials[t.material as usize].name == "wall");
    let wall: Vec<u32> = wall.map(|t| t.material).collect();
    scene.materials[wall[0] as usize].albedo = [0.0; 3];
    let camera = above(80, 60);
    let coverage = Rasterizer::new(&backend).expect("kernels").coverage(&scene, &camera, 4).expect("a view");
    let pixels = |scene: &Scene| {
        let (mut engine, solution) = solve(&backend, scene, &scene.settings);
        let light =
            Light::new(&mut engine, &solution, scene, std::slice::from_ref(&camera), Reflections::Bins)
                .expect("light");
        light.pixels(0, &coverage).expect("pixels")
    };
    let shown = pixels(&scene);
    let mut plain = scene.clone();
    plain.patterns = Default::default();
    let grey = plain.materials.len() as u32;
    plain.materials.push(Material { albedo: [0.5; 3], ..Material::named("plain") });
    for t in &mut plain.triangles[..2] {
        t.material = grey;
    }
    let plain = pixels(&plain);
    let view = antirad_render::image::View::new(&camera);
    let mut checked = 0;
    for (at, (shown, plain)) in shown.iter().zip(&plain).enumerate() {
        let ray = view.ray((at % 80) as f64 + 0.5, (at / 80) as f64 + 0.5);
        let point = camera.position - ray * (camera.position.y / ray.y);
        // Well inside of the floor, and neither the wall nor in its penumbra, where the quadrature of the two pictures is the same anyway.
        if !coverage.faces_in_pixels().any(|seen| seen.pixel == at && seen.face < 2 && seen.share == 1.0)
            || point.abs().max_element() > 1.9
        {
            continue;
        }
        let (u, v) = ((point.x + 2.0) / 4.0, (point.z + 2.0) / 4.0);
        for c in 0..3 {
            let albedo = 0.5 * shown[c] / plain[c];
            let expected = [1.0, 0.9, 0.8][c] * waves(u, v, c);
            assert!((albedo - expected).abs() <= 0.01, "pixel {at}, channel {c}: {albedo}, not {expected}");
        }
        checked += 1;
    }
    assert!(checked > 1500, "{checked}");
    // The mean over a triangle of the lamp is what shines.
    let mean = |t: usize| scene.material(t).emission[1];
    assert!((mean(2) + mean(3) - 2.0 * 4.5).abs() < 0.02, "{} {}", mean(2), mean(3));
    finish(&backend);
}

/// The path tracer, which looks textures up at each point of a path, sees the same floor.
#[test]
fn path_traced_pictures_show_the_same_textures() {
    let backend = backend();
    let scene = textured_scene();
    let camera = above(40, 30);
    let coverage = Rasterizer::new(&backend).expect("kernels").coverage(&scene, &camera, 4).expect("a view");
    let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
    let light = Light::new(&mut engine, &solution, &scene, std::slice::from_ref(&camera), Reflections::Bins)
        .expect("light");
    let shown = light.pixels(0, &coverage).expect("pixels");
    let traced = PathTracer::new(&scene).picture(&camera, 256, 5);
    let (mut checked, mut squares, mut noise, mut all) = (0, 0.0, 0.0, 0.0);
    for seen in coverage.faces_in_pixels().filter(|seen| seen.face < 2 && seen.share == 1.0) {
        let truth = &traced.pixels[seen.pixel].radiance;
        let difference = DVec3::from_slice(&shown[seen.pixel]) - truth.mean;
        // The lamp's texture is a mean for light transport, and the wall gives some light back: a few per cent.
        assert!(
            difference.abs().cmple(5.0 * truth.error + 0.05 * truth.mean).all(),
            "{difference} of {} ± {}",
            truth.mean,
            truth.error
        );
        squares += difference.length_squared();
        noise += truth.error.length_squared();
        all += truth.mean.length_squared();
        checked += 1;
    }
    assert!(checked > 300, "{checked}");
    let error = ((squares - noise) / all).max(0.0).sqrt();
    assert!(error <= 0.02, "{error}");
    finish(&backend);
}

#[test]
fn derivatives_of_textured_pictures_are_those_of_central_differences() {
    let backend = backend();
    for exact_lamps in [true, false] {
        let mut scene = textured_scene();
        if !exact_lamps {
            scene.settings = scene.settings.lamps(Lamps::Antiradiance);
        }
        // The floor and, at the upper edge, the lamp from below.
        let views = [
            above(20, 14),
            Camera {
                position: DVec3::new(0.1, 0.9, 0.2),
                target: DVec3::new(-0.1, 4.0, 0.1),
                up: DVec3::Z,
                ..above(12, 9)
            },
        ];
        let options = PlanOptions::of(&backend).gradients(GradientRequest::EVERYTHING);
        let engine = |scene: &Scene| {
            let settings = scene.settings.visibility(VisibilityChoice::Implicit);
            let plan = Plan::new(scene, &options, &settings).expect("a plan");
            Engine::new(&backend, scene, plan).expect("an engine")
        };
        let params = SolveParams::from(&scene.settings);
        let rasterizer = Rasterizer::new(&backend).expect("kernels");
        let coverages = views.each_ref().map(|view| rasterizer.coverage(&scene, view, 4).expect("a view"));
        let weight = |pixel: usize, channel: usize| ((pixel * 3 + channel) as f64).sin() + 0.3;
        let base = scene.clone();
        let loss = |scene: &Scene, views: &[Camera; 2]| {
            let mut engine = engine(&base).rebuilt(scene).expect("an engine");
            let solution = engine.solve(&params).expect("a solution");
            let light = Light::new(&mut engine, &solution, scene, views, Reflections::Bins).expect("light");
            let of = |(p, rgb): (usize, &[f64; 4])| (0..3).map(|c| weight(p, c) * rgb[c]).sum::<f64>();
            let of_view = |k: usize| {
                light.pixels(k, &coverages[k]).expect("pixels").iter().enumerate().map(of).sum::<f64>()
            };
            of_view(0) + of_view(1)
        };
        let mut own = engine(&base).rebuilt(&scene).expect("an engine");
        let solution = own.solve(&params).expect("a solution");
        let light = Light::new(&mut own, &solution, &scene, &views, Reflections::Bins).expect("light");
        let by_pixels = views.each_ref().map(|view| -> Vec<[f64; 4]> {
            let pixels = (view.width * view.height) as usize;
            (0..pixels).map(|p| [weight(p, 0), weight(p, 1), weight(p, 2), 0.0]).collect()
        });
        let seen: Vec<SeenFrom> = coverages
            .iter()
            .zip(&by_pixels)
            .map(|(coverage, by_pixels)| SeenFrom { coverage, by_pixels })
            .collect();
        let request = GradientRequest::EVERYTHING;
        let (gradients, mut cameras, _) =
            backward(&mut own, &solution, &light, &seen, request, &[], &params, &mut |_, _| {
                ControlFlow::Continue(())
            })
            .expect("gradients");
        let check = |what: &str,
                     found: f64,
                     scale: f64,
                     change: &dyn Fn(&mut Scene, &mut [Camera; 2], f64),
                     step: f64,
                     tolerance: f64| {
            let at = |by: f64| {
                let (mut scene, mut views) = (scene.clone(), views.clone());
                change(&mut scene, &mut views, by);
                loss(&scene, &views)
            };
            let expected = (at(step) - at(-step)) / (2.0 * step);
            let error = (found - expected).abs() / scale;
            println!("{what}: {found:.8e} {expected:.8e} {error:.1e}");
            assert!(error <= tolerance, "{what}: {found} instead of {expected}");
        };
        let by_albedo = gradients.albedo.as_ref().expect("albedo");
        let by_emission = gradients.emission.as_ref().expect("emission");
        for t in 0..2 {
            let Triangle { material, .. } = scene.triangles[t];
            let albedo =
                |scene: &mut Scene, _: &mut _, by: f64| scene.materials[material as usize].albedo[1] += by;
            check(&format!("albedo of {t}"), by_albedo[t][1], by_albedo[t][1], &albedo, 1e-5, 1e-7);
            let Triangle { material, .. } = scene.triangles[2 + t];
            let emission =
                |scene: &mut Scene, _: &mut _, by: f64| scene.materials[material as usize].emission[2] += by;
            check(
                &format!("emission of {t}"),
                by_emission[2 + t][2],
                by_emission[2 + t][2],
                &emission,
                1e-4,
                1e-7,
            );
        }
        let positions = gradients.camera_positions.as_ref().expect("cameras");
        cameras.iter_mut().zip(positions).for_each(|(to, by)| to.position += *by);
        let by_vertices = gradients.vertices.as_ref().expect("vertices");
        // Relative to the whole derivative of a point. Derivatives jump where samples cross texels, hence the small steps.
        for axis in 0..3 {
            for view in 0..2 {
                for (what, vector, found) in vectors(cameras[view]) {
                    let shift = |_: &mut Scene, views: &mut [Camera; 2], by: f64| {
                        vector(&mut views[view])[axis] += by;
                    };
                    let what = format!("{what} of {view} along {axis}");
                    check(&what, found[axis], found.length(), &shift, 1e-8, 1e-5);
                }
            }
            for (what, vertices) in [("floor", 0..4), ("lamp", 4..8)] {
                let found: DVec3 = vertices.clone().map(|v| by_vertices[v]).sum();
                let shift = |scene: &mut Scene, _: &mut _, by: f64| {
                    vertices.clone().for_each(|v| scene.vertices[v][axis] += by);
                };
                check(&format!("{what} along {axis}"), found[axis], found.length(), &shift, 1e-5, 5e-4);
            }
        }
    }
    finish(&backend);
}
