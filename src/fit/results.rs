//! The files that a fit leaves behind.

use super::comparison;
use super::gradient::Quantity;
use super::job::{FitError, Job, Outcome, Record};
use super::renderer::Estimate;
use super::settings::StopRule;
use crate::cli::{Curve, Drawn, LogPlot};
use crate::image::Picture;
use crate::output::{OutputError, atomic_write, write_array, write_json};
use crate::plan::Wanted;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::HashSet;
use std::path::Path;

/// Name of the fitted scene's files.
const SCENE: &str = "scene.toml";
/// Written last: where it is, all the others are.
pub const REPORT: &str = "report.json";

/// What only the caller knows of a run.
#[derive(Clone, Debug, Default)]
pub struct Circumstances {
    /// The scene file, for people.
    pub scene: String,
    /// When the fit was to end.
    pub stop: StopRule,
    /// What was expected before it started.
    pub estimate: Estimate,
    /// Memory of the host that optimiser and targets take, bytes.
    pub host_bytes: u64,
    /// For people, one line each.
    pub warnings: Vec<String>,
    /// More for the report: device and memory.
    pub more: Value,
}

/// Writes everything into `directory`, which exists; each file appears whole or not at all, `report.json` last. All but
/// the report are the same, byte for byte, whenever the job is.
///
/// - `scene.toml` with OBJ and MTL: the fitted scene, for [`Scene::load`](crate::scene::Scene::load).
/// - `parameters.json`: every fitted value with its start, unit, and whether it stands on a bound.
/// - `emission.npy`, `albedo.npy` … float64 of shape `[triangles, 3]` (δ and p: `[triangles]`), `vertices.npy` `[vertices, 3]`: of what
///   was fitted, in the order of the scene.
/// - `history.csv` and `loss.svg`, `loss.png`: the loss over the iterations.
/// - `VIEW.exr`, `VIEW.png`: the fitted picture, and target, fitted picture and error side by side.
/// - `report.json`.
pub fn write(directory: &Path, job: &Job, outcome: &Outcome, about: &Circumstances) -> Result<(), FitError> {
    outcome.scene.save(&directory.join(SCENE))?;
    write_json(&directory.join("parameters.json"), &outcome.recovered)?;
    write_arrays(directory, job.problem().parameters.wanted(), outcome)?;
    write_history(directory, &outcome.history)?;
    plot(directory, job, &outcome.history)?;
    let names = view_names(job);
    for ((target, fitted), name) in job.problem().targets.iter().zip(&outcome.pictures).zip(&names) {
        let pixels = fitted.iter().map(|p| p.as_vec3().extend(1.0).to_array()).collect();
        let picture = Picture { width: target.camera.width, height: target.camera.height, pixels };
        picture.write_exr(directory.join(format!("{name}.exr")))?;
        comparison::write(&directory.join(format!("{name}.png")), target, fitted)?;
    }
    write_json(&directory.join(REPORT), &report(job, outcome, about, &names))?;
    Ok(())
}

/// File names of the views: their cameras', numbered where one camera has several targets.
fn view_names(job: &Job) -> Vec<String> {
    let mut taken: HashSet<String> = [SCENE, "loss", "report"].map(String::from).into();
    let name = |name: &str| {
        let name: String =
            name.chars().map(|c| if "/\\:".contains(c) || c.is_control() { '_' } else { c }).collect();
        let mut numbered = std::iter::once(name.clone()).chain((2u64..).map(|n| format!("{name}_{n}")));
        numbered.find(|name| taken.insert(name.clone())).unwrap_or(name)
    };
    job.problem().targets.iter().map(|t| t.camera.name.as_str()).map(name).collect()
}

fn write_arrays(directory: &Path, fitted: Wanted, outcome: &Outcome) -> Result<(), OutputError> {
    let scene = &outcome.scene;
    let n = scene.triangles.len() as u64;
    let materials = || (0..scene.triangles.len()).map(|t| scene.material(t));
    let path = |quantity: Quantity| directory.join(format!("{}.npy", quantity.word()));
    if fitted.emission {
        write_array(&path(Quantity::Emission), &[n, 3], materials().flat_map(|m| m.emission))?;
    }
    if fitted.albedo {
        write_array(&path(Quantity::Albedo), &[n, 3], materials().flat_map(|m| m.albedo))?;
    }
    if fitted.specular {
        write_array(&path(Quantity::Specular), &[n, 3], materials().flat_map(|m| m.specular))?;
    }
    if fitted.diffuse {
        write_array(&path(Quantity::Diffuse), &[n], materials().map(|m| m.diffuse))?;
    }
    if fitted.power {
        write_array(&path(Quantity::Power), &[n], materials().map(|m| m.power))?;
    }
    if fitted.positions {
        let vertices = scene.vertices.iter().flat_map(|v| v.to_array());
        write_array(&directory.join("vertices.npy"), &[scene.vertices.len() as u64, 3], vertices)?;
    }
    Ok(())
}

fn write_history(directory: &Path, history: &[Record]) -> Result<(), OutputError> {
    atomic_write(&directory.join("history.csv"), |file| {
        let mut writer = csv::Writer::from_writer(file);
        for record in history {
            writer.serialize(record)?;
        }
        writer.flush()
    })
}

fn plot(directory: &Path, job: &Job, history: &[Record]) -> Result<(), OutputError> {
    let curve = |label: &str, of: fn(&Record) -> f64| Curve {
        label: label.to_owned(),
        points: history.iter().map(|r| (f64::from(r.iteration), of(r))).collect(),
        drawn: Drawn::Curve,
    };
    LogPlot {
        title: format!("Fit of {}", job.name),
        x: "iteration".to_owned(),
        y: "loss, and largest derivative by an unknown".to_owned(),
        curves: vec![curve("loss", |r| r.loss), curve("gradient", |r| r.gradient)],
        linear_x: true,
    }
    .write(&directory.join("loss"))
}

#[derive(Serialize)]
struct View<'a> {
    name: &'a str,
    camera: &'a str,
    /// Before its weight.
    loss: f64,
    weight: f64,
}

fn report(job: &Job, outcome: &Outcome, about: &Circumstances, names: &[String]) -> Value {
    let (problem, settings) = (job.problem(), job.settings());
    let first = outcome.history.first().map_or(f64::NAN, |r| r.loss);
    let iterations = outcome.history.last().map_or(0, |r| r.iteration);
    let evaluations: u32 = outcome.history.iter().map(|r| r.evaluations).sum();
    let passes: u64 = outcome.history.iter().map(|r| r.passes).sum();
    let each = |total: f64| total / f64::from(iterations.max(1));
    let views: Vec<View> = problem
        .targets
        .iter()
        .zip(names)
        .zip(&outcome.views)
        .map(|((target, name), &loss)| View {
            name,
            camera: &target.camera.name,
            loss,
            weight: target.weight,
        })
        .collect();
    let assumptions: Vec<Value> = settings
        .regularisers
        .iter()
        .zip(&outcome.assumptions)
        .map(|(term, value)| json!({ "assumed": term.assumption(), "weight": term.weight(), "part_of_loss": value }))
        .collect();
    json!({
        "job": job.name,
        "version": env!("CARGO_PKG_VERSION"),
        "scene": about.scene,
        "warnings": about.warnings,
        "unknowns": problem.parameters.len(),
        "optimiser": job.optimiser(),
        "settings": settings,
        "stop_rule": StopReport::from(about.stop),
        "stopped_because": outcome.stop.reason(),
        "stop": outcome.stop,
        "iterations": iterations,
        "resumed_from_iteration": outcome.resumed_from,
        "loss": { "start": first, "end": outcome.loss, "fell_by_factor": first / outcome.loss },
        "views": views,
        "assumptions": assumptions,
        "at_bound": outcome.recovered.iter().filter(|r| r.at_bound.contains(&true)).count(),
        "evaluations": evaluations,
        "passes": passes,
        "seconds": outcome.seconds,
        "seconds_per_iteration": each(outcome.seconds),
        "passes_per_iteration": each(passes as f64),
        "estimate": about.estimate,
        "host_bytes_of_optimiser_and_targets": about.host_bytes,
        "run": about.more,
    })
}

/// JSON has no infinity.
#[derive(Serialize)]
struct StopReport {
    iterations: u32,
    relative_decrease: f64,
    gradient: f64,
    loss: f64,
    seconds: Option<f64>,
}

impl From<StopRule> for StopReport {
    fn from(rule: StopRule) -> Self {
        let StopRule { iterations, relative_decrease, gradient, loss, seconds } = rule;
        Self {
            iterations,
            relative_decrease,
            gradient,
            loss,
            seconds: seconds.is_finite().then_some(seconds),
        }
    }
}
