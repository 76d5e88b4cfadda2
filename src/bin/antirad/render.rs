//! `antirad render`.

use crate::Failure;
use crate::cameras;
use crate::lamps::LampArguments;
use crate::report::{DeviceReport, LampReport, MemoryUse, RankReport, Report, SolveReport};
use crate::settings::{SceneSettings, parse_error, resolved};
use crate::together::Together;
use antirad::backend::Backend;
use antirad::cli::{EXIT_UNRELIABLE, Interrupt, REFLECTIONS, SHADINGS, SolveBar, Working, word};
use antirad::gpu::Bytes;
use antirad::image::{Exposure, ImageError, Picture, PictureOptions, Rasterizer, ToneMap};
use antirad::output::{FileNames, prepare_directory, single, write_json, write_npy};
use antirad::plan::{Plan, PlanOptions};
use antirad::render::{Reflections, Shading};
use antirad::render::{RenderOptions, Renderer, Shown};
use antirad::resolve::{Decision, ResolveOptions, Resolved};
use antirad::scene::{Camera, Precision, Scene};
use antirad::target_error::{Answer, Refinement, Solved, Stage, TargetErrorOptions, solve_within};
use antirad::warnings::{Kind, MATTERS, Warning, Warnings, told_from};
use antirad::{Engine, EngineError, Solution, SolveParams};
use clap::{Args, ValueEnum};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

#[derive(Args)]
#[command(after_help = "Examples:
  antirad render scenes/cornell_boxes.toml --output out/cornell
  antirad render bunny.obj --bins concentric:12 --tolerance 1e-3
  antirad render scenes/two_rooms.toml --camera main --target-error 0.05
  antirad render room.toml --cameras photos/transforms.json --camera r_0 --camera r_7
  antirad render room.toml --cameras photos/colmap
  antirad render room.toml --lamp panel=0 --lamp bulb=2,1.8,1.2
  antirad render out/fits/room/scene.toml --relight out/fits/room/relight.toml")]
pub struct Arguments {
    #[command(flatten)]
    settings: SceneSettings,
    /// Choose rays, bins, mesh and tolerance for this relative error of irradiance and pictures, e.g. 0.02
    #[arg(long, value_name = "ERROR", value_parser = parse_error, conflicts_with_all = ["bins", "tolerance"])]
    target_error: Option<f64>,
    /// Render this camera only; may be given several times [default: all cameras of the scene, or of --cameras]
    #[arg(long, value_name = "NAME")]
    camera: Vec<String>,
    /// Render the views of a set of photographs instead: a transforms.json (NeRF, Blender, instant-ngp, nerfstudio), or the folder of
    /// a COLMAP model. Each is a centred pinhole with the size and the horizontal field of view of its photograph
    #[arg(long, value_name = "PATH")]
    cameras: Option<PathBuf>,
    #[command(flatten)]
    relit: LampArguments,
    /// Cut triangles first where others stand on them or pass through them, near lamps, and where they reach further than light travels freely
    /// (auto), or solve the mesh as it is given (never). Files per triangle have means over those given
    #[arg(long, value_name = "WHEN", value_enum, default_value = "auto", conflicts_with = "target_error")]
    refine: Refine,
    /// Maximum number of triangles into which --target-error or --refine may subdivide the scene
    #[arg(long, value_name = "NUMBER", default_value_t = TargetErrorOptions::MAX_TRIANGLES)]
    max_triangles: usize,
    /// Folder for the results [default: out/SCENE]
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Exposure of the PNG in stops (0 shows radiance 1 as white), or auto
    #[arg(long, value_name = "STOPS|auto", default_value = "auto", allow_hyphen_values = true, value_parser = parse_exposure)]
    exposure: Exposure,
    /// Write linear instead of sRGB values to the PNG
    #[arg(long)]
    linear_png: bool,
    /// Gather direct light at each visible point and interpolate indirect light, or draw flat faces
    #[arg(long, value_name = "HOW", value_parser = word::<Shading>(SHADINGS), default_value = "gathered")]
    shading: Shading,
    /// What glossy faces mirror of other faces in gathered pictures: by rays from each visible point, as many as it takes; by the same
    /// number from each, as fits of materials see it; or out of direction bins, as fits of positions and cameras do
    #[arg(long, value_name = "HOW", value_parser = word::<Reflections>(REFLECTIONS), default_value = "rays")]
    reflections: Reflections,
    /// Samples along each side of a pixel: 1, 2, 4, 8 or 16; at edges of lamps 16
    #[arg(long, value_name = "NUMBER", default_value_t = 8)]
    supersample: u32,
}

/// When `render` cuts triangles before the solve.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Refine {
    Auto,
    Never,
}

pub fn parse_exposure(text: &str) -> Result<Exposure, String> {
    match text {
        "auto" => Ok(Exposure::Auto),
        _ => match text.parse::<f64>() {
            Ok(stops) if stops.is_finite() => Ok(Exposure::Stops(stops)),
            _ => Err("expected a number of stops, or auto".to_owned()),
        },
    }
}

/// Seconds by stage.
struct Stages {
    seconds: BTreeMap<&'static str, f64>,
    last: Instant,
}

impl Stages {
    fn new() -> Self {
        Self { seconds: BTreeMap::new(), last: Instant::now() }
    }

    fn end(&mut self, stage: &'static str) {
        *self.seconds.entry(stage).or_default() += self.last.elapsed().as_secs_f64();
        self.last = Instant::now();
    }
}

pub fn run(
    arguments: &Arguments,
    quiet: bool,
    verbose: u8,
    interrupt: &Interrupt,
    together: &Together,
) -> Result<(), Failure> {
    let mut stages = Stages::new();
    let mut scene = arguments.settings.load()?;
    let lamps = arguments.relit.apply(&mut scene)?;
    scene.target_error = arguments.target_error.or(scene.target_error);
    let cameras: Vec<Camera> = match &arguments.cameras {
        Some(set) => cameras::of_set(set, &arguments.camera)?,
        None => cameras::choose(&scene, &arguments.camera)?.into_iter().cloned().collect(),
    };
    let directory = arguments.output.clone().unwrap_or_else(|| Path::new("out").join(&scene.name));
    prepare_directory(&directory)?;
    stages.end("load");
    let options = arguments.settings.backend.options(arguments.settings.memory_budget);
    let backend = together.open(scene.settings.backend, options, interrupt)?;
    tracing::info!("backend {backend:?}, {} threads", backend.threads());
    let work = Work { arguments, quiet, interrupt, backend: &backend, cameras: &cameras };
    let given = scene.triangles.len();
    let rendered = match scene.target_error {
        Some(error) => work.within(error, &scene, &mut stages)?,
        None => {
            let cut = arguments.refine == Refine::Auto;
            let options = ResolveOptions::default().cut(cut).max_triangles(arguments.max_triangles);
            let resolved = resolved(scene, &options, interrupt)?;
            stages.end("refine");
            work.resolved(resolved, &mut stages)?
        }
    };
    let Rendered { scene, irradiance, radiosity, answer, refinement, engine, decisions } = rendered;
    let given_triangles = (scene.triangles.len() != given).then_some(given);
    let light = match arguments.shading {
        Shading::Face => Shown::Faces(answer.colours),
        Shading::Gathered => Shown::Gathered(Box::new(answer.light)),
    };
    let pictures = work.pictures(&scene, &light)?;
    stages.end("pictures");
    let ranks = RankReport::of_all(&backend, stages.seconds["solve"])?;
    if !together.speaks() {
        return Ok(());
    }
    if interrupt.is_set() {
        return Err(Failure::Interrupted);
    }

    let files = work.write_pictures(&directory, &pictures)?;
    write_rows(&directory, "irradiance.npy", &irradiance, scene.settings.precision)?;
    write_rows(&directory, "radiosity.npy", &radiosity, scene.settings.precision)?;
    stages.end("write");
    for warning in answer.warnings.above(told_from(arguments.target_error)) {
        let (kind, Warning { message, effect, remedy, .. }) = (warning.kind.name(), warning);
        tracing::warn!("{kind}: {message}; effect: {effect}; remedy: {remedy}");
    }
    let report = Report {
        scene: arguments.settings.mesh.file.scene.display().to_string(),
        version: env!("CARGO_PKG_VERSION"),
        backend: backend.kind(),
        device: DeviceReport::from(&backend),
        threads: backend.threads(),
        warnings: scene.warnings.clone(),
        accuracy_warnings: answer.warnings.list,
        plan: answer.plan,
        sampling_error: answer.sampling_error,
        ray_error: answer.ray_error,
        refinement,
        resolved: decisions,
        given_triangles,
        lamps: lamps.into_iter().map(LampReport::from).collect(),
        memory: MemoryUse::from(backend.memory()),
        ranks,
        solve: SolveReport::new(answer.info, scene.settings.tolerance),
        energy: answer.energy,
        negative_irradiance: answer.negative,
        reflections_error: pictures.iter().map(|drawn| (drawn.camera.name.clone(), drawn.error)).collect(),
        pictures: files,
        seconds: stages.seconds,
        kernels: backend.profile(),
    };
    // The report already has its memory use.
    drop(engine);
    write_json(&directory.join("report.json"), &report)?;
    if !quiet {
        summarise(&report, &directory, verbose);
    }
    let unphysical = report.accuracy_warnings.iter().any(|warning| warning.kind == Kind::Unphysical);
    let missed = report.refinement.as_ref().is_some_and(|refinement| !refinement.met);
    match report.solve.converged && !unphysical && !missed {
        true => Ok(()),
        false => Err(Failure::Code(EXIT_UNRELIABLE)),
    }
}

/// What all steps of a render use.
struct Work<'a> {
    arguments: &'a Arguments,
    quiet: bool,
    interrupt: &'a Interrupt,
    backend: &'a Backend,
    cameras: &'a [Camera],
}

/// The picture of a camera, and the standard error of what it shows mirrored.
struct DrawnPicture<'a> {
    camera: &'a Camera,
    picture: Picture,
    error: f64,
}

impl Work<'_> {
    /// Bytes that the largest picture of a scene takes of the memory budget.
    fn reserved(&self, scene: &Scene) -> Result<u64, ImageError> {
        let options = PictureOptions::default().supersample(self.arguments.supersample);
        let triangles = scene.triangles.len();
        let bytes = |camera| Rasterizer::bytes(self.backend.kind(), triangles, camera, &options);
        self.cameras.iter().try_fold(0, |most, camera| Ok(bytes(camera)?.max(most)))
    }

    /// Solves to a target error.
    fn within(&self, error: f64, scene: &Scene, stages: &mut Stages) -> Result<Rendered, Failure> {
        let Self { arguments, quiet, interrupt, backend, cameras } = *self;
        self.reserved(scene)?;
        let reserve = |scene: &Scene| self.reserved(scene).unwrap_or(u64::MAX);
        let options = TargetErrorOptions::new(error)
            .max_triangles(arguments.max_triangles)
            .cameras(cameras.to_vec())
            .shading(arguments.shading)
            .reflections(arguments.reflections);
        let bar = SolveBar::new(scene.settings.tolerance, quiet);
        let mut run = |engine: &mut Engine, scene: &Scene, stage: &Stage| {
            let part = bar.part(scene.settings.tolerance, &stage.name, stage.begin..stage.end);
            solve(engine, scene, &part, interrupt)
        };
        let refined =
            interrupt.while_computing(|| solve_within(backend, scene, &options, &reserve, &mut run));
        bar.finish();
        stages.end("solve");
        match refined {
            Ok(refined) => Ok(Rendered::refined(refined)),
            Err(error) if error.is_interruption() => Err(Failure::Interrupted),
            Err(error) => Err(error.into()),
        }
    }

    /// Solves a scene as it is resolved.
    fn resolved(&self, resolved: Resolved, stages: &mut Stages) -> Result<Rendered, Failure> {
        let Self { arguments, quiet, interrupt, backend, cameras } = *self;
        let scene = &resolved.scene;
        let options = PlanOptions::of(backend).pictures(self.reserved(scene)?);
        let working = Working::on("planning");
        let plan = interrupt.while_computing(|| Plan::new(scene, &options, &scene.settings))?;
        drop(working);
        tracing::info!("{}", plan.report());
        stages.end("plan");
        let working = Working::on("direct light and rays");
        let engine = interrupt.while_computing(|| Engine::new(backend, scene, plan));
        drop(working);
        let mut engine = engine.map_err(failure)?;
        stages.end("prepare");
        let bar = SolveBar::new(scene.settings.tolerance, quiet);
        let solved = solve(&mut engine, scene, &bar, interrupt);
        bar.finish();
        let solution = solved.or_else(best_iterate)?;
        stages.end("solve");
        let working = Working::on("looking for causes of errors");
        let warnings = interrupt.while_computing(|| Warnings::of(scene, engine.plan()));
        drop(working);
        stages.end("check");
        let _working = Working::on("gathering light");
        let answer = interrupt.while_computing(|| {
            Answer::new(&mut engine, scene, solution, cameras, arguments.reflections, warnings)
        })?;
        let (irradiance, radiosity) =
            (resolved.on_given(&answer.irradiance), resolved.on_given(&answer.radiosity));
        let Resolved { scene, decisions, .. } = resolved;
        let engine = Some(engine);
        Ok(Rendered { scene, irradiance, radiosity, answer, refinement: None, engine, decisions })
    }

    /// The pictures of all cameras. Ranks make them together.
    fn pictures(&self, scene: &Scene, light: &Shown) -> Result<Vec<DrawnPicture<'_>>, Failure> {
        let Self { arguments, interrupt, backend, cameras, .. } = *self;
        let _working = Working::on("pictures");
        let options = RenderOptions::default().supersample(arguments.supersample).shading(arguments.shading);
        let renderer = Renderer::new(backend, options.reflections(arguments.reflections))?;
        let draw = |(view, camera)| {
            let coverage = renderer.coverage(scene, camera)?;
            let gathered = renderer.pixels(light, view, &coverage)?;
            Ok(DrawnPicture { camera, picture: gathered.picture(&coverage), error: gathered.error })
        };
        interrupt.while_computing(|| cameras.iter().enumerate().map(draw).collect())
    }

    /// Writes each picture as EXR and PNG, and returns the names of the files.
    fn write_pictures(&self, directory: &Path, pictures: &[DrawnPicture]) -> Result<Vec<String>, Failure> {
        let Arguments { exposure, linear_png, .. } = self.arguments;
        let tone = ToneMap::default().exposure(*exposure).srgb(!linear_png);
        let (mut files, mut names) = (Vec::new(), FileNames::default());
        for DrawnPicture { camera, picture, .. } in pictures {
            let name = names.of(&camera.name);
            let [exr, png] = ["exr", "png"].map(|kind| format!("{name}.{kind}"));
            picture.write_exr(directory.join(&exr))?;
            picture.write_png(directory.join(&png), &tone)?;
            files.extend([exr, png]);
        }
        Ok(files)
    }
}

/// Writes values per triangle in the precision of the solve.
fn write_rows(directory: &Path, name: &str, rows: &[[f64; 3]], precision: Precision) -> Result<(), Failure> {
    match precision {
        Precision::F32 => {
            warn_of_range(rows, name);
            write_npy(&directory.join(name), &single(rows))?;
        }
        Precision::F64 => write_npy(&directory.join(name), rows)?,
    }
    Ok(())
}

/// A scene as solved, with results for the triangles of the scene as given.
struct Rendered {
    scene: Scene,
    irradiance: Vec<[f64; 3]>,
    radiosity: Vec<[f64; 3]>,
    answer: Answer,
    refinement: Option<Refinement>,
    /// `None` if the solve has dropped it.
    engine: Option<Engine>,
    /// What was decided before the solve, without a target error.
    decisions: Vec<Decision>,
}

impl Rendered {
    fn refined(solved: Solved) -> Self {
        let irradiance = solved.on_given(&solved.answer.irradiance);
        let radiosity = solved.on_given(&solved.answer.radiosity);
        let Solved { scene, answer, refinement, .. } = solved;
        Self {
            scene,
            irradiance,
            radiosity,
            answer,
            refinement: Some(refinement),
            engine: None,
            decisions: Vec::new(),
        }
    }
}

/// The best iterate of a solve without convergence, which is logged as an error.
fn best_iterate(error: EngineError) -> Result<Solution, Failure> {
    let message = error.to_string();
    let best = error.into_best().map_err(failure)?;
    tracing::error!("{message}. The results are those of the best iterate, which is NOT CONVERGED");
    Ok(*best)
}

/// Warns of values beyond the range of f32, which files hold as infinity.
fn warn_of_range(rows: &[[f64; 3]], name: &str) {
    if rows.iter().flatten().any(|&value| !(value as f32).is_finite()) {
        tracing::warn!(
            "{name} has values beyond 3.4e38, written as infinity in f32: state emission in a larger unit"
        );
    }
}

fn failure(error: EngineError) -> Failure {
    if error.is_interruption() { Failure::Interrupted } else { error.into() }
}

fn solve(
    engine: &mut Engine,
    scene: &Scene,
    bar: &SolveBar,
    interrupt: &Interrupt,
) -> Result<Solution, EngineError> {
    let params = SolveParams::from(&scene.settings);
    let reached = Arc::new(Mutex::new((0, 1.0)));
    let (within, shared, stop) = (bar.clone(), reached.clone(), interrupt.clone());
    engine.set_pass_callback(Some(Box::new(move |done, total| {
        let (passes, residual) = *shared.lock().unwrap_or_else(PoisonError::into_inner);
        within.show(passes, residual, done as f64 / total.max(1) as f64);
        stop.flow()
    })));
    let solved = engine.solve_with(&params, &mut |passes, residual| {
        *reached.lock().unwrap_or_else(PoisonError::into_inner) = (passes, residual);
        tracing::info!("pass {passes}: relative residual {residual:.3e}");
        bar.show(passes, residual, 0.0);
        interrupt.flow()
    });
    engine.set_pass_callback(None);
    solved
}

fn summarise(report: &Report, directory: &Path, verbose: u8) {
    let solve = &report.solve;
    let residual = solve.residuals.last().copied().unwrap_or(0.0);
    let sum = |rgb: [f64; 3]| rgb.iter().sum::<f64>();
    let (emitted, absorbed) = (sum(report.energy.emitted), sum(report.energy.absorbed));
    antirad::say!(
        "backend     {} on {} ({}), {} threads",
        report.backend,
        report.device.name,
        report.device.driver,
        report.threads
    );
    antirad::say!(
        "{}      {} triangles in {} passes to {residual:.1e}, {:.2} s",
        if solve.converged { "solved" } else { "NOT CONVERGED" },
        report.plan.triangles,
        solve.passes,
        report.seconds.get("solve").copied().unwrap_or(0.0)
    );
    if let Some(given) = report.given_triangles {
        antirad::say!(
            "mesh        cut from {given} triangles, where light varies within them; files per triangle have means over those (--refine=never: as given)"
        );
    }
    if !report.lamps.is_empty() {
        let each: Vec<String> = report.lamps.iter().map(LampReport::to_string).collect();
        antirad::say!("relit       {}", each.join(", "));
    }
    let lamps = &report.plan.lamps;
    if lamps.emitters > lamps.exact {
        let error = match lamps.sampled {
            0 => String::new(),
            _ => format!(": standard error {:.2} % of it", 100.0 * report.sampling_error),
        };
        antirad::say!("lamps       {}{error} (--lamps exact: exact all the same)", lamps.why);
    }
    if let Some(rays) = &report.ray_error {
        let [mean, median, worst] = [rays.mean, rays.median, rays.worst_tenth].map(|error| 100.0 * error);
        antirad::say!(
            "rays        {} of a triangle on average: standard error {mean:.2} % of mean irradiance (median {median:.2} %, worst tenth {worst:.2} %)",
            rays.of_each()
        );
    }
    antirad::say!("directions  {} bins", report.plan.bins);
    for class in &report.plan.classes {
        antirad::say!("            {} triangles: {} ({})", class.triangles, class.modelled, class.why);
    }
    let noise = report.reflections_error.values().fold(0.0, |most: f64, error| most.max(*error));
    if noise > 0.0 {
        antirad::say!("mirrored    by rays: standard error {:.2} % of a picture", 100.0 * noise);
    }
    if let Some(refinement) = &report.refinement {
        for (step, number) in refinement.steps.iter().zip(1..) {
            antirad::say!("step {number:<6} {step}");
        }
        for reason in &refinement.why {
            antirad::say!("            {reason}");
        }
        let verdict = if refinement.met { "kept" } else { "NOT KEPT" };
        antirad::say!(
            "target      {:.2} % requested: {verdict} by step {}",
            100.0 * refinement.error,
            refinement.chosen + 1
        );
    }
    if emitted > 0.0 {
        let share = |watts: f64| 100.0 * watts / emitted;
        let [absorbed, escaped] = [absorbed, sum(report.energy.escaped)].map(share);
        let lost = match report.energy.on_backs.map(sum).map(share) {
            None => format!("{escaped:.2} % escaped or on black backs"),
            Some(on_backs) => format!(
                "{on_backs:.2} % on black backs, {escaped:.2} % escaped, {:+.2} % unaccounted for",
                share(sum(report.energy.unaccounted))
            ),
        };
        antirad::say!("energy      {emitted:.4} W emitted, {absorbed:.2} % absorbed, {lost}");
    } else {
        antirad::say!("energy      nothing emits: the picture is black");
    }
    let negative = report.negative_irradiance;
    if negative.triangles > 0 {
        antirad::say!("negative    {} triangles, down to {:.3e} W/m²", negative.triangles, negative.minimum);
    }
    let told = || report.accuracy_warnings.iter().filter(|warning| warning.effect.exceeds(MATTERS));
    if told().next().is_some() {
        let each = told().map(|w| format!("{} ({})", w.kind.name(), w.count));
        antirad::say!("warnings    {}: see `antirad check`", each.collect::<Vec<_>>().join(", "));
    }
    antirad::say!(
        "memory      {} at the peak, of a budget of {}",
        Bytes(report.memory.peak),
        Bytes(report.memory.budget)
    );
    for (rank, share) in report.ranks.iter().enumerate().filter(|_| report.ranks.len() > 1) {
        antirad::say!("rank {rank:<6} {share}");
    }
    if verbose > 0 {
        for k in &report.kernels {
            antirad::say!("kernel      {k}");
        }
    }
    antirad::say!("written     {}", directory.display());
    for file in
        report.pictures.iter().map(String::as_str).chain(["irradiance.npy", "radiosity.npy", "report.json"])
    {
        antirad::say!("            {}", directory.join(file).display());
    }
}
