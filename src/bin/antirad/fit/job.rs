//! One job of a batch, from its file to its results.

use super::Arguments;
use super::batch::Found;
use super::log::Log;
use super::pool::Budget;
use super::summary::{Ended, Row};
use crate::together::Together;
use antirad::Watch;
use antirad::backend::Backend;
use antirad::cli::{self, Interrupt};
use antirad::fit::{
    CHECKPOINT_FILES, EngineRenderer, FitError, FolderLock, JobFile, LockError, Outcome, RenderError,
    RunOptions, State, Status, results,
};
use antirad::gpu::{DeviceOptions, staging_bytes};
use antirad::output::{prepare_directory, remove_unfinished};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What runs jobs in one thread, one after the other.
pub struct Worker<'a> {
    pub arguments: &'a Arguments,
    pub options: DeviceOptions,
    pub log: &'a Log,
    pub interrupt: &'a Interrupt,
    pub budget: &'a Budget,
    /// Kept from one job to the next, since it holds the compiled kernels; a job that fails takes it along.
    pub backend: Option<Backend>,
    pub together: &'a Together,
}

/// The result of a job.
pub struct Done {
    pub row: Row,
    /// For standard output.
    pub text: String,
    /// Whether other jobs are likely to fail for the same reason.
    pub shared_cause: bool,
}

impl Done {
    pub fn not_started(job: &str) -> Self {
        let row = Status::new(job, State::NotStarted).into();
        Self { row, text: String::new(), shared_cause: false }
    }
}

/// Between two updates of the status on disk.
const PERIOD: Duration = Duration::from_secs(1);

impl Worker<'_> {
    /// Runs a job such that no failure, not even a panic, stops the others.
    pub fn run(&mut self, job: &Found) -> Done {
        let mut fit = Fit {
            directory: self.arguments.output.join(&job.name),
            status: Status::new(&job.name, State::Running),
            text: String::new(),
            lock: None,
            owned: false,
        };
        let backend = self.backend.take();
        let attempt = std::panic::AssertUnwindSafe(|| self.attempt(job, backend, &mut fit));
        let (ended, shared_cause) = match std::panic::catch_unwind(attempt) {
            Ok(Ok(ended)) => (Some(ended), false),
            Ok(Err(error)) => (None, fit.failed(error)),
            Err(_) => {
                fit.status.state = State::Failed;
                fit.status.message =
                    String::from("a bug in antirad, see the message above; please report it");
                (None, false)
            }
        };
        fit.status.seconds_left = None;
        fit.write_status();
        let mut row = Row::from(fit.status);
        if let Some(ended) = ended {
            row.status = ended;
        }
        Done { row, text: fit.text, shared_cause }
    }

    fn attempt(&mut self, found: &Found, backend: Option<Backend>, fit: &mut Fit) -> Result<Ended, FitError> {
        let (arguments, name) = (self.arguments, &found.name);
        prepare_directory(&fit.directory)?;
        fit.lock = match FolderLock::take(&fit.directory) {
            Err(unavailable @ LockError::Unavailable { .. }) => {
                self.log.warn(name, &unavailable.to_string());
                None
            }
            taken => Some(taken?),
        };
        fit.owned = true;
        remove_unfinished(&fit.directory)?;
        let shared =
            self.together.share(&fit.directory, &[&CHECKPOINT_FILES[..], &[results::REPORT]].concat());
        shared.map_err(|error| FitError::Render(RenderError::Failed(error)))?;
        let mut file = JobFile::load(&found.path)?;
        if self.together.ranks.count() > 1 && file.stop.seconds.is_finite() {
            let why = "[stop] seconds: processes that work together have no common clock; leave it out";
            return Err(FitError::Settings(why.to_owned()));
        }
        for warning in &file.warnings {
            self.log.warn(name, warning);
        }
        fit.status.most_iterations = Some(file.stop.iterations);
        fit.status.warnings.clone_from(&file.warnings);
        if let Some(progress) = file.job.progress(&fit.directory, arguments.on_checkpoint())?
            && let Some(stop) = progress.finished
            && fit.directory.join(results::REPORT).is_file()
        {
            let before = Status::read(&fit.directory).filter(|status| status.state == State::Finished);
            fit.status = before.unwrap_or(fit.status.clone());
            fit.status.state = State::Finished;
            fit.status.stop = Some(stop);
            fit.status.picture_error = results::written_picture_error(&fit.directory);
            fit.status.advance(&progress.history, progress.seconds);
            self.backend = backend;
            return Ok(Ended::FinishedBefore);
        }
        fit.write_status();

        let failed = |error: antirad::gpu::GpuError| FitError::Render(RenderError::Failed(Box::new(error)));
        let problem = file.job.problem();
        let choice = arguments.backend.backend.unwrap_or(problem.parameters.base().settings.backend);
        let kind = Backend::chosen(Some(choice), &self.options);
        let kept = match backend.filter(|backend| backend.kind() == kind) {
            Some(backend) => backend,
            None => self.together.open(choice, self.options.clone(), self.interrupt).map_err(failed)?,
        };
        kept.reset_peak_memory();
        // Of its own, so that its staging buffers are gone before the next job is planned.
        let backend = kept.scope(staging_bytes());
        let asked = self.interrupt.clone();
        let watch: Watch = Arc::new(move || asked.flow());
        let (planning, gradients) =
            (problem.parameters.planning_scene(), problem.parameters.gradient_request());
        let supersample = file.job.settings().supersample;
        let mut renderer = EngineRenderer::new(&backend, planning, supersample, gradients, watch)?
            .shading(file.job.settings().shading)
            .movable(problem.parameters.movable())
            .paintings(problem.parameters.paintings());
        // Before anything is allocated: a job that does not fit is refused with the number of bytes that it needs.
        let (estimate, host_bytes) = file.job.estimate(&mut renderer)?;
        // Planned for the whole budget, as if it were alone, so that it finds the same whatever runs beside it.
        let room = room(estimate.device_bytes, gradients.positions);
        let Some(_part) = self.budget.take(room, || self.interrupt.is_set()) else {
            return Err(FitError::Interrupted { iteration: 0 });
        };
        // Parameters that are fitted although no view shows them.
        for unseen in problem.parameters.unseen(&renderer.seen()?) {
            let unseen = unseen.to_string();
            self.log.warn(name, &unseen);
            file.warnings.push(unseen);
        }
        fit.status.warnings.clone_from(&file.warnings);
        self.log.begin(&file, &backend, &estimate);

        let options = RunOptions::default()
            .checkpoints(Some(fit.directory.clone()))
            .checkpoint_every(file.checkpoint_every)
            .on_checkpoint(arguments.on_checkpoint())
            .stop(file.stop);
        let progress = self.log.job(name, file.stop.iterations);
        let (since, mut told) = (Instant::now(), None::<Instant>);
        let outcome = file.job.run(&mut renderer, &options, &mut |record, all| {
            progress.iteration(record);
            fit.status.advance(&all.history, all.seconds.max(since.elapsed().as_secs_f64()));
            if told.is_none_or(|told| told.elapsed() >= PERIOD) {
                told = Some(Instant::now());
                fit.write_status();
            }
            self.interrupt.flow()
        })?;
        let about = results::Circumstances {
            scene: file.scene_file.display().to_string(),
            stop: file.stop,
            estimate,
            host_bytes,
            warnings: file.warnings.clone(),
            more: more(&backend),
        };
        cli::draw_fit(&fit.directory, &file.job, &outcome)?;
        results::write(&fit.directory, &file.job, &outcome, &about)?;
        let picture_error = results::picture_error(&file.job.problem().targets, &outcome.exposed());
        fit.text = described(name, &outcome, picture_error, &fit.directory);
        fit.status.state = State::Finished;
        fit.status.stop = Some(outcome.stop);
        fit.status.picture_error = Some(picture_error);
        fit.status.advance(&outcome.history, outcome.seconds);
        drop((renderer, backend));
        self.backend = Some(kept).filter(|kept| kept.memory().in_use == 0);
        Ok(Ended::Finished)
    }
}

/// A job at work.
struct Fit {
    directory: PathBuf,
    status: Status,
    text: String,
    lock: Option<FolderLock>,
    /// Whether no other process is at work in the folder, as far as can be known.
    owned: bool,
}

impl Fit {
    /// Notes why there is no result. Whether other jobs are likely to fail for the same reason.
    fn failed(&mut self, error: FitError) -> bool {
        if let FitError::Interrupted { iteration } = error {
            self.status.state = State::Interrupted;
            self.status.iteration = Some(iteration);
            return false;
        }
        self.status.state = State::Failed;
        self.status.message = error.to_string();
        self.status.may_pass = error.may_pass();
        match &error {
            FitError::Write(_) | FitError::Lock(LockError::Write(_)) => true,
            FitError::Render(error) => error.is_device_lost(),
            _ => false,
        }
    }

    /// Writes the status. Where this fails, those who look on miss an update, which is no reason to fail.
    fn write_status(&mut self) {
        if self.owned
            && let Err(error) = self.status.write(&self.directory)
        {
            tracing::debug!("{error}");
        }
    }
}

/// Memory of the backend that a job is given: what its plan counts. Where meshes move, lists of close triangles grow and shrink
/// with every plan.
fn room(planned: u64, moves: bool) -> u64 {
    if moves { planned + planned / 4 } else { planned }
}

/// Backend and memory, for the report.
fn more(backend: &Backend) -> serde_json::Value {
    serde_json::json!({
        "backend": backend.kind(),
        "device": crate::report::DeviceReport::from(backend),
        "threads": backend.threads(),
        "memory": crate::report::MemoryUse::from(backend.memory()),
    })
}

/// Maximum number of values printed; the rest is in the files.
const PRINTED: usize = 24;

fn described(name: &str, outcome: &Outcome, picture_error: f64, directory: &Path) -> String {
    let mut text = String::new();
    // Writing into a string does not fail.
    let _ = describe(&mut text, name, outcome, picture_error, directory);
    text
}

fn describe(
    to: &mut String,
    name: &str,
    outcome: &Outcome,
    picture_error: f64,
    directory: &Path,
) -> std::fmt::Result {
    let (first, iterations) = match (outcome.history.first(), outcome.history.last()) {
        (Some(first), Some(last)) => (first.loss, last.iteration),
        _ => (outcome.loss, 0),
    };
    writeln!(to, "{name}: {iterations} iterations in {:.1} s: {}", outcome.seconds, outcome.stop.reason())?;
    writeln!(to, "  loss        {first:.4e} to {:.4e}", outcome.loss)?;
    writeln!(to, "  pictures    {:.3} % off their targets", 100.0 * picture_error)?;
    for value in outcome.recovered.iter().take(PRINTED) {
        let numbers = |of: &[f64]| of.iter().map(|v| format!("{v:.5}")).collect::<Vec<_>>().join(" ");
        let bound = if value.at_bound.contains(&true) { ", at a bound" } else { "" };
        let unit = if value.unit == "1" { "" } else { value.unit };
        writeln!(
            to,
            "  {:<11} {} {unit} of {} (from {}{bound})",
            value.quantity,
            numbers(&value.value),
            value.of,
            numbers(&value.initial)
        )?;
    }
    if outcome.recovered.len() > PRINTED {
        writeln!(to, "  and {} more", outcome.recovered.len() - PRINTED)?;
    }
    writeln!(to, "  written     {}", directory.display())
}
