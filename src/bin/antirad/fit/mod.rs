//! `antirad fit`: one job, or a batch of them.

mod batch;
mod job;
mod log;
mod page;
mod pool;
mod shard;
mod summary;

use crate::Failure;
use crate::together::Together;
use antirad::cli::{self, BackendArguments, Interrupt, parse_size};
use antirad::fit::{OnCheckpoint, State, Status};
use antirad::gpu::DeviceOptions;
use antirad::output::prepare_directory;
use batch::Found;
use clap::{Args, ValueEnum};
use job::{Done, Worker};
use log::Log;
use page::Page;
use pool::{Budget, Parallel};
use shard::Shard;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use summary::{Ended, Row};

#[derive(Args, Clone)]
#[command(after_help = "Examples:
  antirad fit scenes/fits/cornell.toml --output out/fits
  antirad fit jobs/ --output out/fits --resume
  antirad fit jobs/ --output out/fits --parallel auto
  antirad fit jobs/ --output out/fits --resume --shard 3/40")]
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
    /// Jobs at once on the backend: a number, or auto for as many as keep it and the cores busy. Results are the same
    #[arg(long, value_name = "auto|N", default_value = "1")]
    parallel: Parallel,
    /// Do part K of N of the jobs: every Nth, from the Kth on [default: the task of a Slurm array, or of an indexed Job of
    /// Kubernetes with ANTIRAD_SHARDS completions; else all. A single job file is always done]
    #[arg(long, value_name = "K/N")]
    shard: Option<Shard>,
    /// Limit of the backend's memory, e.g. 512MiB [default: what the device has; on the CPU three quarters of the system's]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    memory_budget: Option<u64>,
    #[command(flatten)]
    backend: BackendArguments,
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

    /// The part of the jobs that this process does; `None` for all.
    fn shard(&self) -> Result<Option<Shard>, Failure> {
        let single = matches!(self.jobs.as_slice(), [only] if !only.is_dir());
        if self.shard.is_some() || single {
            return Ok(self.shard);
        }
        Shard::of_environment(|name| std::env::var(name).ok())
            .map_err(|message| Failure::Error(message.into()))
    }

    fn device_options(&self) -> DeviceOptions {
        self.backend.options(self.memory_budget)
    }
}

pub fn run(
    arguments: &Arguments,
    quiet: bool,
    verbose: u8,
    interrupt: &Interrupt,
    together: &Together,
) -> Result<(), Failure> {
    // All processes do and write the same; where others than the first write to, nobody looks.
    let (unseen, elsewhere);
    let arguments = match together.speaks() {
        true => arguments,
        false => {
            unseen = tempfile::tempdir()?;
            elsewhere = Arguments { output: unseen.path().to_path_buf(), ..arguments.clone() };
            &elsewhere
        }
    };
    let shard = arguments.shard()?;
    let all = batch::find(&arguments.jobs)?;
    prepare_directory(&arguments.output)?;
    announce(&all, &arguments.output);
    let (number, batch) = (all.len(), all.len() > 1);
    let jobs = match shard {
        Some(shard) => shard.choose(all),
        None => all,
    };
    // Where it cannot be opened no job can run: fail here rather than in each of them.
    let choice = arguments.backend.backend.unwrap_or_default();
    let backend = together.open(choice, arguments.device_options(), interrupt)?;
    let log = Log::new(arguments.json(), quiet, verbose, jobs.len());
    if let Some(shard) = shard {
        log.shard(&shard, jobs.len(), number);
    }
    let total = backend.memory().budget;
    let budget = Budget::new(total);
    // Several processes do the same jobs in the same order.
    let several = together.ranks.count() > 1;
    let threads = if several { 1 } else { arguments.parallel.threads(jobs.len(), &backend) };
    let mut backend = Some(backend);
    let worker = |_| Worker {
        arguments,
        // The same for all, whatever the others have taken when it is opened.
        options: arguments.device_options().memory_budget(Some(total)),
        log: &log,
        interrupt,
        budget: &budget,
        backend: backend.take(),
        together,
    };
    let stopped = AtomicBool::new(false);
    let work = |worker: &mut Worker, job: &Found| {
        let not_started = stopped.load(Ordering::SeqCst) || interrupt.is_set();
        let done = if not_started { Done::not_started(&job.name) } else { worker.run(job) };
        // The other processes may not have failed, and wait.
        if done.shared_cause && !arguments.keep_going || several && !done.row.status.is_good() {
            stopped.store(true, Ordering::SeqCst);
        }
        // Before the next job begins, and not once all results so far are written.
        log.ended(&done.row);
        done
    };
    let mut results = Results { rows: BTreeMap::new(), texts: BTreeMap::new() };
    let mut page = Page::new(&arguments.output);
    pool::run((0..threads).map(worker).collect(), &jobs, work, |ended| {
        for (index, done) in ended {
            results.add(index, done, &log);
        }
        // Whenever jobs have ended, so that a killed batch leaves a summary too. If this fails, the last one tells.
        if batch && let Err(error) = summary::write(&arguments.output, &results.rows(), &mut page, false) {
            tracing::debug!("{error}");
        }
    });
    log.finish();
    let rows = results.rows();
    if batch {
        summary::write(&arguments.output, &rows, &mut page, true)?;
    }
    if batch && !quiet && !arguments.json() {
        summary::print(&rows, &arguments.output);
    }
    match exit_code(&rows, interrupt) {
        0 => Ok(()),
        code => Err(Failure::Code(code)),
    }
}

/// Lets those who look on know of all jobs of a batch, those of other shards too. Where that fails, so will the job.
fn announce(jobs: &[Found], output: &Path) {
    for job in jobs {
        let directory = output.join(&job.name);
        let written = prepare_directory(&directory)
            .and_then(|()| Status::new(&job.name, State::NotStarted).announce(&directory));
        if let Err(error) = written {
            tracing::debug!("{error}");
        }
    }
}

/// What jobs have brought so far, by their place in the batch.
struct Results {
    rows: BTreeMap<usize, Row>,
    /// `None` once printed.
    texts: BTreeMap<usize, Option<String>>,
}

impl Results {
    /// Adds that of a job, and prints what is due: results are printed in the order of the jobs.
    fn add(&mut self, index: usize, done: Done, log: &Log) {
        self.rows.insert(index, done.row);
        self.texts.insert(index, Some(done.text));
        for (place, (index, text)) in self.texts.iter_mut().enumerate() {
            if place != *index {
                break;
            }
            if let Some(text) = text.take() {
                log.results(&text);
            }
        }
    }

    fn rows(&self) -> Vec<Row> {
        self.rows.values().cloned().collect()
    }
}

/// Tells a scheduler what to do next: see the table in docs/fitting.md.
fn exit_code(rows: &[Row], interrupt: &Interrupt) -> u8 {
    let bad = |row: &&Row| !row.status.is_good();
    if interrupt.is_set() {
        interrupt.exit_code()
    } else if rows.iter().filter(bad).any(|row| row.may_pass || row.status == Ended::NotStarted) {
        cli::EXIT_RETRY
    } else if rows.iter().any(|row| bad(&row)) {
        cli::EXIT_PARTLY
    } else {
        0
    }
}
