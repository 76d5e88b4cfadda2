//! Rays to lamps by a kernel: against those of the host, and light by them against exact light.

mod support;

use antirad::backend::Backend;
use antirad::gpu::{Device, DeviceKind, GpuError};
use antirad::plan::{Plan, PlanOptions};
use antirad::render::{RenderOptions, Renderer};
use antirad::scene::{BinLayout, Lamps, Material, Precision, Scene, SceneBuilder, Shape};
use antirad::{Engine, SolveParams};
use antirad_core::direct::{DirectLight, Look, Sampling, Traced, Tracer, Visibility, at, lamps};
use antirad_core::model::{Facet, coplanar_tolerance};
use antirad_core::plan::{Placement, lamp_rays_room};
use antirad_core::transport::vulkan::LampRays;
use glam::{DAffine3, DVec3};
use std::f64::consts::PI;
use std::slice;
use std::sync::Arc;
use support::{areas, device, finish, load, placed, relative_l2};

/// Hard cases in a room: a lamp that touches two walls, one flush with the ceiling, a bulb under a shade, a box on the floor and against a
/// wall, a sheet close to the floor, and needles.
fn room() -> Scene {
    let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
    let lamp = |name: &str| Material { emission: [5.0; 3], ..Material::named(name) };
    let down = DAffine3::from_rotation_x(PI);
    let mut builder = SceneBuilder::new();
    let bulb = Shape::Icosphere { level: 1, inward: false };
    builder
        .shape("room", Shape::Room { cells: 3 }, &grey, placed([2.0, 1.0, 2.0], [0.0; 3]))
        .shape("box", Shape::Box { cells: 2 }, &grey, placed([0.5, 0.3, 0.4], [0.0, 0.0, 0.7]))
        .shape("sheet", Shape::Quad { cells: 1 }, &grey, placed([0.3; 3], [1.2, 0.002, 1.3]))
        .shape("flush", Shape::Quad { cells: 2 }, &lamp("flush"), placed([0.5; 3], [0.9, 1.0, 1.2]) * down)
        .shape("bulb", bulb, &lamp("bulb"), placed([0.05; 3], [1.5, 0.4, 0.5]))
        .shape("shade", Shape::Quad { cells: 3 }, &grey, placed([0.3; 3], [1.3, 0.5, 0.4]));
    let triangle = |corners: [[f64; 3]; 3]| (corners.map(DVec3::from).to_vec(), vec![[0, 1, 2]]);
    let (corners, faces) = triangle([[0.0, 0.2, 0.0], [0.3, 0.2, 0.0], [0.0, 0.2, 0.3]]);
    builder.mesh("corner", corners, faces, &lamp("corner"), DAffine3::IDENTITY);
    for k in 0..30 {
        let x = 0.5 + 0.03 * f64::from(k);
        let (corners, faces) = triangle([[x, 0.4, 0.1], [x + 1e-4, 0.4, 0.1], [x + 0.3, 0.7, 1.9]]);
        builder.mesh("needle", corners, faces, &grey, DAffine3::IDENTITY);
    }
    builder.finish("hard cases").expect("a scene")
}

fn prepared(scene: &Scene) -> (Arc<[Facet]>, DirectLight) {
    let facets = Placement::of(scene).facets(scene);
    let lamps = lamps(scene, &facets, coplanar_tolerance(&facets));
    let light = DirectLight::of_points(&facets, lamps, Visibility::Exact, |i| scene.material(i));
    (facets, light)
}

fn tracer(
    device: &Device,
    precision: Precision,
    facets: &[Facet],
    light: &DirectLight,
) -> Result<LampRays, GpuError> {
    let emitters = light.lamps().iter().map(|lamp| lamp.triangles().len()).sum();
    let room = lamp_rays_room(precision, facets.len(), emitters, light.lamps().len());
    LampRays::new(device, precision, room, &light.ray_scene(facets))
}

/// Points of all triangles, each towards each lamp.
fn looks(facets: &[Facet], lamps: usize) -> Vec<(usize, Look)> {
    let points = [[0.6, 0.3, 0.1], [0.2, 0.2, 0.6], [0.05, 0.9, 0.05]].map(DVec3::from);
    let faces = facets.iter().enumerate().filter(|(_, facet)| facet.area > 0.0);
    let looks = faces.flat_map(|(face, facet)| {
        let of_point = move |b| {
            let look = move |lamp| Look { point: at(facet.corners, b), normal: facet.normal, lamp };
            (0..lamps).map(move |lamp| (face, look(lamp)))
        };
        points.into_iter().flat_map(of_point)
    });
    looks.collect()
}

/// The light of a lamp among that of all.
fn of_lamp(light: &[(u32, DVec3)], lamp: usize) -> DVec3 {
    light.iter().find(|(number, _)| *number as usize == lamp).map_or(DVec3::ZERO, |(_, phi)| *phi)
}

/// The same rays with the same weights, of which the same arrive, but for those that graze an edge; and Lambert's formula.
#[test]
fn the_kernel_traces_the_rays_of_the_host() {
    const RAYS: u32 = 96;
    let (single, double) = ((Precision::F32, 2e-4), (Precision::F64, 1e-9));
    for (scene, precisions) in
        [(room(), &[single, double][..]), (load("scenes/cornell_boxes.toml"), &[single])]
    {
        let (facets, light) = prepared(&scene);
        let sampling = Sampling::new(&facets, light.lamps(), &light.radiance(|i| scene.material(i)));
        let looks = looks(&facets, light.lamps().len());
        let only: Vec<Look> = looks.iter().map(|(_, look)| *look).collect();
        let unoccluded = DirectLight::without_shadows(&facets, light.lamps().to_vec());
        for &(precision, tolerance) in precisions {
            let device = device();
            let tracer = tracer(&device, precision, &facets, &light).expect("a tracer");
            let trace = || tracer.trace(&only, &vec![0..RAYS; only.len()]).expect("rays");
            let found = trace();
            let (mut grazing, mut lit, mut shadowed) = (0, 0, 0);
            for ((face, look), Traced { unoccluded: phi, sums }) in looks.iter().zip(&found) {
                let Look { point, normal, lamp } = *look;
                let truth = of_lamp(&unoccluded.at_points(&facets, *face, &[point])[0], lamp);
                let most = truth.length().max(1e-3);
                assert!(
                    phi.distance(truth) <= tolerance * most,
                    "{phi}, not {truth}, lamp {lamp} at {point}"
                );
                let triangles = light.lamps()[lamp].triangles();
                let own = |i: usize| i == *face || triangles.contains(&(i as u32));
                let truth = sampling.from_point(point, normal, lamp, RAYS, own);
                let near = 10.0 * tolerance * truth.all.max(1e-3);
                assert!((sums.all - truth.all).abs() <= near, "{sums:?}, not {truth:?} at {point}");
                grazing += i32::from((sums.arrive - truth.arrive).abs() > near);
                lit += i32::from(truth.all > 1e-9);
                shadowed += i32::from(truth.arrive < truth.all);
            }
            println!("{}: {lit} lit, {shadowed} shadowed, {grazing} with a ray that grazes", scene.name);
            assert!(lit > 100 && shadowed > 100 && grazing <= lit / 100, "{grazing} of {lit}");
            // The same bytes from run to run.
            let again = trace();
            let same = |(a, b): (&Traced, &Traced)| a.unoccluded == b.unoccluded && a.sums == b.sums;
            assert!(found.iter().zip(&again).all(same));
            finish(&device);
        }
    }
}

fn engines(scene: &Scene, backend: &Backend) -> [Engine; 2] {
    [Lamps::Exact, Lamps::Sampled].map(|lamps| {
        let scene = Scene { settings: scene.settings.lamps(lamps), ..scene.clone() };
        let plan = Plan::new(&scene, &PlanOptions::of(backend), &scene.settings).expect("a plan");
        Engine::new(backend, &scene, plan).expect("an engine")
    })
}

/// Irradiance of triangles is within what is tolerated of the exact one, and the error that is stated is the error.
#[test]
fn light_by_the_kernel_is_the_exact_light_within_its_tolerance() {
    for scene in [room(), load("scenes/cornell_boxes.toml")] {
        let backend = Backend::from(device().with_kernels_for(DeviceKind::Discrete));
        let [exact, traced] = engines(&scene, &backend);
        assert!(traced.direct.light.is_traced() && !exact.direct.light.is_traced());
        let irradiance = |engine: &Engine| -> Vec<[f64; 3]> {
            engine.direct.irradiance.iter().map(|h| h.to_array()).collect()
        };
        let error = relative_l2(&irradiance(&traced), &irradiance(&exact), &areas(&scene));
        let stated = traced.sampling_error();
        println!("{}: {:.3} %, stated {:.3} %", scene.name, 100.0 * error, 100.0 * stated);
        assert!(error <= 5e-3, "{}: {error:e}", scene.name);
        assert!(stated > 0.0 && stated <= 5e-3, "{}: {stated:e} stated", scene.name);
        finish(backend);
    }
}

/// So do pictures show what exact light shows, and the same from run to run.
#[test]
fn pictures_by_the_kernel_are_those_of_exact_light() {
    let mut scene = load("scenes/cornell_boxes.toml");
    for camera in &mut scene.cameras {
        (camera.width, camera.height) = (48, 48);
    }
    // Light that is reflected is the same in both.
    let bins = BinLayout::EqualAngle { theta: 4, phi: 6 };
    scene.settings = scene.settings.bins(bins).near_field(10.0).tolerance(1e-2);
    let backend = Backend::from(device().with_kernels_for(DeviceKind::Discrete));
    let renderer = Renderer::new(&backend, RenderOptions::default()).expect("a renderer");
    let [exact, traced] = engines(&scene, &backend).map(|mut engine| {
        let solution = engine.solve(&SolveParams::from(&scene.settings)).expect("a solution");
        let mut picture = || -> Vec<[f64; 3]> {
            let pictures = renderer.pictures(&mut engine, &solution, &scene, &scene.cameras);
            let pixels = pictures.expect("a picture").remove(0).pixels;
            pixels.iter().map(|&[r, g, b, _]| [r, g, b].map(f64::from)).collect()
        };
        let first = picture();
        assert_eq!(first, picture());
        first
    });
    let error = relative_l2(&traced, &exact, &vec![1.0; exact.len()]);
    println!("{:.3} %", 100.0 * error);
    assert!(error <= 5e-3, "{error:e}");
    finish(backend);
}

/// What the plan counts is taken, and given back.
#[test]
fn memory_is_counted() -> Result<(), GpuError> {
    let device = device().with_kernels_for(DeviceKind::Discrete);
    let scene = load("scenes/cornell_boxes.toml");
    let settings = scene.settings.lamps(Lamps::Sampled);
    let plan = Plan::new(&scene, &PlanOptions::of(&device), &settings).expect("a plan");
    let (facets, light) = prepared(&scene);
    let before = device.memory().in_use;
    let tracer = tracer(&device, Precision::F32, &facets, &light)?;
    tracer.trace(&[looks(&facets, 1)[0].1], slice::from_ref(&(0..1)))?;
    let (taken, planned) = (device.memory().in_use - before, plan.memory().of_label("lamp rays"));
    assert_eq!(taken, planned);
    drop(tracer);
    assert_eq!(device.memory().in_use, before);
    finish(&device);
    Ok(())
}
