//! Output files of a fit.

use super::exposure::curves;
use super::job::{FitError, Job, Outcome, Record};
use super::renderer::CostEstimate;
use super::settings::StopRule;
use super::target::Target;
use antirad_base::input;
use antirad_base::output::{FileNames, OutputError, atomic_write, write_array, write_json};
use antirad_core::plan::GradientRequest;
use antirad_render::export::{Format, export};
use antirad_render::image::Picture;
use antirad_render::render::Quantity;
use antirad_scene::Scene;
use glam::DVec3;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::Path;
use std::slice::from_ref;

/// Name of the fitted scene's files.
const SCENE: &str = "scene.toml";
/// The same for other programs, and which of its triangles is on which of the scene's, where meshes were simplified.
const GLTF: &str = "scene.glb";
const GIVEN: &str = "given.npy";
/// Factors of its lamps.
const LAMPS: &str = "relight.toml";
/// Steps of a table of a response.
const STEPS: u32 = 16;
/// Written last: if it exists, so do all others.
pub const REPORT: &str = "report.json";

/// Facts about a run that only the caller knows.
#[derive(Clone, Debug, Default)]
pub struct Circumstances {
    /// The scene file, for display.
    pub scene: String,
    /// The stopping rule.
    pub stop: StopRule,
    /// The cost estimate from before the start.
    pub estimate: CostEstimate,
    /// Host memory of optimiser and targets, bytes.
    pub host_bytes: u64,
    /// Warnings, one line each.
    pub warnings: Vec<String>,
    /// Further entries of the report: device and memory.
    pub more: Value,
}

/// Writes all files into `directory`, which must exist; each is written atomically, `report.json` last. All but the report
/// are the same, byte for byte, for the same job.
///
/// - `scene.toml` with OBJ and MTL: the fitted scene, for [`Scene::load`](antirad_scene::Scene::load).
/// - `scene.glb`: the same with its textures as binary glTF, for Blender and others; meshes that were simplified are as given, unless
///   their vertices are fitted.
/// - `given.npy`, if meshes were simplified: int64, for each triangle of `scene.glb` in order of meshes, its row in the other arrays.
/// - `relight.toml`: a factor of 1 for each of its lamps, for `antirad render scene.toml --relight relight.toml` and
///   [`LampFactor::read`](antirad_scene::LampFactor::read).
/// - `parameters.json`: every fitted value with its initial value, unit, and whether it is at a bound.
/// - `emission.npy`, `albedo.npy` … float64 of shape `[triangles, 3]` (δ and p: `[triangles]`), `vertices.npy`
///   `[vertices, 3]`: the fitted quantities, in scene order.
/// - `history.csv`: the loss over the iterations.
/// - `VIEW.exr`: the fitted picture.
/// - `report.json`.
///
/// Plots and comparisons of pictures are drawn by `cli::draw_fit`, which runs before this.
///
/// # Errors
/// Fails if a file cannot be written.
pub fn write(directory: &Path, job: &Job, outcome: &Outcome, about: &Circumstances) -> Result<(), FitError> {
    let textures = outcome.scene.save(&directory.join(SCENE))?;
    write_given(directory, &outcome.scene, job.problem().parameters.gradient_request().positions)?;
    outcome.scene.save_lamps(&directory.join(LAMPS))?;
    write_json(&directory.join("parameters.json"), &outcome.recovered)?;
    write_arrays(directory, job.problem().parameters.gradient_request(), outcome)?;
    write_history(directory, &outcome.history)?;
    let names = view_names(job);
    for ((target, fitted), name) in job.problem().targets.iter().zip(&outcome.pictures).zip(&names) {
        let pixels = fitted.iter().map(|p| p.as_vec3().extend(1.0).to_array()).collect();
        let picture = Picture { width: target.camera.width, height: target.camera.height, pixels };
        picture.write_exr(directory.join(format!("{name}.exr")))?;
    }
    write_json(&directory.join(REPORT), &report(job, outcome, about, &names, &textures))?;
    Ok(())
}

/// Relative L2 difference of fitted pictures, in the unit of their targets, from these, over unmasked pixels. Lower bounds that are kept
/// count as met.
pub fn picture_error(targets: &[Target], fitted: &[Vec<DVec3>]) -> f64 {
    let (mut off, mut all) = (0.0, 0.0);
    for (target, fitted) in targets.iter().zip(fitted) {
        for (at, (expected, found)) in target.pixels.iter().zip(fitted).enumerate() {
            // Masked pixels may hold any value.
            let counts = target.mask_at(at);
            if counts > 0.0 {
                let difference = [0, 1, 2].map(|c| match target.keeps_bound(at, found[c], expected[c]) {
                    true => 0.0,
                    false => found[c] - expected[c],
                });
                off += counts * DVec3::from(difference).length_squared();
                all += counts * expected.length_squared();
            }
        }
    }
    if off == 0.0 { 0.0 } else { (off / all).sqrt() }
}

/// The picture error over all views, read from the report in a folder written by [`write()`]; `None` if absent.
pub fn written_picture_error(directory: &Path) -> Option<f64> {
    let text = input::read(&directory.join(REPORT)).ok()?;
    serde_json::from_slice::<Value>(&text).ok()?.get("picture_error")?.as_f64()
}

/// File names of the views: those of their cameras, numbered if a camera has several targets.
pub fn view_names(job: &Job) -> Vec<String> {
    let mut names = FileNames::without(&[SCENE, "loss", "report"]);
    job.problem().targets.iter().map(|target| names.of(&target.camera.name)).collect()
}

/// The scene for other programs, on the meshes as given unless vertices moved.
fn write_given(directory: &Path, scene: &Scene, moved: bool) -> Result<(), OutputError> {
    let given = if moved { None } else { scene.with_given_meshes() };
    if let Some((_, rows)) = &given {
        let rows = rows.iter().map(|&row| i64::from(row));
        write_array(&directory.join(GIVEN), &[rows.len() as u64], rows)?;
    }
    let scene = given.as_ref().map_or(scene, |(scene, _)| scene);
    export(scene, Format::Gltf, &directory.join(GLTF), None)
}

fn write_arrays(directory: &Path, fitted: GradientRequest, outcome: &Outcome) -> Result<(), OutputError> {
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

#[derive(Serialize)]
struct View<'a> {
    name: &'a str,
    camera: &'a str,
    /// Loss, before its weight.
    loss: f64,
    weight: f64,
    /// See [`picture_error`].
    picture_error: f64,
    /// Factors from radiance to the picture's numbers, per channel, where they were fitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    gain: Option<[f64; 3]>,
}

fn report(
    job: &Job,
    outcome: &Outcome,
    about: &Circumstances,
    names: &[String],
    textures: &[String],
) -> Value {
    let (problem, settings) = (job.problem(), job.settings());
    let first = outcome.history.first().map_or(f64::NAN, |r| r.loss);
    let iterations = outcome.history.last().map_or(0, |r| r.iteration);
    let evaluations: u32 = outcome.history.iter().map(|r| r.evaluations).sum();
    let passes: u64 = outcome.history.iter().map(|r| r.passes).sum();
    let each = |total: f64| total / f64::from(iterations.max(1));
    let exposed = outcome.exposed();
    let found = outcome.views.iter().zip(&exposed).zip(&outcome.sensors);
    let views: Vec<View> = problem
        .targets
        .iter()
        .zip(names)
        .zip(found)
        .map(|((target, name), ((&loss, fitted), sensor))| View {
            name,
            camera: &target.camera.name,
            loss,
            weight: target.weight,
            picture_error: picture_error(from_ref(target), from_ref(fitted)),
            gain: target.exposure.is_fitted().then(|| sensor.gain.to_array()),
        })
        .collect();
    let terms = settings.regularisers.iter().zip(&outcome.assumptions);
    let mut assumptions: Vec<Value> = terms
        .map(|(term, value)| json!({ "assumed": term.assumption(), "weight": term.weight(), "part_of_loss": value }))
        .collect();
    if problem.targets.iter().all(|target| target.exposure.is_fitted()) {
        // Nothing else fixes the factor that light and all gains share, unless a light is known.
        assumptions.push(json!({ "assumed": "radiance and exposures share a factor per channel that photos of unknown exposure leave \
            open; where no light is known, it is that from which the fit starts" }));
    }
    let curves = curves(&problem.targets, &outcome.sensors);
    if let Some(value) = outcome.assumptions.get(settings.regularisers.len()) {
        assumptions.push(json!({ "assumed": "responses of cameras are like sRGB where photos leave them open", "part_of_loss": value }));
    }
    let responses = curves.iter().map(|(curve, views)| {
        let views: Vec<&str> = views.iter().map(|&view| names[view].as_str()).collect();
        // Numbers of the picture against those that sRGB would have, both of 1.
        json!({ "views": views, "logarithms": curve.logarithms, "curve": curve.table(STEPS) })
    });
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
        "picture_error": picture_error(&problem.targets, &exposed),
        "views": views,
        "textures": textures.iter().map(|file| json!({ "name": file.trim_end_matches(".png"), "file": file })).collect::<Vec<_>>(),
        "responses": responses.collect::<Vec<_>>(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::Camera;

    #[test]
    fn picture_errors_are_relative_and_heed_the_mask() {
        let camera = Camera { width: 2, height: 2, ..Camera::framing(&[]) };
        let target = |pixels: [f64; 4], mask| {
            let pixels = pixels.map(DVec3::splat).to_vec();
            Target::new(camera.clone(), pixels, mask, 1.0).expect("a target")
        };
        let found = |pixels: [f64; 4]| pixels.map(DVec3::splat).to_vec();
        let whole = target([1.0, 2.0, 2.0, 4.0], None);
        // 1 of 25.
        let near = found([1.0, 2.0, 3.0, 4.0]);
        assert_eq!(picture_error(from_ref(&whole), from_ref(&near)), 0.2);
        let masked = target([1.0, 2.0, f64::NAN, 4.0], Some(vec![1.0, 1.0, 0.0, 0.5]));
        assert_eq!(picture_error(from_ref(&masked), from_ref(&near)), 0.0);
        // Half of 4² more of 1 + 4 + half of 4².
        let far = found([1.0, 2.0, 0.0, 8.0]);
        assert_eq!(picture_error(from_ref(&masked), from_ref(&far)), (8.0f64 / 13.0).sqrt());
        // 1 + 8 of 25 + 13.
        let error = picture_error(&[whole, masked], &[near, far]);
        assert_eq!(error, (9.0f64 / 38.0).sqrt());
    }
}
