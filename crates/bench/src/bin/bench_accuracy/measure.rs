//! One setting: solve, and compare.

use crate::Interrupted;
use crate::cases::{Case, Truth};
use crate::sweep::Setting;
use crate::table::Row;
use antirad::backend::Backend;
use antirad::cli::Interrupt;
use antirad::image::Rasterizer;
use antirad::plan::{Plan, PlanOptions};
use antirad::resolve::Cut;
use antirad::scene::{Camera, Scene};
use antirad::target_error::{Stage, TargetErrorOptions, solve_within};
use antirad::{Engine, SolveParams};
use antirad_core::direct::DirectLight;
use glam::DVec3;
use std::error::Error;
use std::f64::consts::PI;
use std::time::Instant;

/// Samples along each side of a pixel.
const SUPERSAMPLE: u32 = 2;

pub fn measure(
    backend: &Backend,
    case: &Case,
    setting: &Setting,
    interrupt: &Interrupt,
) -> Result<Row, Box<dyn Error>> {
    let mut scene = Scene { settings: setting.solve, ..case.scene.clone() };
    let parents = scene.split_all(setting.level);
    let plan = Plan::new(&scene, &PlanOptions::of(backend), &scene.settings)?;
    let bytes = plan.memory().total();
    // The engine computes it, too, but compiles kernels in the same call.
    let start = Instant::now();
    if !plan.lamps().is_empty() {
        let (lamps, material) = (plan.lamps().to_vec(), |i| scene.material(i));
        let light = DirectLight::new(
            backend.ranks(),
            plan.facets(),
            lamps,
            plan.visibility(),
            plan.openness().clone(),
            material,
        );
        std::hint::black_box(light?);
    }
    let direct = start.elapsed().as_secs_f64();
    let mut engine = Engine::new(backend, &scene, plan)?;
    // The first dispatches compile kernels, so a first pass is not measured.
    let stop = interrupt.clone();
    engine.set_pass_callback(Some(Box::new(move |_, _| stop.flow())));
    let warm_up = SolveParams::default().tolerance(0.9).max_passes(3);
    match engine.solve(&warm_up) {
        Err(error) if !error.is_without_answer() => return Err(interrupted_or(error, interrupt)),
        _ => (),
    }
    let mut row = Row { triangles: scene.triangles.len(), bytes, ..Row::new(case, setting) };
    let start = Instant::now();
    let solved = engine.solve(&SolveParams::from(&scene.settings));
    row.seconds = direct + start.elapsed().as_secs_f64();
    let solution = match solved {
        Ok(solution) => solution,
        Err(error) if error.is_without_answer() => {
            row.failure = error.to_string();
            return Ok(row);
        }
        Err(error) => return Err(interrupted_or(error, interrupt)),
    };
    row.passes = solution.info.passes;
    row.residuals = solution.info.residuals.clone();
    row.negative = solution.negative.triangles;

    let cut = Cut::between(&case.scene, &scene, &parents);
    judge(&mut row, backend, case, cut.on_given(&solution.irradiance))?;
    Ok(row)
}

/// Settings found for a target error, and their real error.
pub fn measure_asked(
    backend: &Backend,
    case: &Case,
    options: &TargetErrorOptions,
    interrupt: &Interrupt,
) -> Result<Row, Box<dyn Error>> {
    let start = Instant::now();
    let stop = interrupt.clone();
    let mut solve = |engine: &mut Engine, scene: &Scene, _: &Stage| {
        let stop = stop.clone();
        engine.set_pass_callback(Some(Box::new(move |_, _| stop.flow())));
        engine.solve(&SolveParams::from(&scene.settings))
    };
    let solved = solve_within(backend, &case.scene, options, &|_| 0, &mut solve);
    let solved = match solved {
        Ok(solved) => solved,
        Err(error) if error.is_without_answer() => {
            let setting = Setting { solve: case.scene.settings, level: 0, varies: ASKED };
            return Ok(Row { failure: error.to_string(), ..Row::new(case, &setting) });
        }
        Err(error) => return Err(interrupted_or(error, interrupt)),
    };
    let seconds = start.elapsed().as_secs_f64();
    let step = solved.refinement.answer();
    let setting = Setting { solve: solved.scene.settings, level: 0, varies: ASKED };
    let mut row = Row {
        triangles: solved.scene.triangles.len(),
        asked: Some(options.error),
        estimate: step.and_then(|step| step.estimate.as_ref()).map(|estimate| estimate.total),
        seconds,
        passes: solved.refinement.steps.iter().map(|step| step.passes).sum(),
        bytes: solved.answer.plan.memory_total,
        negative: solved.answer.negative.triangles,
        ..Row::new(case, &setting)
    };
    judge(&mut row, backend, case, solved.on_given(&solved.answer.irradiance))?;
    Ok(row)
}

/// The varied setting of rows whose settings were found for a target error.
const ASKED: &str = "asked";

/// `found`: irradiance of the scene's own triangles.
fn judge(row: &mut Row, backend: &Backend, case: &Case, found: Vec<[f64; 3]>) -> Result<(), Box<dyn Error>> {
    let found: Vec<DVec3> = found.into_iter().map(DVec3::from).collect();
    match &case.truth {
        Truth::Mean { material, irradiance } => {
            let receives = |i: &usize| case.scene.material(*i).name == *material;
            let receivers: Vec<usize> = (0..found.len()).filter(receives).collect();
            let of = |f: &dyn Fn(usize) -> f64| receivers.iter().map(|&i| f(i)).sum::<f64>();
            let mean = of(&|i| case.areas[i] * found[i].x) / of(&|i| case.areas[i]);
            row.error = Some((mean / irradiance - 1.0).abs());
        }
        Truth::Triangles(truth) => compare(row, backend, case, &found, truth)?,
    }
    Ok(())
}

pub fn interrupted_or(error: impl Error + 'static, interrupt: &Interrupt) -> Box<dyn Error> {
    if interrupt.is_set() { Interrupted.into() } else { error.into() }
}

/// Errors of irradiance.
pub struct Errors {
    /// Area-weighted relative L2.
    pub relative: f64,
    /// Largest error of a triangle, relative to the mean.
    pub largest: f64,
    /// L2 inside shadows, relative to the light blocked there. `None` without shadows.
    pub shadow: Option<f64>,
    /// L2 inside shadows, relative to the true irradiance there, which is indirect light.
    pub dark: Option<f64>,
    /// L2 over all triangles, relative to the blocked light.
    pub blocked: f64,
    /// Relative error of the power absorbed by diffuse surfaces.
    pub absorbed: f64,
}

impl Errors {
    /// Errors of `found`, the irradiance of the unrefined triangles, W/m², against `truth`.
    pub fn new(case: &Case, found: &[DVec3], truth: &[DVec3]) -> Self {
        let sum = |of: &dyn Fn(usize) -> f64| (0..truth.len()).map(|i| case.areas[i] * of(i)).sum::<f64>();
        let difference = |i: usize| (found[i] - truth[i]).length_squared();
        let mean = sum(&|i| truth[i].max_element()) / case.areas.iter().sum::<f64>();
        let largest = (0..truth.len()).map(|i| (found[i] - truth[i]).abs().max_element()).fold(0.0, f64::max);
        let blocked = |i: usize| case.blocked[i].length_squared();
        let shadowed = |of: &dyn Fn(usize) -> f64| sum(&|i| if case.in_shadow[i] { of(i) } else { 0.0 });
        let shadowed_over = |over: f64| (over > 0.0).then(|| (shadowed(&difference) / over).sqrt());
        let absorbed = |e: &[DVec3]| {
            sum(&|i| {
                let albedo = DVec3::from(case.scene.material(i).diffuse_albedo());
                ((DVec3::ONE - albedo) * e[i]).element_sum()
            })
        };
        Self {
            relative: (sum(&difference) / sum(&|i| truth[i].length_squared())).sqrt(),
            largest: largest / mean,
            shadow: shadowed_over(shadowed(&blocked)),
            dark: shadowed_over(shadowed(&|i| truth[i].length_squared())),
            blocked: (sum(&difference) / sum(&blocked)).sqrt(),
            absorbed: absorbed(found) / absorbed(truth) - 1.0,
        }
    }
}

fn compare(
    row: &mut Row,
    backend: &Backend,
    case: &Case,
    found: &[DVec3],
    truth: &[DVec3],
) -> Result<(), Box<dyn Error>> {
    let errors = Errors::new(case, found, truth);
    row.error = Some(errors.relative);
    row.largest_error = Some(errors.largest);
    row.shadow_error = errors.shadow;
    row.floor_error = case.name.starts_with("shadow").then_some(errors.blocked);
    row.absorbed_error = Some(errors.absorbed);
    // The default camera looks at closed rooms from outside.
    let camera = case.scene.cameras.first().filter(|camera| camera.name != "auto");
    if let (Some(camera), true) = (camera, is_diffuse(&case.scene)) {
        row.picture_error = Some(picture_error(backend, &case.scene, camera, found, truth)?);
    }
    Ok(())
}

pub fn is_diffuse(scene: &Scene) -> bool {
    (0..scene.triangles.len()).all(|i| !scene.material(i).is_glossy())
}

/// Radiance of the fronts of diffuse triangles, W/(m² sr), from their irradiance.
pub fn colours(scene: &Scene, irradiance: &[DVec3]) -> Vec<[f64; 3]> {
    let colour = |i: usize| {
        let m = scene.material(i);
        (DVec3::from(m.emission) + DVec3::from(m.diffuse_albedo()) * irradiance[i] / PI).to_array()
    };
    (0..irradiance.len()).map(colour).collect()
}

/// The mean over pixels of d² / (t² + ε²), ε a hundredth of the mean.
fn picture_error(
    backend: &Backend,
    scene: &Scene,
    camera: &Camera,
    found: &[DVec3],
    truth: &[DVec3],
) -> Result<f64, Box<dyn Error>> {
    let coverage = Rasterizer::new(backend)?.coverage(scene, camera, SUPERSAMPLE)?;
    let (found, truth) = (coverage.pixels(&colours(scene, found))?, coverage.pixels(&colours(scene, truth))?);
    let values = || found.iter().zip(&truth).flat_map(|(f, t)| (0..3).map(move |c| (f[c], t[c])));
    let count = values().count() as f64;
    let small = 0.01 * values().map(|(_, t)| t).sum::<f64>() / count;
    Ok(values().map(|(f, t)| (f - t).powi(2) / (t * t + small * small)).sum::<f64>() / count)
}
