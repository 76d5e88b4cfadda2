//! Target errors, on scenes of known solution; and the settings chosen by default.

mod support;

use antirad::backend::Backend;
use antirad::image::Rasterizer;
use antirad::path_tracer::PathTracer;
use antirad::render::Shading;
use antirad::scene::{Camera, Lamps, Material, Scene, SceneBuilder, Shape};
use antirad::target_error::{
    ErrorEstimate, Refinement, SearchError, Solved, Stage, TargetErrorOptions, solve_within,
};
use antirad::{Engine, EngineError, Solution, SolveParams};
use antirad_base::usage::{Bytes, OverBudget};
use antirad_core::solve::SolveError;
use antirad_core::transport::TransportError;
use glam::{DAffine3, DVec3};
use std::f64::consts::PI;
use support::kit::Shadow;
use support::{areas, as_given, backend, finish, implicit, read_npy, relative_l2, solve};

fn run(engine: &mut Engine, scene: &Scene, _: &Stage) -> Result<Solution, EngineError> {
    engine.solve(&SolveParams::from(&scene.settings))
}

fn within(backend: &Backend, scene: &Scene, options: &TargetErrorOptions) -> Solved {
    let solved = solve_within(backend, scene, options, &|_| 0, &mut run).expect("a solution");
    for step in &solved.refinement.steps {
        println!("  {step}");
    }
    solved
}

fn estimate(solved: &Solved) -> &ErrorEstimate {
    solved.refinement.answer().and_then(|step| step.estimate.as_ref()).expect("an estimate")
}

fn cornell() -> Scene {
    as_given("scenes/cornell_boxes.toml")
}

/// A closed room of emitting walls: the radiosity is 1 / (1 - ρ) everywhere.
fn furnace(albedo: f64) -> Scene {
    let material = Material { albedo: [albedo; 3], emission: [1.0 / PI; 3], ..Material::named("glowing") };
    let mut builder = SceneBuilder::new();
    builder.shape("room", Shape::Room { cells: 8 }, &material, DAffine3::IDENTITY);
    builder.finish("furnace").expect("a scene")
}

/// The error is within its target, and the estimate is neither far below nor far above it.
#[test]
fn a_room_with_boxes() {
    let backend = backend();
    let scene = cornell();
    let truth = read_npy("tests/data/cornell_boxes.irradiance.npy");
    let mut before = f64::INFINITY;
    for error in [0.05, 0.02] {
        let solved = within(&backend, &scene, &TargetErrorOptions::new(error));
        let found = solved.on_given(&solved.answer.irradiance);
        let real = relative_l2(&found, &truth, &areas(&scene));
        let estimate = estimate(&solved);
        println!("target {error}: {real:.4}, estimated {:.4}", estimate.total);
        assert!(solved.refinement.met && real <= error, "{real}");
        assert!(real <= 1.5 * estimate.total && estimate.total <= 3.0 * real, "{real} {estimate}");
        assert!(estimate.irradiance.balance.is_none(), "the room is open");
        assert!(real <= before);
        before = real;
    }
    finish(&backend);
}

/// Errors of shadows relative to the blocked irradiance, for a target of 2 %: at most half of those of 10 x 13 bins with pieces
/// in a near field of 30 (.052, .081, .067 for a lamp of .4 m; .12, .26, .138 for .1 m).
#[test]
fn shadows() {
    let backend = backend();
    // The finest levels take minutes: `cargo test --test target_error -- --ignored`.
    for (lamp, height, bound) in [(0.4, 0.25, 0.026), (0.4, 1.0, 0.0405), (0.4, 1.5, 0.0335)] {
        shadow(&backend, lamp, height, bound);
    }
    finish(&backend);
}

#[test]
#[ignore = "two minutes"]
fn shadows_of_small_lamps() {
    let backend = backend();
    for (lamp, height, bound) in [(0.1, 0.25, 0.06), (0.1, 1.0, 0.13), (0.1, 1.5, 0.069)] {
        shadow(&backend, lamp, height, bound);
    }
    finish(&backend);
}

fn shadow(backend: &Backend, lamp: f64, height: f64, bound: f64) {
    let shadow = Shadow { lamp, height };
    let scene = shadow.scene().expect("a scene");
    let exact = shadow.irradiance(&scene);
    let solved = within(backend, &scene, &TargetErrorOptions::new(0.02));
    let found = solved.on_given(&solved.answer.irradiance);
    let floor = scene.meshes[0].range.start as usize..scene.meshes[0].range.end as usize;
    let norm = |of: &dyn Fn(usize) -> f64| floor.clone().map(|i| of(i).powi(2)).sum::<f64>().sqrt();
    let error = norm(&|i| found[i][0] - exact[i][0]) / norm(&|i| exact[i][1] - exact[i][0]);
    println!("lamp {lamp}, height {height}: {error:.4} of what is blocked");
    assert!(error <= bound, "lamp {lamp}, height {height}: {error}");
}

/// Errors that no comparison shows appear in the energy balance of a closed room.
#[test]
fn closed_rooms_of_high_albedo() {
    let backend = backend();
    for albedo in [0.8, 0.99] {
        let scene = furnace(albedo);
        let solved = within(&backend, &scene, &TargetErrorOptions::new(0.01));
        let found = solved.on_given(&solved.answer.radiosity);
        let truth = vec![[1.0 / (1.0 - albedo); 3]; found.len()];
        let error = relative_l2(&found, &truth, &areas(&scene));
        println!("albedo {albedo}: {:.3} %", 100.0 * error);
        assert!(solved.refinement.met && error <= 0.01, "{error}");
        assert!(estimate(&solved).irradiance.balance.is_some(), "the room is closed");

        // With the settings chosen by default, too.
        let (_engine, solution) = solve(&backend, &scene, &scene.settings);
        let error = relative_l2(&solution.radiosity, &truth, &areas(&scene));
        println!("albedo {albedo}, by default: {:.3} %", 100.0 * error);
        assert!(error <= 0.01, "{error}");
    }
    finish(&backend);
}

/// What no level has an error of is refused.
#[test]
fn implicit_visibility_has_no_target_error() {
    let backend = backend();
    let refused =
        solve_within(&backend, &implicit(cornell()), &TargetErrorOptions::new(0.05), &|_| 0, &mut run);
    let refused = refused.err().expect("an error");
    assert!(matches!(refused, SearchError::Implicit), "{refused}");
    finish(&backend);
}

/// A target out of reach is reported as such, with the best answer found.
#[test]
fn an_error_that_cannot_be_met() {
    let backend = backend();
    let scene = Shadow { lamp: 0.1, height: 1.0 }.scene().expect("a scene");
    let options = TargetErrorOptions::new(0.004).max_triangles(1450);
    let solved = within(&backend, &scene, &options);
    assert!(!solved.refinement.met);
    assert_eq!(solved.scene.triangles.len(), scene.triangles.len());
    let why = solved.refinement.why.join("\n");
    assert!(why.contains("triangles, and 1450 are allowed"), "{why}");
    finish(&backend);
}

/// Errors of a solved scene of diffuse triangles against a path-traced reference: of the means over its triangles, and of the
/// reflected light in a picture, where light varies within triangles. The noise of the reference is subtracted.
fn real_errors(backend: &Backend, solved: &Solved, options: &TargetErrorOptions) -> (f64, f64) {
    let picture = match options.shading {
        Shading::Gathered => error_of_gathered(backend, solved, &options.cameras[0]),
        _ => error_of_faces(backend, solved, &options.cameras[0]),
    };
    (error_of_irradiance(solved), picture)
}

fn error_of_irradiance(solved: &Solved) -> f64 {
    let areas = areas(&solved.scene);
    let truth = PathTracer::new(&solved.scene).irradiance(256);
    let (mut off, mut all) = (0.0, 0.0);
    for (i, truth) in truth.iter().enumerate() {
        let difference = DVec3::from(solved.answer.irradiance[i]) - truth.mean;
        off += areas[i] * (difference.length_squared() - truth.error.length_squared());
        all += areas[i] * truth.mean.length_squared();
    }
    (off.max(0.0) / all).sqrt()
}

/// Of a picture with one colour per triangle.
fn error_of_faces(backend: &Backend, solved: &Solved, camera: &Camera) -> f64 {
    let mut fine = solved.scene.clone();
    let parents = fine.split_all(2);
    let rasterizer = Rasterizer::new(backend).expect("a rasterizer");
    let seen = rasterizer.visible_samples(&fine, camera, 1).expect("samples");
    let mut samples = vec![0.0; fine.triangles.len()];
    seen.iter().filter(|&&face| face != u32::MAX).for_each(|&face| samples[face as usize] += 1.0);
    let tracer = PathTracer::new(&fine);
    let (mut off, mut all) = (0.0, 0.0);
    for (i, &samples) in samples.iter().enumerate().filter(|(_, samples)| **samples > 0.0) {
        let (truth, material) = (tracer.irradiance_of(i, 64), fine.material(i));
        let albedo = DVec3::from(material.diffuse_albedo()) / PI;
        let colour = DVec3::from(solved.answer.colours[0][parents[i] as usize]);
        let difference = colour - DVec3::from(material.emission) - albedo * truth.mean;
        off += samples * (difference.length_squared() - (albedo * truth.error).length_squared());
        all += samples * (albedo * truth.mean).length_squared();
    }
    (off.max(0.0) / all).sqrt()
}

/// Of a gathered picture, in all pixels that do not show a lamp.
fn error_of_gathered(backend: &Backend, solved: &Solved, camera: &Camera) -> f64 {
    let rasterizer = Rasterizer::new(backend).expect("a rasterizer");
    let coverage = rasterizer.coverage(&solved.scene, camera, 8).expect("a view");
    let pixels = solved.answer.light.pixels(0, &coverage).expect("pixels");
    let mut emits = vec![false; pixels.len()];
    for seen in coverage.faces_in_pixels() {
        emits[seen.pixel] |= solved.scene.material(seen.face).emission != [0.0; 3];
    }
    let truth = PathTracer::new(&solved.scene).picture(camera, 64, 1);
    let (mut off, mut all) = (0.0, 0.0);
    for ((found, truth), _) in pixels.iter().zip(&truth.pixels).zip(&emits).filter(|(_, emits)| !**emits) {
        let difference = DVec3::new(found[0], found[1], found[2]) - truth.radiance.mean;
        off += difference.length_squared() - truth.radiance.error.length_squared();
        all += truth.radiance.mean.length_squared();
    }
    (off.max(0.0) / all).sqrt()
}

/// A room of 36 triangles, with shadows inside them that no comparison of bins shows. The estimates, of the solved triangles and
/// of the picture, are not far below the errors.
#[test]
fn a_mesh_that_is_too_coarse_for_its_shadows() {
    let backend = backend();
    let scene = as_given("scenes/coarse_cornell.toml");
    assert_eq!(scene.triangles.len(), 36);
    let camera = Camera { width: 64, height: 64, ..scene.cameras[0].clone() };
    for (shading, error, max_triangles, met) in [
        (Shading::Face, 0.17, 2000, true),
        (Shading::Gathered, 0.04, 2000, true),
        (Shading::Gathered, 0.03, 300, false),
    ] {
        let options = TargetErrorOptions::new(error)
            .max_triangles(max_triangles)
            .cameras(vec![camera.clone()])
            .shading(shading);
        let solved = within(&backend, &scene, &options);
        let found = estimate(&solved);
        let (irradiance, picture) = real_errors(&backend, &solved, &options);
        println!(
            "{shading:?}, target {error}: irradiance {irradiance:.4}, estimated {:.4}; picture {picture:.4}, estimated {:.4}",
            found.irradiance.total, found.pictures[0].total
        );
        assert_eq!(solved.refinement.met, met);
        let triangles = solved.scene.triangles.len();
        assert!(triangles > 200, "wide triangles are cut");
        assert!(triangles < 1000, "only triangles within which light varies are cut");
        for (real, estimated) in [(irradiance, found.irradiance.total), (picture, found.pictures[0].total)] {
            assert!(real <= 1.5 * estimated, "{real}, estimated {estimated}");
            assert!(!met || real <= error, "{real}");
        }
        assert_eq!(solved.on_given(&solved.answer.irradiance).len(), 36);
    }
    finish(&backend);
}

fn no_memory() -> EngineError {
    let label = "state: bins".to_owned();
    let error = OverBudget { label, requested: Bytes(2), in_use: Bytes(1), budget: Bytes(2) };
    EngineError::Transport(TransportError::OverBudget(error))
}

fn diverged() -> EngineError {
    let residuals = vec![1.0, 1e3, 1e9];
    EngineError::Solve(SolveError::Diverged { passes: 3, residual: 1e9, residuals })
}

/// Solves a shadow to a target error while solves of certain numbers fail; each level has two.
fn failing(
    backend: &Backend,
    error: f64,
    fails: impl Fn(u32) -> bool,
    with: fn() -> EngineError,
) -> Result<Solved, SearchError> {
    let mut scene = Shadow { lamp: 0.4, height: 1.0 }.scene().expect("a scene");
    // Exact, this shadow meets any target at once.
    scene.settings.lamps = Lamps::Antiradiance;
    let options = TargetErrorOptions::new(error).max_triangles(6000);
    let mut solves = 0;
    let mut run = |engine: &mut Engine, scene: &Scene, stage: &Stage| {
        solves += 1;
        if fails(solves) { Err(with()) } else { run(engine, scene, stage) }
    };
    solve_within(backend, &scene, &options, &|_| 0, &mut run)
}

/// Failures of later levels do not lose the answers of earlier ones.
#[test]
fn the_best_answer_stays() {
    let backend = backend();
    // Out of memory at the second level.
    let solved = failing(&backend, 0.002, |solve| solve > 2, no_memory).expect("the first level's answer");
    let why = solved.refinement.why.join("\n");
    assert!(why.contains("the next step was skipped: \"state: bins\" needs"), "{why}");
    assert_eq!(
        (solved.refinement.steps.len(), solved.refinement.chosen, solved.refinement.met),
        (1, 0, false)
    );
    assert_eq!(solved.answer.irradiance.len(), 1448);
    // At the second level the solve diverges, at the third its comparison too.
    let solved = failing(&backend, 0.002, |solve| solve > 3, diverged).expect("the first level's answer");
    let Solved { refinement, answer, .. } = solved;
    assert_eq!((refinement.steps.len(), refinement.chosen, refinement.met), (3, 0, false));
    assert!(
        refinement.steps[1].failure.as_deref().is_some_and(|text| text.contains("diverges")),
        "{refinement:?}"
    );
    assert!(answer.irradiance.len() == 1448 && refinement.steps[1].triangles > 1448);
    // The first level cannot be run: the one below is, and the first is not tried again.
    let solved = failing(&backend, 0.002, |solve| solve == 1, no_memory).expect("a lower level's answer");
    assert_eq!(solved.refinement.steps[0].bins, "concentric:16");
    // No level from the first on has an answer, but the one below it has.
    let solved = failing(&backend, 0.002, |solve| solve <= 6, diverged).expect("a lower level's answer");
    let Refinement { steps, chosen, .. } = &solved.refinement;
    assert_eq!((steps.len(), *chosen, steps[3].bins.as_str()), (4, 3, "concentric:16"));
    assert!(steps[3].estimate.is_some() && steps[..3].iter().all(|step| step.failure.is_some()));
    // No level has an answer.
    let error = failing(&backend, 0.002, |_| true, diverged).err().expect("no answer");
    assert!(error.is_without_answer(), "{error}");
    let error = failing(&backend, 0.002, |_| true, no_memory).err().expect("no answer");
    assert!(error.to_string().contains("state: bins"), "{error}");
    finish(&backend);
}

/// Duplicate triangles do not depend on bins: both solves agree on the wrong answer.
#[test]
fn a_warning_of_more_prevents_meeting_the_target() {
    let backend = backend();
    let mut scene = furnace(0.5);
    let twice = scene.triangles[..scene.triangles.len() / 20].to_vec();
    scene.meshes[0].range.end += twice.len() as u32;
    scene.triangles.extend(twice);
    let options = TargetErrorOptions::new(0.5).max_triangles(1000);
    let solved = within(&backend, &scene, &options);
    assert!(estimate(&solved).total <= 0.5);
    assert!(!solved.refinement.met);
    let why = solved.refinement.why.join("\n");
    assert!(why.contains("errors that the estimate does not include: duplicate triangles"), "{why}");
    finish(&backend);
}

/// A solve leaves nothing behind, since the next one is planned with all of its memory.
#[test]
fn comparisons_leave_no_memory_taken() {
    let backend = backend();
    let scene = Shadow { lamp: 0.4, height: 0.25 }.scene().expect("a scene");
    let mut run = |engine: &mut Engine, scene: &Scene, stage: &Stage| {
        let allocated: u64 = engine.backend().memory().by_label.iter().map(|l| l.bytes).sum();
        assert!(allocated <= engine.plan().memory().total(), "{}: {allocated}", stage.name);
        run(engine, scene, stage)
    };
    let solved =
        solve_within(&backend, &scene, &TargetErrorOptions::new(0.05), &|_| 0, &mut run).expect("a solution");
    assert!(solved.refinement.steps.len() == 1);
    let left = backend.memory().by_label.into_iter().map(|l| l.label);
    // Staging buffers belong to the Vulkan device.
    assert_eq!(left.filter(|label| !label.starts_with("staging")).collect::<Vec<_>>(), [""; 0]);
    finish(&backend);
}
