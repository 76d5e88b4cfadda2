//! The progress of fits, on standard error.

use super::summary::{Row, Status};
use super::{bytes, quantities};
use antirad::fit::{CostEstimate, JobFile, Record};
use antirad::gpu::Device;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

pub struct Log {
    json: bool,
    quiet: bool,
    verbose: bool,
    terminal: bool,
}

impl Log {
    pub fn new(json: bool, quiet: bool, verbose: u8) -> Self {
        Self { json, quiet, verbose: verbose > 0, terminal: std::io::stderr().is_terminal() }
    }

    fn event(&self, event: Value) {
        if self.json && !self.quiet {
            eprintln!("{event}");
        }
    }

    pub fn begin(&self, file: &JobFile, device: &Device, estimate: &CostEstimate) {
        let (job, problem) = (&file.job, file.job.problem());
        let (unknowns, views) = (problem.parameters.len(), problem.targets.len());
        let seconds = estimate.seconds;
        self.event(json!({
            "event": "begin",
            "job": job.name,
            "device": device.info().name,
            "fits": quantities(file),
            "unknowns": unknowns,
            "views": views,
            "optimiser": job.optimiser(),
            "device_bytes": estimate.device_bytes,
            "device_budget": estimate.device_budget,
            "estimated_seconds_per_iteration": seconds,
        }));
        if !self.json && !self.quiet {
            eprintln!(
                "{}: {unknowns} unknowns ({}), {views} view{}; about {seconds:.1} s per iteration, {} of device \
                 memory of {}",
                job.name,
                quantities(file),
                if views == 1 { "" } else { "s" },
                bytes(estimate.device_bytes),
                bytes(estimate.device_budget),
            );
        }
    }

    /// For the iterations of a job, at most `most`.
    pub fn job(&self, name: &str, most: u32) -> JobLog<'_> {
        let bar = if self.terminal && !self.json && !self.quiet {
            ProgressBar::new(most.into())
        } else {
            ProgressBar::hidden()
        };
        let template = "{prefix} [{bar:24}] {pos} of at most {len}, {msg}, {elapsed} elapsed, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(name.to_owned());
        bar.set_message("first evaluation");
        bar.enable_steady_tick(Duration::from_millis(500));
        JobLog { log: self, name: name.to_owned(), bar, since: Instant::now() }
    }

    /// Prints on standard output, unless quiet.
    pub fn results(&self, print: impl FnOnce()) {
        if !self.quiet {
            print();
        }
    }

    pub fn ended(&self, row: &Row) {
        self.event(json!({ "event": "end", "job": row.job, "result": row }));
        if self.json {
            return;
        }
        match row.status {
            // Errors are printed even with --quiet.
            Status::Failed => eprintln!("antirad: {}: {}", row.job, row.message),
            Status::Interrupted => eprintln!(
                "antirad: {}: interrupted after iteration {}; --resume goes on from there",
                row.job,
                row.iterations.unwrap_or(0)
            ),
            Status::FinishedBefore if !self.quiet => eprintln!("{}: finished before", row.job),
            Status::Finished | Status::FinishedBefore | Status::NotStarted => {}
        }
    }
}

pub struct JobLog<'a> {
    log: &'a Log,
    name: String,
    bar: ProgressBar,
    since: Instant,
}

impl JobLog<'_> {
    pub fn iteration(&self, record: &Record) {
        let seconds = self.since.elapsed().as_secs_f64();
        let Record { iteration, loss, gradient, step, .. } = *record;
        self.log.event(json!({
            "event": "iteration",
            "job": self.name,
            "iteration": iteration,
            "loss": loss,
            "gradient": gradient,
            "step": step,
            "evaluations": record.evaluations,
            "passes": record.passes,
            "seconds": seconds,
        }));
        if self.log.json || self.log.quiet {
            return;
        }
        let line = format!(
            "{} iteration {iteration}: loss {loss:.6e}, gradient {gradient:.2e}, step {step:.2e}, {seconds:.1} s",
            self.name
        );
        if !self.log.terminal {
            eprintln!("{line}");
        } else if self.log.verbose {
            self.bar.println(line);
        }
        self.bar.set_position(iteration.into());
        self.bar.set_message(format!("loss {loss:.3e}"));
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
