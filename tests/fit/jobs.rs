//! Whole fits with the double: their results and stopping, and that interruptions leave no trace.

use crate::double::Double;
use crate::{says, scene};
use antirad::cli::draw_fit;
use antirad::fit::{
    Fit, FitError, Job, LossKind, MotionKind, OnCheckpoint, OptimiserKind, Outcome, Per, PictureLoss,
    Recovered, Regulariser, Renderer, RunOptions, Settings, Stop, StopRule, Target, results,
};
use antirad::render::Quantity;
use antirad::scene::{LoadOptions, Scene};
use glam::DVec3;
use std::ops::ControlFlow;
use std::path::Path;

fn of(quantity: Quantity, material: &str) -> Fit {
    Fit::new(quantity).materials(Some(vec![material.to_owned()]))
}

fn job(settings: Settings) -> Job {
    Job::new("j", scene(), Double::targets(&scene(), 2), settings).expect("a job")
}

/// Fits albedos and lamp, from grey.
fn from_grey() -> Settings {
    let albedo = |material: &str| of(Quantity::Albedo, material).initial(Some([0.5; 3]));
    let lamp = of(Quantity::Emission, "lamp").initial(Some([3.0; 3]));
    Settings::new(vec![albedo("wall"), albedo("red"), lamp])
}

fn run_with(job: &mut Job, renderer: &mut dyn Renderer, options: &RunOptions) -> Result<Outcome, FitError> {
    job.run(renderer, options, &mut |_, _| ControlFlow::Continue(()))
}

fn run(settings: Settings, stop: StopRule) -> Outcome {
    let options = RunOptions::default().stop(stop);
    run_with(&mut job(settings), &mut Double::new(2), &options).expect("an outcome")
}

/// To the limit of rounding.
fn exact() -> StopRule {
    StopRule::default()
        .iterations(500)
        .relative_decrease(0.0)
        .gradient(1e-12)
        .loss(0.0)
        .seconds(f64::INFINITY)
}

#[track_caller]
fn found(outcome: &Outcome, quantity: &str, of: &str, truth: &[f64], error: f64) {
    let value = outcome.recovered.iter().find(|r| r.quantity == quantity && r.of == of);
    let Recovered { value, .. } = value.expect("a value");
    for (value, truth) in value.iter().zip(truth) {
        assert!((value - truth).abs() <= error, "{quantity} of {of}: {value}, not {truth}");
    }
}

#[test]
fn albedo_and_lamp_from_grey() {
    let outcome = run(from_grey(), exact());
    let (first, last) = (outcome.history[0].loss, outcome.loss);
    assert!(last < 1e-14 * first, "{first} to {last}");
    found(&outcome, "albedo", "wall", &[0.7, 0.5, 0.3], 1e-6);
    found(&outcome, "albedo", "red", &[0.6, 0.1, 0.2], 1e-6);
    found(&outcome, "emission", "lamp", &[10.0, 9.0, 5.0], 1e-5);
    assert!(outcome.history.len() < 150, "{} iterations", outcome.history.len());
}

/// The Gauss-Newton Hessian saves evaluations and leads to the same minimum, also where the pictures cannot be explained.
#[test]
fn a_gauss_newton_hessian_saves_evaluations() {
    let mut targets = Double::targets(&scene(), 2);
    for (at, pixel) in targets.iter_mut().flat_map(|target| &mut target.pixels).enumerate() {
        *pixel *= 1.0 + 0.1 * (at as f64 * 1.7).sin();
    }
    let prior = Regulariser::Prior { of: Quantity::Albedo, names: None, value: Some([0.4; 3]), weight: 1e-3 };
    let with = |gauss_newton| {
        let settings = from_grey().gauss_newton(gauss_newton).regularisers(vec![prior.clone()]);
        let mut job = Job::new("j", scene(), targets.clone(), settings).expect("a job");
        let options = RunOptions::default().stop(exact().gradient(1e-9));
        let mut renderer = Double::new(2);
        let outcome = run_with(&mut job, &mut renderer, &options).expect("an outcome");
        (outcome, renderer.pictures)
    };
    let ((without, slow), (with, fast)) = (with(0), with(3));
    assert!((with.loss / without.loss - 1.0).abs() < 1e-7, "{} and {}", with.loss, without.loss);
    for (a, b) in with.recovered.iter().zip(&without.recovered) {
        for (a, b) in a.value.iter().zip(&b.value) {
            assert!((a - b).abs() < 1e-3 * b.abs().max(0.1), "{a} and {b}");
        }
    }
    assert!(3 * fast < 2 * slow, "{fast} pictures, without a Hessian {slow}");
}

#[test]
fn glossy_material_and_motion() {
    let fits = vec![
        of(Quantity::Specular, "gloss").initial(Some([0.1; 3])),
        Fit::new(Quantity::Position)
            .meshes(Some(vec!["box".to_owned()]))
            .motion(MotionKind::Translation)
            .initial(Some([0.05, 0.0, 0.0]))
            .upper(Some([1.0, 0.0, 0.0]))
            .lower(Some([-1.0, 0.0, 0.0])),
    ];
    let outcome = run(Settings::new(fits), exact());
    found(&outcome, "specular", "gloss", &[0.2, 0.1, 0.05], 1e-6);
    found(&outcome, "translation", "box", &[0.0, 0.0, 0.0], 1e-5);
}

/// Adam converges slowly; its best point is the result.
#[test]
fn adam_lowers_a_loss_with_kinks() {
    let settings = from_grey().optimiser(OptimiserKind::Adam).loss(LossKind::LogL1);
    let outcome = run(settings, exact());
    assert_eq!(outcome.stop, Stop::Iterations);
    let least = outcome.history.iter().map(|r| r.loss).fold(f64::INFINITY, f64::min);
    assert!(outcome.loss <= least * (1.0 + 1e-12) && least < 0.05 * outcome.history[0].loss, "{least}");
    found(&outcome, "albedo", "wall", &[0.7, 0.5, 0.3], 0.02);
}

/// A fit of emission alone is linear and solved as such.
#[test]
fn emission_alone_is_least_squares() {
    let everywhere = Fit::new(Quantity::Emission).per(Per::Triangle).initial(Some([1.0; 3]));
    for (loss, error) in [(LossKind::L2, 1e-3), (LossKind::RelativeL2, 5e-2)] {
        let settings = Settings::new(vec![everywhere.clone()]).loss(loss);
        let job = job(settings.clone());
        let expected = match loss {
            LossKind::L2 => OptimiserKind::LeastSquares,
            _ => OptimiserKind::QuasiNewton,
        };
        assert_eq!(job.optimiser(), expected);
        let outcome = run(settings, exact());
        assert!(outcome.loss < 1e-8 * outcome.history[0].loss, "{loss:?}: {}", outcome.loss);
        let scene = scene();
        for t in 0..scene.triangles.len() {
            let (found, truth) = (outcome.scene.material(t).emission, scene.material(t).emission);
            for (found, truth) in found.iter().zip(truth) {
                assert!(
                    *found >= 0.0 && (found - truth).abs() < error,
                    "{loss:?} triangle {t}: {found} {truth}"
                );
            }
        }
    }
    let others = from_grey().optimiser(OptimiserKind::LeastSquares);
    let refused = Job::new("j", scene(), Double::targets(&scene(), 1), others).err().expect("refused");
    says(&refused.to_string(), &["emission alone", "quasi-newton"]);
    let kinks = Settings::new(vec![everywhere]).loss(LossKind::L1);
    assert_eq!(job(kinks).optimiser(), OptimiserKind::QuasiNewton);
}

/// Regularisers enter the linear solve too.
#[test]
fn least_squares_with_assumptions() {
    let everywhere = Fit::new(Quantity::Emission).per(Per::Triangle).initial(Some([1.0; 3]));
    let with = |optimiser| {
        Settings::new(vec![everywhere.clone()]).optimiser(optimiser).regularisers(vec![
            Regulariser::Sparsity { weight: 3e-2 },
            Regulariser::Smoothness { of: Quantity::Emission, weight: 1e-2 },
            Regulariser::Prior { of: Quantity::Emission, names: None, value: Some([0.1; 3]), weight: 1e-2 },
        ])
    };
    let (linear, general) = (
        run(with(OptimiserKind::LeastSquares), exact()),
        run(with(OptimiserKind::QuasiNewton), exact().iterations(3000)),
    );
    assert!((linear.loss / general.loss - 1.0).abs() < 1e-6, "{} {}", linear.loss, general.loss);
    assert!(linear.assumptions.iter().all(|a| *a > 0.0));
}

#[test]
fn the_rule_says_when_to_stop() {
    let rule = |change: &dyn Fn(&mut StopRule)| {
        let mut rule = exact();
        change(&mut rule);
        // Slowly, so that there is something to stop.
        run(from_grey().gauss_newton(0), rule)
    };
    let few = rule(&|r| r.iterations = 3);
    assert_eq!((few.stop, few.history.len()), (Stop::Iterations, 4));
    let low = rule(&|r| r.loss = 1e-3);
    assert!(low.stop == Stop::Loss && low.loss <= 1e-3 && low.loss > 1e-9);
    assert_eq!(rule(&|r| r.gradient = 0.1).stop, Stop::Gradient);
    assert_eq!(rule(&|r| r.relative_decrease = 0.9999).stop, Stop::RelativeDecrease);
    let end = rule(&|r| r.gradient = 0.0);
    assert!(end.stop == Stop::NoProgress || end.history.last().is_some_and(|r| r.gradient == 0.0));
}

/// Interrupted after or within any iteration, or failed within, and resumed, a fit gives the same result to the last bit, and goes on with the
/// iteration that it was in.
#[test]
fn interruptions_leave_no_trace() {
    // Each picture depends a little on the one before.
    let haunted = || Double { memory: 1e-4, ..Double::new(2) };
    let emission = Fit::new(Quantity::Emission).per(Per::Triangle).initial(Some([1.0; 3]));
    let adam = from_grey().optimiser(OptimiserKind::Adam);
    for (settings, iterations) in [(from_grey(), 12), (adam, 25), (Settings::new(vec![emission]), 12)] {
        let stop = exact().iterations(iterations);
        let mut renderer = haunted();
        let options = RunOptions::default().stop(stop);
        let whole = run_with(&mut job(settings.clone()), &mut renderer, &options).expect("an outcome");
        let renders = renderer.pictures;
        for at in 1..=renders {
            let folder = tempfile::tempdir().expect("a folder");
            let options = RunOptions::default()
                .checkpoints(Some(folder.path().to_owned()))
                .checkpoint_every(4)
                .on_checkpoint(OnCheckpoint::Resume)
                .stop(stop);
            let fails = at % 2 == 0;
            let mut renderer = Double { interrupt_at: Some(at), fails, ..haunted() };
            let mut reached = 0;
            let first = job(settings.clone()).run(&mut renderer, &options, &mut |record, _| {
                reached = record.iteration;
                ControlFlow::Continue(())
            });
            let error = first.expect_err("an interruption");
            match fails {
                true => assert!(error.to_string().contains("is lost"), "{error}"),
                false => assert!(matches!(error, FitError::Interrupted { .. }), "render {at} of {renders}"),
            }
            let second = run_with(&mut job(settings.clone()), &mut haunted(), &options).expect("an outcome");
            same(&whole, &second);
            assert_eq!(second.resumed_from.unwrap_or(0), reached);
        }
        // Interrupted by the callback, after every single iteration.
        let folder = tempfile::tempdir().expect("a folder");
        let options = RunOptions::default()
            .checkpoints(Some(folder.path().to_owned()))
            .on_checkpoint(OnCheckpoint::Resume)
            .stop(stop);
        let mut last = None;
        for _ in 0..40 {
            let mut seen = 0;
            let result = job(settings.clone()).run(&mut haunted(), &options, &mut |record, _| {
                seen += usize::from(record.iteration > 0);
                if seen > 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            });
            match result {
                Err(FitError::Interrupted { .. }) => {}
                other => {
                    last = Some(other.expect("an outcome"));
                    break;
                }
            }
        }
        same(&whole, &last.expect("an end"));
    }
}

#[track_caller]
fn same(a: &Outcome, b: &Outcome) {
    assert_eq!(a.history, b.history);
    assert_eq!((a.stop, a.loss.to_bits()), (b.stop, b.loss.to_bits()));
    assert_eq!(a.scene.materials, b.scene.materials);
    assert_eq!(a.pictures, b.pictures);
}

#[test]
fn a_checkpoint_of_another_job_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let stop = exact().iterations(2);
    let options = RunOptions::default()
        .checkpoints(Some(folder.path().to_owned()))
        .on_checkpoint(OnCheckpoint::Resume)
        .stop(stop);
    run_with(&mut job(from_grey()), &mut Double::new(2), &options).expect("an outcome");
    let refused = |settings: Settings, scene: Scene, targets: Vec<Target>| {
        let mut job = Job::new("j", scene, targets, settings).expect("a job");
        run_with(&mut job, &mut Double::new(2), &options).expect_err("another job").to_string()
    };
    let targets = || Double::targets(&scene(), 2);
    says(
        &refused(from_grey().loss(LossKind::L1), scene(), targets()),
        &["checkpoint", "the job's settings", "start over"],
    );
    let mut moved = scene();
    moved.vertices[0].x += 1e-9;
    says(&refused(from_grey(), moved, targets()), &["the scene"]);
    let mut changed = targets();
    changed[1].pixels[3].y += 1e-9;
    says(&refused(from_grey(), scene(), changed), &["target 2 (camera \"view 1\")"]);
    // More iterations are the same job; starting over is always possible.
    let longer = options.clone().stop(exact().iterations(5));
    let outcome = run_with(&mut job(from_grey()), &mut Double::new(2), &longer).expect("an outcome");
    assert_eq!((outcome.resumed_from, outcome.history.len()), (Some(2), 6));
    let unsaid = options.clone().on_checkpoint(OnCheckpoint::default());
    let error = run_with(&mut job(from_grey()), &mut Double::new(2), &unsaid).expect_err("progress is there");
    says(&error.to_string(), &["checkpoint", "--resume", "--restart"]);
    let anew = options.on_checkpoint(OnCheckpoint::Discard);
    let outcome = run_with(&mut job(from_grey()), &mut Double::new(2), &anew).expect("an outcome");
    assert_eq!((outcome.resumed_from, outcome.history.len()), (None, 3));
}

/// Steps to scenes without a solution are shortened; at the start they are an error.
#[test]
fn scenes_without_an_answer() {
    let mut renderer = Double { limit: Some(0.71), ..Double::new(2) };
    let options = RunOptions::default().stop(exact());
    let outcome = run_with(&mut job(from_grey()), &mut renderer, &options).expect("an outcome");
    found(&outcome, "albedo", "wall", &[0.7, 0.5, 0.3], 1e-5);
    let mut renderer = Double { limit: Some(0.4), ..Double::new(2) };
    let error = run_with(&mut job(from_grey()), &mut renderer, &options).expect_err("no start");
    says(&error.to_string(), &["not finite at the starting point"]);
}

#[test]
fn differences_serve_where_there_are_no_derivatives() {
    let options = RunOptions::default().stop(exact().iterations(60));
    let mut renderer = Double { without_derivatives: true, ..Double::new(2) };
    let outcome = run_with(&mut job(from_grey()), &mut renderer, &options).expect("an outcome");
    found(&outcome, "albedo", "wall", &[0.7, 0.5, 0.3], 1e-4);
    let lamp = Settings::new(vec![of(Quantity::Emission, "lamp").initial(Some([1.0; 3]))]);
    let mut renderer = Double { without_derivatives: true, ..Double::new(2) };
    let outcome = run_with(&mut job(lamp), &mut renderer, &options).expect("an outcome");
    found(&outcome, "emission", "lamp", &[10.0, 9.0, 5.0], 1e-4);
}

/// A loss of the red channel alone.
struct Red;

impl PictureLoss for Red {
    fn evaluate(&self, _view: usize, picture: &[DVec3], target: &Target) -> (f64, Vec<DVec3>) {
        let d = picture.iter().zip(&target.pixels).map(|(p, t)| p.x - t.x);
        (d.clone().map(|d| d * d).sum(), d.map(|d| DVec3::X * 2.0 * d).collect())
    }
}

#[test]
fn a_loss_of_ones_own() {
    let mut job = job(from_grey());
    job.set_loss(Box::new(Red));
    let options = RunOptions::default().stop(exact());
    let outcome = run_with(&mut job, &mut Double::new(2), &options).expect("an outcome");
    found(&outcome, "albedo", "wall", &[0.7, 0.5, 0.5], 1e-5);
    found(&outcome, "emission", "lamp", &[10.0, 3.0, 3.0], 1e-4);
}

#[test]
fn the_gradient_of_a_problem_is_that_of_differences() {
    let fits = vec![
        Fit::new(Quantity::Albedo),
        of(Quantity::Specular, "gloss"),
        of(Quantity::Power, "gloss"),
        of(Quantity::Emission, "lamp"),
        Fit::new(Quantity::Position).meshes(Some(vec!["table".to_owned()])).motion(MotionKind::Similarity),
    ];
    for loss in [LossKind::L2, LossKind::RelativeL2, LossKind::LogL1] {
        let settings = Settings::new(fits.clone()).loss(loss);
        let job = job(settings);
        let mut renderer = Double::new(2);
        let mut x: Vec<f64> = job
            .problem()
            .parameters
            .start()
            .iter()
            .enumerate()
            .map(|(i, x)| 0.9 * x + 0.01 * i as f64)
            .collect();
        job.problem().parameters.bounds().project(&mut x);
        let gradient = job.problem().evaluate(&x, &mut renderer).expect("a value").gradient;
        for i in 0..x.len() {
            let (here, h) = (x[i], 1e-6);
            let mut at = |value: f64| {
                x[i] = value;
                job.problem().evaluate(&x, &mut renderer).expect("a value").value
            };
            let numeric = (at(here + h) - at(here - h)) / (2.0 * h);
            x[i] = here;
            assert!(
                (numeric - gradient[i]).abs() < 1e-6 * (1.0 + numeric.abs()),
                "{loss:?} {i}: {} {numeric}",
                gradient[i]
            );
        }
    }
}

fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

#[test]
fn results_are_files_that_are_the_same_every_time() {
    let write = || {
        let folder = tempfile::tempdir().expect("a folder");
        let mut job = job(from_grey());
        let options = RunOptions::default().stop(exact().iterations(4));
        let outcome = run_with(&mut job, &mut Double::new(2), &options).expect("an outcome");
        draw_fit(folder.path(), &job, &outcome).expect("drawn");
        results::write(folder.path(), &job, &outcome, &Default::default()).expect("written");
        (folder, outcome)
    };
    let ((a, outcome), (b, _)) = (write(), write());
    let mut names: Vec<String> = std::fs::read_dir(a.path())
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
        .collect();
    names.sort();
    let expected = [
        "albedo.npy",
        "emission.npy",
        "history.csv",
        "loss.svg",
        "parameters.json",
        "relight.toml",
        "report.json",
        "scene.glb",
        "scene.mtl",
        "scene.toml",
        "scene_1.obj",
        "scene_2.obj",
        "scene_3.obj",
        "scene_4.obj",
        "scene_5.obj",
        "view 0.exr",
        "view 0.png",
        "view 1.exr",
        "view 1.png",
    ];
    assert_eq!(names, expected);
    for name in names.iter().filter(|name| *name != "report.json") {
        assert!(bytes(a.path(), name) == bytes(b.path(), name), "{name} differs");
    }
    let fitted = Scene::load(&a.path().join("scene.toml"), &LoadOptions::default()).expect("a scene");
    assert_eq!(fitted.vertices, outcome.scene.vertices);
    for t in 0..fitted.triangles.len() {
        assert_eq!(fitted.material(t), outcome.scene.material(t));
    }
    let history = String::from_utf8(bytes(a.path(), "history.csv")).expect("text");
    assert_eq!(history.lines().next(), Some("iteration,loss,gradient,step,evaluations,passes"));
    assert_eq!(history.lines().count(), 6, "{history}");
    let report: serde_json::Value = serde_json::from_slice(&bytes(a.path(), "report.json")).expect("JSON");
    assert_eq!(report["iterations"], 4);
    assert_eq!(report["stopped_because"], "the iteration limit is reached");
    assert_eq!(report["views"][1]["camera"], "view 1");
    let albedo = bytes(a.path(), "albedo.npy");
    let array = npyz::NpyFile::new(&albedo[..]).expect("npy");
    assert_eq!(array.shape(), [outcome.scene.triangles.len() as u64, 3]);
    let numbers: Vec<f64> = array.into_vec().expect("f64");
    assert_eq!(numbers[..3], outcome.scene.material(0).albedo);
}

/// In the library's loop only the history grows with the number of iterations.
#[test]
#[cfg(target_os = "linux")]
fn memory_does_not_grow_over_many_iterations() {
    let resident = || {
        let status = std::fs::read_to_string("/proc/self/statm").expect("statm");
        status.split_whitespace().nth(1).and_then(|pages| pages.parse::<u64>().ok()).expect("pages") * 4096
    };
    let folder = tempfile::tempdir().expect("a folder");
    let options = RunOptions::default()
        .checkpoints(Some(folder.path().to_owned()))
        .stop(exact().iterations(400).gradient(0.0));
    let settings = from_grey().optimiser(OptimiserKind::Adam);
    let mut early = 0;
    let outcome = job(settings).run(&mut Double::new(2), &options, &mut |record, _| {
        if record.iteration == 200 {
            early = resident();
        }
        ControlFlow::Continue(())
    });
    assert_eq!(outcome.expect("an outcome").history.len(), 401);
    let grown = resident().saturating_sub(early);
    assert!(grown < 4 << 20, "{grown} bytes more after 200 more iterations");
}
