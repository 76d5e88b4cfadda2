//! `antirad fit`: one job, or a batch of them.

mod batch;
mod log;
mod summary;

use crate::Failure;
use antirad::Watch;
use antirad::cli::{self, Interrupt, parse_size};
use antirad::fit::{
    EngineRenderer, FitError, FolderLock, JobFile, LockError, OnCheckpoint, Outcome, RenderError, RunOptions,
    results,
};
use antirad::gpu::{Bytes, Device, DeviceOptions};
use antirad::output::{prepare_directory, remove_unfinished};
use antirad::scene::Camera;
use clap::{Args, ValueEnum};
use log::Log;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use summary::{Row, Status};

#[derive(Args)]
#[command(after_help = "Examples:
  antirad fit scenes/fits/cornell.toml --output out/fits
  antirad fit jobs/ --output out/fits --resume")]
pub struct Arguments {
    /// Job files (*.toml that name a scene to fit), or folders of them
    #[arg(required = true, value_name = "JOB.toml|DIR")]
    jobs: Vec<PathBuf>,
    /// Folder for the results; each job writes into a subfolder of its name
    #[arg(long, short, value_name = "DIR", default_value = "out")]
    output: PathBuf,
    /// Continue from existing checkpoints; finished jobs are skipped
    #[arg(long)]
    resume: bool,
    /// Discard existing checkpoints and start over
    #[arg(long, conflicts_with = "resume")]
    restart: bool,
    /// Run the other jobs even after a failure that they are likely to share: a full disk, a lost device
    #[arg(long)]
    keep_going: bool,
    /// Limit of device memory, e.g. 512MiB [default: what the device has]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    memory_budget: Option<u64>,
    /// Vulkan device, by its number or a part of its name (see `antirad devices`) [env: ANTIRAD_DEVICE]
    #[arg(long, value_name = "INDEX|NAME")]
    device: Option<String>,
    /// Format of progress on standard error
    #[arg(long, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum LogFormat {
    /// A progress bar on a terminal, else a line per iteration
    Text,
    /// A JSON object per line
    Json,
}

impl Arguments {
    pub fn json(&self) -> bool {
        self.log_format == LogFormat::Json
    }

    fn on_checkpoint(&self) -> OnCheckpoint {
        match (self.resume, self.restart) {
            (true, _) => OnCheckpoint::Resume,
            (false, true) => OnCheckpoint::Discard,
            (false, false) => OnCheckpoint::Refuse,
        }
    }

    fn device_options(&self) -> DeviceOptions {
        DeviceOptions::asked(&self.device, self.memory_budget)
    }
}

pub fn run(arguments: &Arguments, quiet: bool, verbose: u8, interrupt: &Interrupt) -> Result<(), Failure> {
    let jobs = batch::find(&arguments.jobs)?;
    prepare_directory(&arguments.output)?;
    // Without a device no job can run: fail here rather than in each of them.
    drop(Device::new(&arguments.device_options())?);
    let log = Log::new(arguments.json(), quiet, verbose);
    let mut rows: Vec<Row> = Vec::new();
    let mut stopped = false;
    for job in &jobs {
        let row = if stopped || interrupt.is_set() {
            Row::new(&job.name, Status::NotStarted)
        } else {
            let (row, shared_cause) = run_guarded(arguments, job, &log, interrupt);
            stopped = shared_cause && !arguments.keep_going;
            row
        };
        log.ended(&row);
        rows.push(row);
        if jobs.len() > 1 {
            // After every job, so that a killed batch leaves a summary too.
            summary::write(&arguments.output, &rows)?;
        }
    }
    if jobs.len() > 1 && !quiet && !arguments.json() {
        summary::print(&rows, &arguments.output);
    }
    if interrupt.is_set() {
        return Err(Failure::Code(interrupt.exit_code()));
    }
    match rows.iter().all(|row| row.status.is_good()) {
        true => Ok(()),
        false => Err(Failure::Code(cli::EXIT_PARTLY)),
    }
}

/// Runs a job such that no failure, not even a panic, stops the others. The second value: whether the others are likely
/// to fail for the same reason.
fn run_guarded(arguments: &Arguments, job: &batch::Found, log: &Log, interrupt: &Interrupt) -> (Row, bool) {
    let attempt = std::panic::AssertUnwindSafe(|| run_job(arguments, job, log, interrupt));
    match std::panic::catch_unwind(attempt) {
        Ok(Ok(row)) => (row, false),
        Ok(Err(FitError::Interrupted { iteration })) => {
            (Row { iterations: Some(iteration), ..Row::new(&job.name, Status::Interrupted) }, false)
        }
        Ok(Err(error)) => {
            let shared = match &error {
                FitError::Write(_) | FitError::Lock(LockError::Write(_)) => true,
                FitError::Render(error) => error.is_device_lost(),
                _ => false,
            };
            (Row { message: error.to_string(), ..Row::new(&job.name, Status::Failed) }, shared)
        }
        Err(_) => {
            let message = String::from("a bug in antirad, see the message above; please report it");
            (Row { message, ..Row::new(&job.name, Status::Failed) }, false)
        }
    }
}

fn run_job(
    arguments: &Arguments,
    found: &batch::Found,
    log: &Log,
    interrupt: &Interrupt,
) -> Result<Row, FitError> {
    let mut file = JobFile::load(&found.path)?;
    for warning in &file.warnings {
        tracing::warn!("{}: {warning}", found.name);
    }
    let directory = arguments.output.join(&found.name);
    prepare_directory(&directory)?;
    let _lock = match FolderLock::take(&directory) {
        Err(unavailable @ LockError::Unavailable { .. }) => {
            tracing::warn!("{}: {unavailable}", found.name);
            None
        }
        taken => Some(taken?),
    };
    remove_unfinished(&directory)?;
    if let Some(progress) = file.job.progress(&directory, arguments.on_checkpoint())?
        && progress.finished.is_some()
        && directory.join(results::REPORT).is_file()
    {
        return Ok(Row {
            picture_error: results::written_picture_error(&directory),
            ..Row::of_history(&found.name, Status::FinishedBefore, &progress.history, progress.seconds)
        });
    }

    let failed = |error: antirad::gpu::GpuError| FitError::Render(RenderError::Failed(Box::new(error)));
    // One per job: if the job loses its device, the next one is not affected.
    let device = Device::new(&arguments.device_options()).map_err(failed)?;
    let asked = interrupt.clone();
    let watch: Watch = Arc::new(move || asked.flow());
    let problem = file.job.problem();
    let cameras: Vec<Camera> = problem.targets.iter().map(|target| target.camera.clone()).collect();
    let (planning, gradients) = (problem.parameters.planning_scene(), problem.parameters.gradient_request());
    let supersample = file.job.settings().supersample;
    let mut renderer = EngineRenderer::new(&device, planning, cameras, supersample, gradients, watch)?
        .shading(file.job.settings().shading);
    // Before anything is allocated: a job that does not fit is refused with the number of bytes that it needs.
    let (estimate, host_bytes) = file.job.estimate(&mut renderer)?;
    // Parameters that are fitted although no view shows them.
    for unseen in problem.parameters.unseen(&renderer.seen()?) {
        let unseen = unseen.to_string();
        tracing::warn!("{}: {unseen}", found.name);
        file.warnings.push(unseen);
    }
    log.begin(&file, &device, &estimate);

    let options = RunOptions::default()
        .checkpoints(Some(directory.clone()))
        .checkpoint_every(file.checkpoint_every)
        .on_checkpoint(arguments.on_checkpoint())
        .stop(file.stop);
    let progress = log.job(&found.name, file.stop.iterations);
    let result = file.job.run(&mut renderer, &options, &mut |record, _| {
        progress.iteration(record);
        interrupt.flow()
    });
    progress.finish();
    let outcome = result?;
    let about = results::Circumstances {
        scene: file.scene_file.display().to_string(),
        stop: file.stop,
        estimate,
        host_bytes,
        warnings: file.warnings.clone(),
        more: more(&device),
    };
    cli::draw_fit(&directory, &file.job, &outcome)?;
    results::write(&directory, &file.job, &outcome, &about)?;
    let picture_error = results::picture_error(&file.job.problem().targets, &outcome.pictures);
    if !arguments.json() {
        log.results(|| print(&found.name, &outcome, picture_error, &directory));
    }
    Ok(Row {
        stop: Some(outcome.stop.reason()),
        picture_error: Some(picture_error),
        ..Row::of_history(&found.name, Status::Finished, &outcome.history, outcome.seconds)
    })
}

/// Device and memory, for the report.
fn more(device: &Device) -> serde_json::Value {
    serde_json::json!({
        "device": crate::report::DeviceReport::from(device.info()),
        "memory": crate::report::MemoryUse::from(device.memory()),
    })
}

/// Maximum number of values printed; the rest is in the files.
const PRINTED: usize = 24;

fn print(name: &str, outcome: &Outcome, picture_error: f64, directory: &Path) {
    let (first, iterations) = match (outcome.history.first(), outcome.history.last()) {
        (Some(first), Some(last)) => (first.loss, last.iteration),
        _ => (outcome.loss, 0),
    };
    println!("{name}: {iterations} iterations in {:.1} s: {}", outcome.seconds, outcome.stop.reason());
    println!("  loss        {first:.4e} to {:.4e}", outcome.loss);
    println!("  pictures    {:.3} % off their targets", 100.0 * picture_error);
    for value in outcome.recovered.iter().take(PRINTED) {
        let numbers = |of: &[f64]| of.iter().map(|v| format!("{v:.5}")).collect::<Vec<_>>().join(" ");
        let bound = if value.at_bound.contains(&true) { ", at a bound" } else { "" };
        let unit = if value.unit == "1" { "" } else { value.unit };
        println!(
            "  {:<11} {} {unit} of {} (from {}{bound})",
            value.quantity,
            numbers(&value.value),
            value.of,
            numbers(&value.initial)
        );
    }
    if outcome.recovered.len() > PRINTED {
        println!("  and {} more", outcome.recovered.len() - PRINTED);
    }
    println!("  written     {}", directory.display());
}

/// The fitted quantities, in one line.
fn quantities(file: &JobFile) -> String {
    let mut words: Vec<&str> = file.job.settings().fits.iter().map(|fit| fit.quantity.word()).collect();
    words.sort_unstable();
    words.dedup();
    words.join(", ")
}

fn bytes(bytes: u64) -> String {
    Bytes(bytes).to_string()
}
