//! Cameras whose poses are fitted.

use crate::scenes::{coarse, of, watch};
use crate::support::{backend, finish};
use antirad::backend::Backend;
use antirad::fit::{EngineRenderer, Fit, Job, Renderer, RunOptions, Settings, StopRule, Target};
use antirad::plan::GradientRequest;
use antirad::render::Quantity;
use antirad::scene::{Camera, Scene};
use antirad_render::image::View;
use glam::{DQuat, DVec3};
use std::ops::ControlFlow;

/// A floor with a box, and three cameras.
fn scene() -> Scene {
    let mut scene = coarse("scenes/fits/box.toml");
    for camera in &mut scene.cameras {
        (camera.width, camera.height) = (96, 72);
    }
    scene
}

/// A camera that is not quite where it was.
fn disturbed(camera: &Camera, way: DVec3, degrees: DVec3) -> Camera {
    let turn = DQuat::from_scaled_axis(degrees.map(f64::to_radians));
    let position = camera.position + way;
    let target = position + turn * (camera.target - camera.position);
    Camera { position, target, up: turn * camera.up, ..camera.clone() }
}

/// How far a camera is from another, metres and degrees.
fn apart(a: &Camera, b: &Camera) -> (f64, f64) {
    let axes = |camera: &Camera| {
        let View { right, up, forward, .. } = View::new(camera);
        [right, up, forward]
    };
    let pairs = axes(a).into_iter().zip(axes(b));
    let squares: f64 = pairs.map(|(a, b)| (a - b).length_squared()).sum();
    ((a.position - b.position).length(), (squares / 2.0).sqrt().to_degrees())
}

/// Pictures of a scene from its cameras, as targets taken from others.
fn targets(backend: &Backend, scene: &Scene, given: &[Camera], supersample: u32) -> Vec<Target> {
    let nothing = GradientRequest::NOTHING;
    let renderer = EngineRenderer::new(backend, scene.clone(), supersample, nothing, watch());
    let pictures = renderer.expect("a renderer").pictures(scene).expect("pictures");
    let target = |(camera, pixels): (&Camera, _)| Target::new(camera.clone(), pixels, None, 1.0);
    given.iter().zip(pictures).map(|view| target(view).expect("a target")).collect()
}

fn renderer(backend: &Backend, job: &Job) -> EngineRenderer {
    let parameters = &job.problem().parameters;
    let (planning, request) = (parameters.planning_scene(), parameters.gradient_request());
    let renderer = EngineRenderer::new(backend, planning, job.settings().supersample, request, watch());
    renderer.expect("a renderer").movable(parameters.movable())
}

const WAY: DVec3 = DVec3::new(0.006, -0.005, 0.006);
const TURN: DVec3 = DVec3::new(0.25, -0.35, 0.25);

/// A job with two cameras to be found, with the albedo of the box, and a third one that stays.
fn job(backend: &Backend, scene: &Scene, supersample: u32) -> Job {
    let given = [
        disturbed(&scene.cameras[0], WAY, TURN),
        disturbed(&scene.cameras[1], -WAY, TURN),
        scene.cameras[2].clone(),
    ];
    let poses = Fit::new(Quantity::Camera).cameras(Some(vec!["one".to_owned(), "other".to_owned()]));
    let settings = Settings::new(vec![of(Quantity::Albedo, &["box"], 0.4), poses]).supersample(supersample);
    Job::new("test", scene.clone(), targets(backend, scene, &given, 8), settings).expect("a job")
}

#[test]
fn cameras_are_found_beside_materials() {
    let (backend, scene) = (backend(), scene());
    let mut job = job(&backend, &scene, 16);
    let mut renderer = renderer(&backend, &job);
    let options = RunOptions::default().stop(StopRule::default().iterations(30));
    let outcome = job.run(&mut renderer, &options, &mut |record, _| {
        println!("{record:?}");
        ControlFlow::Continue(())
    });
    let outcome = outcome.expect("an outcome");
    let found = |name: &str| outcome.scene.camera(name).expect("a camera");
    for camera in &scene.cameras[..2] {
        let (way, angle) = apart(found(&camera.name), camera);
        println!("{}: {:.2} mm, {angle:.4} degrees", camera.name, 1e3 * way);
        assert!(way <= 1e-3 && angle <= 0.05, "{}: {way} m, {angle} degrees", camera.name);
    }
    let names: Vec<&str> = outcome.scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["one", "other", "shadow"]);
    assert_eq!(found("shadow"), &scene.cameras[2]);
    crate::scenes::near(&outcome, "albedo", "box", &[0.6, 0.3, 0.2], 1e-2);
    drop(renderer);
    finish(&backend);
}
