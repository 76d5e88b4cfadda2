//! Runs a fit: steps, stopping rule, checkpoints.

use super::checkpoint::{CheckpointError, Checkpoints, Identity};
use super::exposure::Sensor;
use super::lock::LockError;
use super::loss::{Loss, LossKind, PictureLoss};
use super::optimiser::{
    Adam, CoarseHessian, KnownHessian, LeastSquares, Optimiser, QuasiNewton, QuasiNewtonOptions, Step,
    StepError,
};
use super::parameters::{Fit, Groups, ParameterError, Parameters, Per, Recovered};
use super::problem::{Evaluation, Problem};
use super::regulariser::Regularisers;
use super::renderer::{CostEstimate, RenderError, Renderer};
use super::segments::segments;
use super::settings::{OptimiserKind, Settings, StopRule};
use super::target::Target;
use super::trail::Trail;
use antirad_base::output::OutputError;
use antirad_base::setters;
use antirad_render::image::ImageError;
use antirad_render::render::Quantity;
use antirad_scene::{Camera, Scene, SceneError};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Why a fit has no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// The job file or its scene is invalid.
    #[error(transparent)]
    Input(#[from] SceneError),
    /// The unknowns do not match the scene.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// A regulariser does not apply to anything fitted.
    #[error("{message}")]
    Regulariser {
        /// Index of the regulariser, from 0.
        index: usize,
        /// What is wrong with it.
        message: String,
    },
    /// The settings contradict each other; the message says how.
    #[error("{0}")]
    Settings(String),
    /// A picture or its derivative could not be computed.
    #[error(transparent)]
    Render(RenderError),
    /// The optimiser failed.
    #[error("{0}")]
    Optimiser(String),
    /// A checkpoint could not be read or written.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The folder could not be locked.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// A result could not be written.
    #[error(transparent)]
    Write(#[from] OutputError),
    /// A picture could not be written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Interrupted, after a checkpoint was written if there is a folder for it.
    #[error("interrupted after iteration {iteration}")]
    Interrupted {
        /// The last finished iteration.
        iteration: u32,
    },
}

impl FitError {
    /// Whether another attempt may succeed: what failed is the machine (a full disk, a lost device, a folder in use, a rank that has ended),
    /// not the job.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Render(error) => error.may_pass(),
            Self::Write(_) | Self::Lock(_) | Self::Checkpoint(CheckpointError::Read { .. }) => true,
            Self::Image(error) => error.may_pass(),
            Self::Input(_)
            | Self::Parameter(_)
            | Self::Regulariser { .. }
            | Self::Settings(_)
            | Self::Optimiser(_)
            | Self::Checkpoint(_) => false,
            Self::Interrupted { .. } => true,
        }
    }
}

impl From<RenderError> for FitError {
    fn from(error: RenderError) -> Self {
        Self::Render(error)
    }
}

/// Relative noise of the loss per tolerance of the solve: a solve stops somewhere below its tolerance, and similarly at
/// nearby points.
const NOISE_OF_TOLERANCE: f64 = 0.1;

/// Relative noise of the loss from sampling pixels where objects or cameras move: edges pass samples one by one, while derivatives
/// are those of exact areas.
const NOISE_OF_SAMPLES: f64 = 1e-4;

/// Iterations over which the decrease is measured: a single one may be small by chance, and Adam is not monotone.
const DECREASE_OVER: usize = 5;
const DECREASE_OVER_ADAM: usize = 50;
/// How many times the decrease that the model promises must be small for a fit to end after one small decrease.
const PROMISED: f64 = 10.0;

/// Why a fit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// The limit on iterations is reached.
    Iterations,
    /// The relative decrease of the loss is below the limit.
    RelativeDecrease,
    /// The projected gradient is below the limit.
    Gradient,
    /// The target loss is reached.
    Loss,
    /// The time limit is reached.
    Seconds,
    /// No lower loss could be found: a minimum, within rounding.
    NoProgress,
}

impl Stop {
    /// The reason in words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Iterations => "the iteration limit is reached",
            Self::RelativeDecrease => "the loss has stopped decreasing",
            Self::Gradient => "the gradient has vanished",
            Self::Loss => "the target loss is reached",
            Self::Seconds => "the time limit is reached",
            Self::NoProgress => "no lower loss can be found",
        }
    }
}

/// One iteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// 0 is the start.
    pub iteration: u32,
    /// Loss including regularisers.
    pub loss: f64,
    /// Maximum norm of the projected gradient, by the unknowns.
    pub gradient: f64,
    /// Largest change of an unknown, in units of its scale.
    pub step: f64,
    /// Evaluations of loss and gradient.
    pub evaluations: u32,
    /// Passes (applications of U).
    pub passes: u64,
    /// Whether it is of a stage in smaller pictures, which has an iteration 0 for each of its starts and is in no history.
    #[serde(skip)]
    pub first_stage: bool,
}

impl Record {
    fn of(iteration: u32, step: &Step, passes: u64) -> Self {
        let Step { value: loss, gradient, length: step, evaluations, .. } = *step;
        Self { iteration, loss, gradient, step, evaluations, passes, first_stage: false }
    }
}

/// The progress of a fit, as stored in a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitProgress {
    pub(super) optimiser: Optimiser,
    trail: Trail,
    /// One entry per iteration, the start first.
    pub history: Vec<Record>,
    /// Time of all runs together, s.
    pub seconds: f64,
    /// Why it ended, if it has.
    pub finished: Option<Stop>,
}

impl FitProgress {
    pub(super) fn new(optimiser: Optimiser) -> Self {
        Self { optimiser, trail: Trail::default(), history: Vec::new(), seconds: 0.0, finished: None }
    }

    /// Finished iterations.
    pub fn iteration(&self) -> u32 {
        self.history.last().map_or(0, |record| record.iteration)
    }

    /// The latest loss.
    pub(super) fn loss(&self) -> f64 {
        self.history.last().map_or(f64::INFINITY, |record| record.loss)
    }

    pub(super) fn stop(&self, rule: &StopRule) -> Option<Stop> {
        let last = self.history.last()?;
        if last.loss <= rule.loss {
            return Some(Stop::Loss);
        }
        let start = self.history.first().map_or(0.0, |first| first.gradient);
        if last.gradient <= rule.gradient * start {
            return Some(Stop::Gradient);
        }
        let measured = rule.relative_decrease > 0.0;
        let is_small = |decrease: f64| measured && decrease < rule.relative_decrease * last.loss.abs();
        if let [.., before, last] = &self.history[..]
            && is_small(before.loss - last.loss)
            && is_small(PROMISED * self.optimiser.promise())
        {
            return Some(Stop::RelativeDecrease);
        }
        let over = match self.optimiser {
            Optimiser::Adam(_) => DECREASE_OVER_ADAM,
            Optimiser::QuasiNewton(_) | Optimiser::LeastSquares(_) => DECREASE_OVER,
        };
        let least = |records: &[Record]| records.iter().map(|r| r.loss).fold(f64::INFINITY, f64::min);
        if let Some(at) = self.history.len().checked_sub(over).filter(|at| *at > 0) {
            let (before, now) = (least(&self.history[..at]), least(&self.history[at..]));
            if measured && before - now < rule.relative_decrease * before.abs() {
                return Some(Stop::RelativeDecrease);
            }
        }
        if last.iteration >= rule.iterations {
            return Some(Stop::Iterations);
        }
        (self.seconds >= rule.seconds).then_some(Stop::Seconds)
    }
}

/// What to do if an earlier run left a checkpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnCheckpoint {
    /// Fail: it may hold hours of work.
    #[default]
    Refuse,
    /// Continue from it.
    Resume,
    /// Remove it and start over.
    Discard,
}

/// How to run a job.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RunOptions {
    /// Folder for checkpoints; `None`: none are written. If other processes may use that folder, take a
    /// [`FolderLock`](super::FolderLock) first.
    pub checkpoints: Option<PathBuf>,
    /// Iterations between checkpoints.
    pub checkpoint_every: u32,
    /// What to do about an existing checkpoint.
    pub on_checkpoint: OnCheckpoint,
    /// When the fit ends.
    pub stop: StopRule,
}

setters!(RunOptions {
    checkpoints: Option<PathBuf>,
    checkpoint_every: u32,
    on_checkpoint: OnCheckpoint,
    stop: StopRule,
});

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            checkpoints: None,
            checkpoint_every: 5,
            on_checkpoint: OnCheckpoint::Refuse,
            stop: StopRule::default(),
        }
    }
}

/// The result of a fit.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Why it ended.
    pub stop: Stop,
    /// The iteration that this run continued from, if any.
    pub resumed_from: Option<u32>,
    /// One entry per iteration, the start first.
    pub history: Vec<Record>,
    /// Time of all runs together, s.
    pub seconds: f64,
    /// The scene with the fitted values. Its cameras are its own, and those of the targets under their names.
    pub scene: Scene,
    /// The fitted values, with the material, mesh or triangle of each.
    pub recovered: Vec<Recovered>,
    /// Final pictures per view, linear RGB, row by row from the top, W/(m² sr).
    pub pictures: Vec<Vec<DVec3>>,
    /// What makes the numbers of each target from radiance.
    #[doc(hidden)]
    pub sensors: Vec<Sensor>,
    /// Final loss including regularisers.
    pub loss: f64,
    /// Final loss per view, before weights.
    pub views: Vec<f64>,
    /// Final value per regulariser, with its weight; at the end that of responses, if they were unknown.
    #[doc(hidden)]
    pub assumptions: Vec<f64>,
}

impl Outcome {
    /// Final pictures per view in the numbers of their targets: by gains and responses.
    #[doc(hidden)]
    pub fn exposed(&self) -> Vec<Vec<DVec3>> {
        self.pictures.iter().zip(&self.sensors).map(|(picture, sensor)| sensor.numbers(picture)).collect()
    }
}

/// A validated fit, ready to run.
pub struct Job {
    /// Name, for messages and files.
    pub name: String,
    pub(super) problem: Problem,
    pub(super) settings: Settings,
    identity: Identity,
    /// The scene's own cameras; in a fit it has those of the targets.
    cameras: Vec<Camera>,
}

impl Job {
    /// A job from a scene and its targets in memory. [`JobFile`](super::JobFile) reads one from a file.
    ///
    /// # Errors
    /// Fails if there is no target or nothing to fit, if a fit or a regulariser does not apply to the scene,
    /// or if the optimiser does not suit the job.
    pub fn new(
        name: impl Into<String>,
        scene: Scene,
        targets: Vec<Target>,
        settings: Settings,
    ) -> Result<Self, FitError> {
        let refuse = |message: &str| Err(FitError::Settings(message.to_owned()));
        if targets.is_empty() {
            return refuse("there is no target; give at least one picture");
        }
        if settings.fits.is_empty() {
            return refuse("there is nothing to fit; give at least one quantity");
        }
        let mut scene = scene;
        let views = targets.iter().map(|target| target.camera.clone()).collect();
        let cameras = std::mem::replace(&mut scene.cameras, views);
        scene.cameras.iter().try_for_each(Camera::check)?;
        let mut settings = settings;
        for (fit, what) in settings.fits.iter_mut().enumerate() {
            what.groups =
                groups(what, &scene, &targets).map_err(|message| ParameterError { fit, message })?;
        }
        // The solve settings stay the same from the first iteration to the last.
        scene.target_error = None;
        scene.settings.tolerance = settings.tolerance.unwrap_or(scene.settings.tolerance.min(1e-5));
        let identity = identity(&scene, &targets, &settings).map_err(|error| {
            FitError::Settings(format!("the job's identity cannot be serialised: {error}"))
        })?;
        let parameters = Parameters::new(&scene, &settings.fits, brightness(&scene, &targets))?;
        let regularisers = Regularisers::new(&settings.regularisers, &parameters)
            .map_err(|(index, message)| FitError::Regulariser { index, message })?;
        let mut loss = Loss::new(settings.loss, &targets);
        loss.epsilon = settings.epsilon.unwrap_or(loss.epsilon);
        loss.threshold = settings.threshold.unwrap_or(loss.threshold);
        let is_smooth = !matches!(settings.loss, LossKind::L1 | LossKind::LogL1);
        let is_open = |target: &Target| target.exposure.is_fitted() || target.response.is_some();
        if !is_smooth && targets.iter().any(is_open) {
            return refuse(
                "exposures and responses are fitted by a smooth loss; use huber, relative-l2 or l2",
            );
        }
        let problem = Problem { parameters, targets, loss: Arc::new(loss), regularisers };
        let job = Self { name: name.into(), problem, settings, identity, cameras };
        if job.settings.optimiser == OptimiserKind::LeastSquares && !job.is_quadratic() {
            return refuse(
                "least-squares fits emission alone, with the loss l2 or relative-l2; use quasi-newton instead",
            );
        }
        Ok(job)
    }

    /// Replaces the loss of the settings. Checkpoints do not record it: resume with the same one.
    pub fn set_loss(&mut self, loss: Box<dyn PictureLoss + Send + Sync>) {
        self.problem.loss = loss.into();
    }

    /// The objective.
    #[doc(hidden)]
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// The settings of the fit.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    fn is_quadratic(&self) -> bool {
        let is_plain = |target: &Target| {
            target.clip.is_none() && !target.exposure.is_fitted() && target.response.is_none()
        };
        let quadratic = self.problem.loss.is_quadratic() && self.problem.targets.iter().all(is_plain);
        self.problem.parameters.is_linear() && quadratic
    }

    /// The optimiser that will be used, never [`OptimiserKind::Auto`].
    #[doc(hidden)]
    pub fn optimiser(&self) -> OptimiserKind {
        match self.settings.optimiser {
            OptimiserKind::Auto if self.is_quadratic() && self.settings.loss == LossKind::L2 => {
                OptimiserKind::LeastSquares
            }
            OptimiserKind::Auto => OptimiserKind::QuasiNewton,
            kind => kind,
        }
    }

    pub(super) fn new_optimiser(&self) -> Optimiser {
        self.optimiser_from(self.problem.parameters.start().to_vec())
    }

    fn optimiser_from(&self, x: Vec<f64>) -> Optimiser {
        let bounds = self.problem.parameters.bounds().clone();
        match self.optimiser() {
            OptimiserKind::Adam => Optimiser::Adam(Adam::new(x, bounds, self.settings.adam)),
            OptimiserKind::LeastSquares => Optimiser::LeastSquares(LeastSquares::new(x, bounds)),
            OptimiserKind::QuasiNewton | OptimiserKind::Auto => {
                let parameters = &self.problem.parameters;
                let of_solve = NOISE_OF_TOLERANCE * parameters.base().settings.tolerance;
                let of_samples =
                    if parameters.gradient_request().geometry() { NOISE_OF_SAMPLES } else { 0.0 };
                let noise = self.settings.noise.unwrap_or(of_solve.max(of_samples));
                let options = QuasiNewtonOptions { noise, ..self.settings.quasi_newton };
                Optimiser::QuasiNewton(QuasiNewton::new(x, bounds, options))
            }
        }
    }

    /// Estimated cost of an iteration, and bytes of host memory for the optimiser.
    ///
    /// # Errors
    /// Fails if the scene cannot be rendered.
    #[doc(hidden)]
    pub fn estimate(&self, renderer: &mut dyn Renderer) -> Result<(CostEstimate, u64), FitError> {
        let estimate = renderer.estimate(&self.problem.parameters.planning_scene())?;
        let targets: u64 = self.problem.targets.iter().map(|t| 24 * 4 * t.pixels.len() as u64).sum();
        Ok((estimate, targets + self.new_optimiser().bytes(self.problem.parameters.len())))
    }

    /// The progress of an earlier run to continue from; `None` for a new start.
    ///
    /// # Errors
    /// Fails if a checkpoint exists that would be overwritten, or if one cannot be read or belongs to another
    /// job.
    pub fn progress(
        &self,
        directory: &Path,
        on_checkpoint: OnCheckpoint,
    ) -> Result<Option<FitProgress>, FitError> {
        let checkpoints = Checkpoints::new(directory);
        match on_checkpoint {
            OnCheckpoint::Refuse => Ok(checkpoints.refuse().map(|()| None)?),
            OnCheckpoint::Resume => Ok(checkpoints.read(&self.identity)?),
            OnCheckpoint::Discard => Ok(None),
        }
    }

    /// Runs the job. `watch` is called after every iteration, including the start (iteration 0), and may stop it. A job that was
    /// interrupted or killed, or that failed, goes on with [`OnCheckpoint::Resume`] and reaches the same result.
    ///
    /// # Errors
    /// Fails if a checkpoint is refused or cannot be read or written, if pictures or their derivatives cannot
    /// be computed, if the optimiser cannot take a step, or if the renderer or `watch` interrupts.
    pub fn run(
        &mut self,
        renderer: &mut dyn Renderer,
        options: &RunOptions,
        watch: &mut dyn FnMut(&Record, &FitProgress) -> ControlFlow<()>,
    ) -> Result<Outcome, FitError> {
        let checkpoints = options.checkpoints.as_deref().map(Checkpoints::new);
        let mut progress = FitProgress::new(self.new_optimiser());
        let (mut resumed_from, mut finished_before) = (None, None);
        if let (Some(directory), Some(checkpoints)) = (&options.checkpoints, &checkpoints) {
            if let Some(stored) = self.progress(directory, options.on_checkpoint)? {
                resumed_from = Some(stored.iteration());
                finished_before = stored.finished;
                progress = stored;
                // The stopping rule may differ now, for example allow more iterations.
                progress.finished = progress.finished.filter(|stop| *stop == Stop::NoProgress);
            } else {
                checkpoints.clear()?;
            }
        }
        if resumed_from.is_none() && self.settings.scale_emission {
            let start = self.problem.parameters.start();
            let x = self.problem.scaled_emission(start, renderer).map_err(before_the_first)?;
            progress = FitProgress::new(self.optimiser_from(x));
        }
        let mut coarse = None;
        if resumed_from.is_none() && self.problem.parameters.gradient_request().camera {
            let x;
            (x, coarse) = self.coarse_poses(progress.optimiser.best(), renderer, watch)?;
            progress = FitProgress::new(self.optimiser_from(x));
        }
        if resumed_from.is_none() && self.problem.parameters.has_textures() {
            let x;
            (x, coarse) = self.coarse_start(progress.optimiser.best(), renderer, watch)?;
            progress = FitProgress::new(self.optimiser_from(x));
        }
        let mut clock = Instant::now();
        let mut store = |progress: &mut FitProgress| -> Result<(), FitError> {
            progress.seconds += clock.elapsed().as_secs_f64();
            clock = Instant::now();
            match &checkpoints {
                Some(checkpoints) => Ok(checkpoints.write(&self.identity, progress)?),
                None => Ok(()),
            }
        };
        // What is reached so far is kept, if there is anything to lose.
        let ended = |error: Option<FitError>,
                     progress: &mut FitProgress,
                     store: &mut dyn FnMut(&mut FitProgress) -> Result<(), FitError>| {
            let iteration = progress.iteration();
            let stored = if iteration > resumed_from.unwrap_or(0) { store(progress) } else { Ok(()) };
            match (error, stored) {
                (None, stored) => stored.and(Err(FitError::Interrupted { iteration })),
                (Some(error), Ok(())) => Err(error),
                (Some(error), Err(also)) => {
                    tracing::warn!("no checkpoint of iteration {iteration} could be written either: {also}");
                    Err(error)
                }
            }
        };
        let cause = |error: RenderError| match error {
            RenderError::Interrupted => None,
            error => Some(error.into()),
        };
        if let Err(error) = progress.trail.retrace(&self.problem, renderer) {
            return ended(cause(error), &mut progress, &mut store);
        }
        let stop = loop {
            if let Some(stop) = progress.finished.or_else(|| progress.stop(&options.stop)) {
                break stop;
            }
            let record =
                match advance(&self.problem, &self.settings, coarse.as_ref(), &mut progress, renderer) {
                    Ok(Some(record)) => record,
                    // A step without progress is not an iteration.
                    Ok(None) => break Stop::NoProgress,
                    Err(StepError::Objective(error)) => {
                        return ended(cause(error), &mut progress, &mut store);
                    }
                    Err(error) => {
                        let error = Some(FitError::Optimiser(error.to_string()));
                        return ended(error, &mut progress, &mut store);
                    }
                };
            if watch(&record, &progress).is_break() {
                return ended(None, &mut progress, &mut store);
            }
            if record.iteration > 0 && record.iteration.is_multiple_of(options.checkpoint_every.max(1)) {
                store(&mut progress)?;
            }
        };
        progress.finished = Some(stop);
        if resumed_from != Some(progress.iteration()) || finished_before != Some(stop) {
            store(&mut progress)?;
        }
        let judged = match self.problem.judge(progress.optimiser.best(), renderer) {
            Err(RenderError::Interrupted) => {
                return Err(FitError::Interrupted { iteration: progress.iteration() });
            }
            judged => judged?,
        };
        Ok(Outcome {
            stop,
            resumed_from,
            seconds: progress.seconds,
            recovered: self.problem.parameters.recovered(progress.optimiser.best()),
            history: progress.history,
            scene: self.with_all_cameras(judged.scene)?,
            pictures: judged.pictures,
            sensors: judged.sensors,
            loss: judged.value,
            views: judged.views,
            assumptions: judged.assumptions,
        })
    }
}

impl Job {
    /// A scene of the fit with the scene's own cameras again, and those of its views under their names, numbered where others have taken
    /// them.
    fn with_all_cameras(&self, scene: Scene) -> Result<Scene, SceneError> {
        let mut named: Vec<Camera> = Vec::new();
        for (target, found) in self.problem.targets.iter().zip(&scene.cameras) {
            let name = &target.camera.name;
            let is_free = |name: &String| self.cameras.iter().all(|own| own.name != *name);
            let numbered = (2u64..).map(|n| format!("{name}_{n}")).filter(is_free);
            for name in std::iter::once(name.clone()).chain(numbered) {
                let camera = Camera { name, ..found.clone() };
                match named.iter().find(|other| other.name == camera.name) {
                    Some(other) if *other != camera => {}
                    Some(_) => break,
                    None => {
                        named.push(camera);
                        break;
                    }
                }
            }
        }
        let mut scene = Scene { cameras: self.cameras.clone(), ..scene };
        named.into_iter().try_for_each(|camera| scene.set_camera(camera))?;
        Ok(scene)
    }
}

/// Groups of a fit: those stated, or where targets decide them segments of triangles, or the cameras of each set of photographs.
fn groups(fit: &Fit, scene: &Scene, targets: &[Target]) -> Result<Option<Groups>, String> {
    match (fit.quantity, fit.per) {
        _ if fit.groups.is_some() => Ok(fit.groups.clone()),
        (Quantity::Camera, _) if fit.together => Ok(Some(sets(targets))),
        (_, Per::Segment) => segments(scene, targets),
        _ => Ok(None),
    }
}

/// The views of each set of photographs, by name; single pictures are one set.
fn sets(targets: &[Target]) -> Groups {
    let mut sets: Groups = Vec::new();
    for (view, target) in (0..).zip(targets) {
        let name = target.set.as_deref().unwrap_or("pictures");
        match sets.iter_mut().find(|(known, _)| known == name) {
            Some((_, views)) => views.push(view),
            None => sets.push((name.to_owned(), vec![view])),
        }
    }
    sets
}

/// What an error before the first iteration means to a fit.
pub(super) fn before_the_first(error: RenderError) -> FitError {
    match error {
        RenderError::Interrupted => FitError::Interrupted { iteration: 0 },
        error => error.into(),
    }
}

/// The start, or the next iteration, which it adds to the history; `None` where no progress can be made. `coarse`: what is known of the
/// Hessian at the start.
pub(super) fn advance(
    problem: &Problem,
    settings: &Settings,
    coarse: Option<&CoarseHessian>,
    progress: &mut FitProgress,
    renderer: &mut dyn Renderer,
) -> Result<Option<Record>, StepError<RenderError>> {
    let (record, advanced) = match progress.history.is_empty() {
        true => (start(problem, progress, renderer)?, true),
        false => step(problem, settings, coarse, progress, renderer)?,
    };
    if !advanced {
        return Ok(None);
    }
    progress.history.push(record);
    Ok(Some(record))
}

/// The start, as iteration 0.
fn start(
    problem: &Problem,
    progress: &mut FitProgress,
    renderer: &mut dyn Renderer,
) -> Result<Record, StepError<RenderError>> {
    let passes = renderer.passes();
    let FitProgress { optimiser, trail, .. } = progress;
    let step = optimiser.start(&mut |x| evaluate(problem, x, trail, renderer))?;
    Ok(Record::of(0, &step, renderer.passes() - passes))
}

/// The objective and its gradient.
fn evaluate(
    problem: &Problem,
    x: &[f64],
    trail: &mut Trail,
    renderer: &mut dyn Renderer,
) -> Result<(f64, Vec<f64>), RenderError> {
    let moves = problem.parameters.gradient_request().positions;
    // Light from before the vertices moved would be no start.
    if moves {
        renderer.forget();
    }
    let Evaluation { value, gradient, .. } =
        trail.follow(x, !moves, renderer, |renderer| problem.evaluate(x, renderer))?;
    Ok((value, gradient))
}

/// The next iteration, and whether it made progress.
fn step(
    problem: &Problem,
    settings: &Settings,
    coarse: Option<&CoarseHessian>,
    progress: &mut FitProgress,
    renderer: &mut dyn Renderer,
) -> Result<(Record, bool), StepError<RenderError>> {
    let passes = renderer.passes();
    if progress.trail.is_long() {
        renderer.forget();
        progress.trail.clear();
    }
    let renderer = RefCell::new(renderer);
    let trail = RefCell::new(progress.trail.clone());
    let moves = problem.parameters.gradient_request().positions;
    let step = progress.optimiser.step(
        &mut |x| evaluate(problem, x, &mut trail.borrow_mut(), &mut **renderer.borrow_mut()),
        &mut |p| {
            // Leaves light that is no start for that of others.
            trail.borrow_mut().clear();
            problem.curvature(p, &mut **renderer.borrow_mut())
        },
        &mut |x| {
            let renderer = &mut **renderer.borrow_mut();
            if settings.gauss_newton == 0 {
                return Ok(None);
            }
            // It renders the point again, which costs a renderer nothing that keeps its latest pictures.
            trail.borrow_mut().follow(x, !moves, renderer, |renderer| {
                if problem.gauss_newton_pictures() > settings.gauss_newton {
                    let diagonal = problem.own_curvature(x, coarse.is_none(), renderer)?;
                    return Ok(diagonal.map(|diagonal| KnownHessian::Diagonal(diagonal, coarse.cloned())));
                }
                Ok(problem.gauss_newton(x, renderer)?.map(KnownHessian::Whole))
            })
        },
    )?;
    progress.trail = trail.into_inner();
    let passes = renderer.borrow().passes() - passes;
    Ok((Record::of(progress.iteration() + 1, &step, passes), step.progress))
}

/// A typical radiance of lamps: the maximum in the scene's emission, of what suns light, or in a target.
fn brightness(scene: &Scene, targets: &[Target]) -> f64 {
    let suns = scene.suns.iter().flat_map(|sun| sun.irradiance.map(|h| h / PI));
    let emitted = scene.materials.iter().flat_map(|m| m.emission).chain(suns).fold(0.0, f64::max);
    let seen = |target: &Target| {
        let pixels = target.pixels.iter().enumerate().filter(|(at, _)| target.mask_at(*at) > 0.0);
        pixels.map(|(_, pixel)| pixel.max_element()).fold(0.0, f64::max)
    };
    let brightest = targets.iter().map(seen).fold(emitted, f64::max);
    if brightest > 0.0 { brightest } else { 1.0 }
}

fn identity(scene: &Scene, targets: &[Target], settings: &Settings) -> Result<Identity, postcard::Error> {
    let mut identity = Identity::default();
    identity.add("the job's settings", settings)?;
    let vertices: Vec<[f64; 3]> = scene.vertices.iter().map(|v| v.to_array()).collect();
    let triangles: Vec<([u32; 3], u32)> = scene.triangles.iter().map(|t| (t.vertices, t.material)).collect();
    // `Debug` prints all digits of a number.
    let rest = format!("{:?} {:?} {:?} {:?}", scene.meshes, scene.materials, scene.suns, scene.settings);
    identity.add("the scene", &(vertices, triangles, rest))?;
    for (number, target) in targets.iter().enumerate() {
        let what = format!("target {} (camera \"{}\")", number + 1, target.camera.name);
        let pixels: Vec<[f64; 3]> = target.pixels.iter().map(|p| p.to_array()).collect();
        identity.add(
            what,
            &(
                format!("{:?}", target.camera),
                pixels,
                &target.mask,
                target.weight,
                (target.clip, &target.bounds),
                (target.exposure, target.response, target.noise),
            ),
        )?;
    }
    Ok(identity)
}
