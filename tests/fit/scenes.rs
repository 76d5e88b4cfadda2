//! Fits on a backend: each recovers the scene that its pictures were rendered from.

use crate::support::{backend, finish, load};
use antirad::Watch;
use antirad::backend::Backend;
use antirad::fit::{
    EngineRenderer, Fit, Job, LossKind, MotionKind, OptimiserKind, Outcome, Per, Recovered, Regulariser,
    Renderer, RunOptions, Settings, StopRule, Target,
};
use antirad::gpu::Device;
use antirad::image::Rasterizer;
use antirad::plan::GradientRequest;
use antirad::render::Quantity;
use antirad::render::Shading;
use antirad::scene::{BinLayout, Camera, Lamps, Material, Scene, SceneBuilder, Shape};
use glam::{DAffine3, DVec3};
use std::ops::ControlFlow;
use std::sync::Arc;

pub fn watch() -> Watch {
    Arc::new(|| ControlFlow::Continue(()))
}

pub fn cameras(scene: &Scene, names: &[&str]) -> Vec<Camera> {
    names.iter().map(|name| scene.camera(name).expect("a camera").clone()).collect()
}

/// A job with pictures of the scene itself as targets, and its renderer.
fn job(backend: &Backend, scene: &Scene, cameras: Vec<Camera>, settings: Settings) -> (Job, EngineRenderer) {
    let side = settings.supersample;
    let nothing = Default::default();
    let seen = Scene { cameras: cameras.clone(), ..scene.clone() };
    let mut renderer =
        EngineRenderer::new(backend, seen.clone(), side, nothing, watch()).expect("a renderer");
    let pictures = renderer.pictures(&seen).expect("pictures");
    let target = |(camera, pixels)| Target::new(camera, pixels, None, 1.0).expect("a target");
    let targets = cameras.into_iter().zip(pictures).map(target).collect();
    let job = Job::new("test", scene.clone(), targets, settings).expect("a job");
    let parameters = &job.problem().parameters;
    let (planning, request) = (parameters.planning_scene(), parameters.gradient_request());
    let renderer = EngineRenderer::new(backend, planning, side, request, watch());
    let movable = parameters.movable();
    (job, renderer.expect("a renderer").movable(movable))
}

fn run(scene: &Scene, cameras: Vec<Camera>, settings: Settings, stop: StopRule) -> Outcome {
    let backend = backend();
    let (mut job, mut renderer) = job(&backend, scene, cameras, settings);
    let options = RunOptions::default().stop(stop);
    let outcome = job.run(&mut renderer, &options, &mut |_, _| ControlFlow::Continue(()));
    drop(renderer);
    finish(&backend);
    outcome.expect("an outcome")
}

fn exact() -> StopRule {
    StopRule::default().iterations(60).relative_decrease(0.0).gradient(0.0).loss(0.0).seconds(f64::INFINITY)
}

/// Coarser than the shipped scene, with smaller pictures, since these tests are about recovery, not image quality.
pub fn coarse(name: &str) -> Scene {
    let mut scene = load(name);
    scene.settings.bins = BinLayout::Concentric { n: 4 };
    scene.settings.near_field = 10.0;
    scene.settings.tolerance = 1e-5;
    for camera in &mut scene.cameras {
        (camera.width, camera.height) = (48, 36);
    }
    scene
}

/// `bound` is relative.
#[track_caller]
pub fn near(outcome: &Outcome, quantity: &str, of: &str, truth: &[f64], bound: f64) {
    let of_it = |r: &&Recovered| r.quantity == quantity && r.of == of;
    let found = &outcome.recovered.iter().find(of_it).expect("it was fitted").value;
    let errors: Vec<f64> = found.iter().zip(truth).map(|(f, t)| (f / t - 1.0).abs()).collect();
    println!("{quantity} of {of}: {found:?}, errors {errors:?}");
    assert_eq!(found.len(), truth.len());
    assert!(errors.iter().all(|error| *error <= bound), "{quantity} of {of}: {found:?}, not {truth:?}");
}

pub fn of(quantity: Quantity, materials: &[&str], initial: f64) -> Fit {
    let materials = Some(materials.iter().map(|m| (*m).to_owned()).collect());
    Fit::new(quantity).materials(materials).initial(Some([initial; 3]))
}

#[test]
fn albedo_and_lamp_from_grey() {
    let scene = coarse("scenes/fits/room.toml");
    let fits = vec![of(Quantity::Albedo, &["grey"], 0.4), of(Quantity::Emission, &["lamp"], 5.0)];
    let settings = Settings::new(fits).loss(LossKind::RelativeL2).epsilon(Some(1.0));
    let outcome = run(&scene, cameras(&scene, &["one"]), settings, exact().loss(1e-11));
    near(&outcome, "emission", "lamp", &[15.0, 12.0, 8.0], 1e-4);
    near(&outcome, "albedo", "grey", &[0.6, 0.55, 0.5], 1e-4);
}

#[test]
fn glossy_materials_from_two_views() {
    let scene = coarse("scenes/fits/glossy.toml");
    let fits = vec![of(Quantity::Specular, &["gloss"], 0.1), of(Quantity::Power, &["gloss"], 20.0)];
    let settings = Settings::new(fits).loss(LossKind::RelativeL2);
    let outcome = run(&scene, cameras(&scene, &["one", "other"]), settings, exact().loss(1e-10));
    near(&outcome, "specular", "gloss", &[0.2, 0.19, 0.17], 1e-3);
    near(&outcome, "power", "gloss", &[30.0], 1e-3);
}

const WAY: [f64; 3] = [0.05, -0.04, 0.048];

/// The box starts a tenth of its size off.
fn displaced(supersample: u32) -> Settings {
    let fit = Fit::new(Quantity::Position)
        .meshes(Some(vec![String::from("box")]))
        .motion(MotionKind::Translation)
        .initial(Some(WAY));
    Settings::new(vec![fit]).supersample(supersample)
}

#[track_caller]
fn moved_back(outcome: &Outcome, share: f64) {
    let length = |way: &[f64]| way.iter().map(|w| w * w).sum::<f64>().sqrt();
    let left = length(&outcome.recovered[0].value);
    println!("{left:e} m of {:e} m left after {:?}", length(&WAY), outcome.history.last());
    assert!(left <= share * length(&WAY), "{:?}", outcome.recovered[0].value);
}

#[test]
fn a_box_is_found_from_two_views() {
    let scene = coarse("scenes/fits/box.toml");
    let outcome = run(&scene, cameras(&scene, &["one", "other"]), displaced(16), exact().loss(1e-10));
    moved_back(&outcome, 0.01);
}

#[test]
fn a_box_is_found_from_its_shadow_alone() {
    let scene = coarse("scenes/fits/box.toml");
    let views = cameras(&scene, &["shadow"]);
    // The view does not show the box at its true or initial position: making it emit would not change that.
    let backend = backend();
    let rasterizer = Rasterizer::new(&backend).expect("a rasterizer");
    let mut elsewhere = scene.clone();
    let boxed: Vec<usize> = (0..scene.triangles.len()).filter(|t| scene.material(*t).name == "box").collect();
    assert_eq!(boxed.len(), 48);
    let mut vertices: Vec<u32> = boxed.iter().flat_map(|t| scene.triangles[*t].vertices).collect();
    vertices.sort_unstable();
    vertices.dedup();
    for v in vertices {
        elsewhere.vertices[v as usize] += glam::DVec3::from(WAY);
    }
    for place in [&scene, &elsewhere] {
        let coverage = rasterizer.coverage(place, &views[0], 16).expect("a coverage");
        let mut colours = vec![[0.0; 3]; scene.triangles.len()];
        boxed.iter().for_each(|t| colours[*t] = [1.0; 3]);
        let pixels = coverage.pixels(&colours).expect("pixels");
        assert!(pixels.iter().all(|p| p[..3] == [0.0; 3]));
    }
    drop(rasterizer);
    let outcome = run(&scene, views, displaced(16), exact().loss(1e-11));
    moved_back(&outcome, 0.05);
}

/// The fraction of the emitted power that comes from the lamp.
fn share_of_lamp(scene: &Scene) -> f64 {
    let power = |t: usize| {
        let [a, b, c] = scene.corners(t);
        (b - a).cross(c - a).length() * scene.material(t).emission.iter().sum::<f64>()
    };
    let lamp = scene.meshes.iter().find(|mesh| mesh.name == "lamp").expect("a lamp").range.clone();
    lamp.map(|t| power(t as usize)).sum::<f64>() / (0..scene.triangles.len()).map(power).sum::<f64>()
}

fn emission_of_triangles() -> Settings {
    let fit = Fit::new(Quantity::Emission).per(antirad::fit::Per::Triangle).initial(Some([0.0; 3]));
    Settings::new(vec![fit])
}

/// Where every triangle may emit, light takes the way of antiradiance; so do the pictures to fit.
fn emitters() -> Scene {
    let mut scene = coarse("scenes/fits/room.toml");
    scene.settings.lamps = Lamps::Antiradiance;
    scene
}

#[test]
fn a_lamp_in_view_is_found_among_all_triangles() {
    let scene = emitters();
    let views = cameras(&scene, &["one", "other"]);
    let outcome = run(&scene, views, emission_of_triangles(), exact().iterations(15));
    let share = share_of_lamp(&outcome.scene);
    assert!(share > 0.98, "{share}");
}

/// A lamp that no view shows can be replaced by emission of the surfaces that it illuminates: with the sparsity
/// regulariser, the picture is explained with less power than the lamp's, emitted by visible walls; but for how reflected light varies
/// within faces, which emission cannot.
#[test]
fn a_hidden_lamp_is_not_found_but_replaced() {
    let scene = emitters();
    let sparse = Regulariser::Sparsity { weight: 1e-3 };
    let settings = emission_of_triangles().regularisers(vec![sparse]);
    let outcome = run(&scene, cameras(&scene, &["low"]), settings, exact().iterations(25));
    assert!(
        outcome.views[0] <= 1e-2 * outcome.history[0].loss,
        "{:?} of {:?}",
        outcome.views,
        outcome.history[0]
    );
    let share = share_of_lamp(&outcome.scene);
    assert!(share < 0.5, "{share}");
    assert_eq!(outcome.assumptions.len(), 1);
    assert!(outcome.assumptions[0] > 0.0);
}

#[cfg(target_os = "linux")]
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/statm").expect("statm");
    status.split_whitespace().nth(1).and_then(|pages| pages.parse::<u64>().ok()).expect("pages") * 4096
}

/// In a process of its own, whose memory other tests do not change.
#[test]
#[cfg(target_os = "linux")]
fn memory_does_not_grow() {
    let run = std::process::Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", "scenes::memory_does_not_grow_over_100_iterations", "--ignored", "--nocapture"])
        .output()
        .expect("a run");
    let text = String::from_utf8_lossy(&run.stdout);
    assert!(
        run.status.success() && text.contains("1 passed"),
        "{text}{}",
        String::from_utf8_lossy(&run.stderr)
    );
}

/// On either backend, with checkpoints: neither the host's memory nor the driver's (host memory with lavapipe) grows. Where
/// positions are fitted, the whole engine is rebuilt in every iteration.
#[test]
#[ignore = "run by memory_does_not_grow"]
#[cfg(target_os = "linux")]
fn memory_does_not_grow_over_100_iterations() {
    // The layers of validation keep records of their own.
    let device = Device::new(&Default::default()).expect("a Vulkan device");
    let mut scene = crate::scene();
    scene.settings.bins = BinLayout::Concentric { n: 2 };
    scene.settings.near_field = 1.0;
    let albedo = of(Quantity::Albedo, &["wall"], 0.5);
    let position = displaced(1).fits.remove(0);
    let cases = [(vec![albedo.clone()], 100), (vec![albedo, position], 12)];
    let backends = [Backend::cpu(), device.into()];
    for (backend, (fits, iterations)) in
        backends.iter().flat_map(|of| cases.iter().map(move |case| (of, case)))
    {
        let optimiser = OptimiserKind::Adam;
        let settings = Settings::new(fits.clone()).supersample(2).tolerance(Some(1e-2)).optimiser(optimiser);
        let (mut job, mut renderer) = job(backend, &scene, cameras(&scene, &["main"]), settings);
        let folder = tempfile::tempdir().expect("a folder");
        // One-time allocations are done after a few iterations.
        let warm = 10;
        let options = RunOptions::default()
            .checkpoints(Some(folder.path().to_owned()))
            .stop(exact().iterations(warm + iterations));
        let mut held = Vec::new();
        let outcome = job.run(&mut renderer, &options, &mut |_, _| {
            held.push(resident());
            ControlFlow::Continue(())
        });
        assert_eq!(outcome.expect("an outcome").history.len() as u32, warm + iterations + 1);
        // The least of a few: what an iteration has just freed may still be held.
        let least = |iterations: &[u64]| iterations.iter().copied().min().unwrap_or(0);
        let (before, after) = (least(&held[warm as usize - 3..][..4]), least(&held[held.len() - 4..]));
        let grown = after.saturating_sub(before);
        println!("{backend:?}, {iterations} iterations: {grown} bytes more, {before} before");
        // Threads of the host keep some freed memory to themselves.
        assert!(grown < 6 << 20, "{backend:?}, {iterations} iterations: {grown} bytes more, {before} before");
    }
}

/// Position, target and up of a camera, silhouettes included, against central differences of finely sampled pictures.
#[test]
fn pictures_are_differentiated_by_their_cameras() {
    let backend = backend();
    let scene = coarse("scenes/fits/box.toml");
    // Rolled, so that edges cross rows of samples one by one; aside, so that the box moves in the picture as the camera rolls.
    let camera = cameras(&scene, &["one"]).remove(0);
    let camera = Camera { up: DVec3::new(0.3, 1.0, 0.1), target: camera.target + ASIDE, ..camera };
    let request = GradientRequest::NOTHING.camera(true);
    let seen_from = |camera: Camera| Scene { cameras: vec![camera], ..scene.clone() };
    let mut renderer =
        EngineRenderer::new(&backend, seen_from(camera.clone()), 16, request, watch()).expect("a renderer");
    // Weights that vary slowly over the picture, and change as it turns.
    let weight = |pixel: usize| {
        let (x, y) = ((pixel % 48) as f64 / 48.0, (pixel / 48) as f64 / 36.0);
        DVec3::new(1.0, 0.8, 0.6) * (1.0 + x + 2.0 * (x - 0.5) * (y - 0.5))
    };
    let weights: Vec<DVec3> = (0..48 * 36).map(weight).collect();
    let loss = |renderer: &mut EngineRenderer, camera: Camera| -> f64 {
        let pictures = renderer.pictures(&seen_from(camera)).expect("pictures");
        pictures[0].iter().zip(&weights).map(|(pixel, weight)| pixel.dot(*weight)).sum()
    };
    const ASIDE: DVec3 = DVec3::new(-0.8, -0.5, 0.0);
    const STEP: f64 = 0.02;
    let mut difference = |moved: &dyn Fn(DVec3) -> Camera| {
        DVec3::from(DVec3::AXES.map(|axis| {
            let [above, below] = [STEP, -STEP].map(|way| loss(&mut renderer, moved(way * axis)));
            (above - below) / (2.0 * STEP)
        }))
    };
    let differences = [
        difference(&|way| Camera { position: camera.position + way, ..camera.clone() }),
        difference(&|way| Camera { target: camera.target + way, ..camera.clone() }),
        difference(&|way| Camera { up: camera.up + way, ..camera.clone() }),
    ];
    loss(&mut renderer, camera);
    let gradient = renderer
        .pull_back(std::slice::from_ref(&weights), request)
        .expect("derivatives")
        .expect("pictures before");
    let [found] = gradient.cameras.expect("by cameras")[..] else { panic!("one camera") };
    for (found, expected) in [found.position, found.target, found.up].into_iter().zip(differences) {
        let error = (found - expected).length() / expected.length();
        println!("{found} and {expected}: {error:.4}");
        assert!(error <= 0.015, "{found}, but differences give {expected}");
    }
    drop(renderer);
    finish(&backend);
}

/// Derivatives by what may move are those among all, and others are zero.
#[test]
fn derivatives_by_what_moves_are_those_of_all() {
    let backend = backend();
    let mut scene = coarse("scenes/fits/box.toml");
    scene.cameras = cameras(&scene, &["one", "shadow"]);
    let moving = scene.meshes.iter().find(|mesh| mesh.name == "box").expect("a box").range.clone();
    let triangles = &scene.triangles[moving.start as usize..moving.end as usize];
    let movable: Vec<u32> = triangles.iter().flat_map(|triangle| triangle.vertices).collect();
    let request = GradientRequest::NOTHING.positions(true);
    let weights: Vec<Vec<DVec3>> = scene
        .cameras
        .iter()
        .map(|camera| {
            let pixels = 0..camera.width * camera.height;
            pixels.map(|pixel| DVec3::new(1.0, 0.8, 0.6) * f64::from(pixel % 17)).collect()
        })
        .collect();
    let gradient = |movable: Option<&Vec<u32>>| {
        let renderer = EngineRenderer::new(&backend, scene.clone(), 4, request, watch());
        let mut renderer = renderer.expect("a renderer");
        if let Some(movable) = movable {
            renderer = renderer.movable(movable.clone());
        }
        renderer.pictures(&scene).expect("pictures");
        let gradient = renderer.pull_back(&weights, request).expect("derivatives").expect("pictures before");
        gradient.positions.expect("by positions")
    };
    let (all, some) = (gradient(None), gradient(Some(&movable)));
    let [mut others, mut largest] = [0.0_f64; 2];
    for (vertex, (all, some)) in (0..).zip(all.into_iter().zip(some)) {
        if movable.contains(&vertex) {
            largest = largest.max(some.length());
            assert_eq!(some, all, "vertex {vertex}");
        } else {
            others = others.max(all.length());
            assert_eq!(some, DVec3::ZERO, "vertex {vertex}");
        }
    }
    assert!(largest > 0.0 && others > 0.0);
    finish(&backend);
}

/// Solves start from the light of the pictures before; what they find is the same within the tolerance, and nothing is left of them
/// once they are forgotten.
#[test]
fn pictures_depend_on_earlier_ones_by_no_more_than_the_tolerance() {
    let mut scene = coarse("scenes/fits/room.toml");
    scene.cameras = cameras(&scene, &["one"]);
    let mut other = scene.clone();
    for material in &mut other.materials {
        material.albedo = material.albedo.map(|rho| 0.9 * rho);
        material.emission = material.emission.map(|e| 1.2 * e);
    }
    let backend = backend();
    let request = GradientRequest::NOTHING.albedo(true);
    let renderer = EngineRenderer::new(&backend, scene.clone(), 4, request, watch());
    let mut renderer = renderer.expect("a renderer");
    let cold = renderer.pictures(&scene).expect("pictures");
    let passes_cold = renderer.passes();
    renderer.pictures(&other).expect("pictures");
    let passes_before = renderer.passes();
    let warm = renderer.pictures(&scene).expect("pictures");
    assert!(renderer.passes() - passes_before < passes_cold);
    let norm = |pixels: &[DVec3]| pixels.iter().map(|p| p.length_squared()).sum::<f64>().sqrt();
    let apart = |a: &[Vec<DVec3>], b: &[Vec<DVec3>]| {
        let difference: Vec<DVec3> = a[0].iter().zip(&b[0]).map(|(a, b)| *a - *b).collect();
        norm(&difference) / norm(&b[0])
    };
    assert!(apart(&warm, &cold) < 10.0 * scene.settings.tolerance, "{}", apart(&warm, &cold));
    // Those of a scene nearby: only the difference has to be accurate, and the latest stay.
    let mut near = scene.clone();
    near.materials.iter_mut().for_each(|m| m.albedo[0] *= 0.99);
    let change = |near: &[Vec<DVec3>], from: &[Vec<DVec3>]| -> Vec<Vec<DVec3>> {
        near.iter().zip(from).map(|(a, b)| a.iter().zip(b).map(|(a, b)| *a - *b).collect()).collect()
    };
    let rough = change(&renderer.pictures_near(&near).expect("pictures"), &warm);
    let passes = renderer.passes();
    assert_eq!(renderer.pictures(&scene).expect("pictures"), warm);
    assert_eq!(renderer.passes(), passes, "the same scene needs no solve");
    renderer.forget();
    assert_eq!(renderer.pictures(&scene).expect("pictures"), cold);
    let exact = change(&renderer.pictures(&near).expect("pictures"), &cold);
    assert!(apart(&rough, &exact) < 0.1, "{}", apart(&rough, &exact));
    drop(renderer);
    finish(&backend);
}

/// A floor that reflects nothing onto itself: what each triangle shows is all of the Hessian.
#[test]
fn own_curvature_is_the_diagonal_of_the_hessian_without_interreflection() {
    let floor = Material { albedo: [0.6, 0.4, 0.2], ..Material::named("floor") };
    let lamp = Material { albedo: [0.0; 3], emission: [9.0, 8.0, 7.0], ..Material::named("lamp") };
    let over = DAffine3::from_translation(DVec3::new(0.2, 1.0, 0.2))
        * DAffine3::from_scale(DVec3::new(0.5, -1.0, 0.5));
    let mut scene = SceneBuilder::new()
        .shape("floor", Shape::Quad { cells: 2 }, &floor, DAffine3::IDENTITY)
        .shape("lamp", Shape::Quad { cells: 1 }, &lamp, over)
        .finish("floor")
        .expect("a scene");
    scene.cameras = vec![Camera {
        position: DVec3::new(0.5, 0.7, 2.0),
        target: DVec3::new(0.5, 0.0, 0.5),
        width: 40,
        height: 30,
        ..Camera::framing(&[])
    }];
    let albedo =
        || Fit::new(Quantity::Albedo).materials(Some(vec!["floor".to_owned()])).initial(Some([0.3; 3]));
    for (fit, loss) in [(albedo().per(Per::Triangle), LossKind::RelativeL2), (albedo(), LossKind::L2)] {
        let backend = backend();
        let settings = Settings::new(vec![fit]).loss(loss);
        let (job, renderer) = job(&backend, &scene, scene.cameras.clone(), settings);
        let mut renderer = renderer.shading(Shading::Face);
        let problem = job.problem();
        let x = problem.parameters.start();
        let hessian = problem.gauss_newton(x, &mut renderer).expect("pictures").expect("a Hessian");
        let own = problem.own_curvature(x, true, &mut renderer).expect("pictures").expect("a diagonal");
        assert!(own.iter().all(|h| *h > 0.0), "{own:?}");
        for (i, own) in own.iter().enumerate() {
            let whole = hessian[i * x.len() + i];
            // Triangles of one unknown in one pixel count separately.
            let bound = if x.len() > 3 { 1e-3 } else { 0.2 };
            assert!((own / whole - 1.0).abs() < bound, "unknown {i}: {own}, not {whole}");
        }
        drop(renderer);
        finish(&backend);
    }
}
