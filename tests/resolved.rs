//! What a scene leaves open is decided once: whoever asks, it is the same model.

mod support;

use antirad::backend::{Backend, BackendChoice};
use antirad::fit::{EngineRenderer, Fit, Job, Renderer as _, RunOptions, Settings, StopRule, Target};
use antirad::plan::GradientRequest;
use antirad::render::{Quantity, Reflections, RenderOptions, Renderer};
use antirad::resolve::{ResolveOptions, resolve};
use antirad::scene::{Lamps, Material, Scene, SceneBuilder, Shape, VisibilityChoice};
use antirad::{Engine, SolveParams};
use glam::DVec3;
use std::ops::ControlFlow;
use std::sync::Arc;
use support::{as_given, placed};

/// Scenes of several kinds: with contacts, coarse, of several rooms, glossy, dense, under a sun.
fn scenes() -> Vec<Scene> {
    let names = ["cornell_boxes", "coarse_cornell", "two_rooms", "glossy_floor", "closed_box", "sunlit_room"];
    let named = names.map(|name| as_given(&format!("scenes/{name}.toml")));
    let mut scenes: Vec<Scene> = named.into_iter().chain([white_room(), rods()]).collect();
    for scene in &mut scenes {
        scene.settings = scene.settings.backend(BackendChoice::Cpu).ray_error(0.02);
        scene.cameras.truncate(1);
        let camera = &mut scene.cameras[0];
        (camera.width, camera.height) = (24, 18);
    }
    scenes
}

/// A white room with a lamp below its ceiling and a box on its floor.
fn white_room() -> Scene {
    let white = Material { albedo: [0.9; 3], ..Material::named("white") };
    let grey = Material { albedo: [0.5; 3], ..Material::named("box") };
    let lamp = Material { emission: [10.0; 3], albedo: [0.0; 3], ..Material::named("lamp") };
    let mut builder = SceneBuilder::new();
    builder
        .shape("room", Shape::Room { cells: 8 }, &white, placed([2.0; 3], [0.0; 3]))
        .shape("lamp", Shape::Quad { cells: 2 }, &lamp, placed([0.5, -1.0, 0.5], [0.75, 1.9, 0.75]))
        .shape("box", Shape::Box { cells: 3 }, &grey, placed([0.5; 3], [0.3, 0.0, 1.0]));
    seen(builder, "white room")
}

/// Rods that stand close together, of few triangles.
fn rods() -> Scene {
    let wood = Material { albedo: [0.5, 0.4, 0.3], ..Material::named("wood") };
    let lamp = Material { emission: [10.0; 3], albedo: [0.0; 3], ..Material::named("lamp") };
    let mut builder = SceneBuilder::new();
    builder.shape("room", Shape::Room { cells: 4 }, &wood, placed([2.0; 3], [0.0; 3])).shape(
        "lamp",
        Shape::Quad { cells: 2 },
        &lamp,
        placed([0.5, -1.0, 0.5], [0.75, 1.95, 0.75]),
    );
    for k in 0..25 {
        let at = [0.6 + 0.16 * f64::from(k % 5), 0.0, 0.6 + 0.16 * f64::from(k / 5)];
        builder.shape("rod", Shape::Box { cells: 1 }, &wood, placed([0.05, 1.2, 0.05], at));
    }
    seen(builder, "rods")
}

fn seen(builder: SceneBuilder, name: &str) -> Scene {
    let mut scene = builder.finish(name).expect("a scene");
    let camera = antirad::scene::Camera {
        name: String::from("main"),
        position: DVec3::new(1.9, 1.5, 0.2),
        target: DVec3::new(0.6, 0.5, 1.2),
        fov_x_degrees: 75.0,
        ..antirad::scene::Camera::framing(&scene.vertices)
    };
    scene.set_camera(camera).expect("a camera");
    scene
}

fn watch() -> antirad::Watch {
    Arc::new(|| ControlFlow::Continue(()))
}

fn apart(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let square = |of: &dyn Fn(usize) -> f64| (0..a.len()).map(|i| of(i).powi(2)).sum::<f64>();
    (square(&|i| a[i] - b[i]) / square(&|i| b[i])).sqrt()
}

/// In one call, step by step, and in the first pictures of a fit there is the same light.
#[test]
fn all_callers_have_the_same_light() {
    let backend = Backend::cpu();
    for given in scenes() {
        let rendered = antirad::render(&given).expect("light");
        let resolved = resolve(&given, &ResolveOptions::default()).expect("a scene");
        assert_eq!(resolved.decisions, rendered.decisions);
        let scene = &resolved.scene;
        // Nothing is left to decide.
        assert_ne!(scene.settings.lamps, Lamps::Auto);
        let mut engine = Engine::builder(&backend, scene).build().expect("an engine");
        let solution = engine.solve(&SolveParams::from(&scene.settings)).expect("light");
        let flat = |rows: &[[f64; 3]]| rows.concat();
        let off = apart(&flat(&resolved.on_given(&solution.irradiance)), &flat(&rendered.irradiance));
        assert!(off <= 1e-6, "{}: irradiance {off:e}", given.name);

        let options = RenderOptions::default().supersample(4).reflections(Reflections::FixedRays);
        let renderer = Renderer::new(&backend, options).expect("a renderer");
        let pictures = renderer.pictures(&mut engine, &solution, scene, &scene.cameras).expect("pictures");
        let expected: Vec<f64> =
            pictures[0].pixels.iter().flat_map(|p| p[..3].to_vec()).map(f64::from).collect();
        for request in [GradientRequest::NOTHING, GradientRequest::NOTHING.albedo(true).emission(true)] {
            let mut fit =
                EngineRenderer::new(&backend, given.clone(), 4, request, watch()).expect("a renderer");
            let found: Vec<f64> =
                fit.pictures(&given).expect("pictures")[0].iter().flat_map(|p| p.to_array()).collect();
            let off = apart(&found, &expected);
            assert!(off <= 1e-6, "{}: pictures {off:e}", given.name);
        }
    }
}

/// What is cut depends on geometry alone: not on how bright lamps are, nor on what surfaces reflect.
#[test]
fn materials_do_not_change_the_mesh() {
    for given in scenes() {
        let cut = |scene: &Scene| {
            let resolved = resolve(scene, &ResolveOptions::default()).expect("a scene");
            resolved.cut.parents().collect::<Vec<u32>>()
        };
        let mut other = given.clone();
        for (k, material) in (1..).zip(&mut other.materials) {
            material.emission = material.emission.map(|e| e * f64::from(k));
            if material.albedo != [0.0; 3] {
                material.albedo = [0.1 / f64::from(k); 3];
            }
        }
        assert!(cut(&given) == cut(&other), "{}", given.name);
    }
}

/// A fit that starts at the truth, of pictures that are rendered in one call, stays there.
#[test]
fn fits_stay_at_the_truth() {
    let mut scene = white_room();
    scene.settings.backend = BackendChoice::Cpu;
    let camera = &mut scene.cameras[0];
    (camera.width, camera.height) = (80, 60);
    let mut implicit = scene.clone();
    implicit.settings.visibility = VisibilityChoice::Implicit;
    let box_alone = Some(vec![String::from("box")]);
    // What little the lamp reflects hardly shows.
    let reflecting = Some(["room", "box"].map(String::from).to_vec());
    for (scene, fit) in [
        (&scene, Fit::new(Quantity::Albedo).meshes(reflecting)),
        (&scene, Fit::new(Quantity::Emission).meshes(Some(vec![String::from("lamp")]))),
        (&implicit, Fit::new(Quantity::Position).meshes(box_alone)),
    ] {
        let rendered = antirad::render(scene).expect("light");
        let rgb = |p: &[f32; 4]| DVec3::new(p[0].into(), p[1].into(), p[2].into());
        let pixels = rendered.pictures[0].pixels.iter().map(rgb).collect();
        let target = Target::new(scene.cameras[0].clone(), pixels, None, 1.0).expect("a target");
        let settings = Settings::new(vec![fit]);
        let mut job = Job::new("truth", scene.clone(), vec![target], settings).expect("a job");
        let parameters = &job.problem().parameters;
        let (planning, request) = (parameters.planning_scene(), parameters.gradient_request());
        let backend = Backend::cpu();
        let renderer = EngineRenderer::new(&backend, planning, job.settings().supersample, request, watch());
        let mut renderer = renderer.expect("a renderer").movable(parameters.movable());
        let options = RunOptions::default().stop(StopRule::default().iterations(4));
        let found =
            job.run(&mut renderer, &options, &mut |_, _| ControlFlow::Continue(())).expect("an outcome");
        // Of the brightest radiance, 10 W/(m² sr), and of an albedo of 1.
        for (a, b) in found.scene.materials.iter().zip(&scene.materials) {
            assert!(
                (DVec3::from(a.albedo) - DVec3::from(b.albedo)).abs().max_element() <= 1e-3,
                "{a:?}, not {b:?}"
            );
            let off = (DVec3::from(a.emission) - DVec3::from(b.emission)).abs().max_element();
            assert!(off <= 1e-2, "{a:?}, not {b:?}");
        }
        for (a, b) in found.scene.vertices.iter().zip(&scene.vertices) {
            assert!(a.distance(*b) <= 1e-4, "{a}, not {b}");
        }
    }
}

/// Implicit visibility is taken for positions, of which rays have no derivatives; the mesh is the same but for parts that may come to light.
#[test]
fn positions_take_implicit_visibility() {
    let given = white_room();
    let moves = ResolveOptions::default().moves(antirad::resolve::Moves::Vertices);
    let resolved = resolve(&given, &moves).expect("a scene");
    assert_eq!(resolved.scene.settings.visibility, VisibilityChoice::Implicit);
    let visibility = resolved.decisions.iter().find(|of| of.setting == "visibility").expect("a decision");
    assert!(visibility.why.contains("positions are differentiated"), "{visibility}");
    assert!(resolved.scene.triangles.len() > given.triangles.len());
}
