//! The progress of fits, on standard error: a bar on a terminal, else lines, each with the name of its job.

use super::summary::{Ended, Row};
use antirad::backend::Backend;
use antirad::cli;
use antirad::fit::{CostEstimate, JobFile, Record};
use antirad::gpu::Bytes;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub struct Log {
    json: bool,
    quiet: bool,
    verbose: bool,
    terminal: bool,
    jobs: usize,
    /// Hidden where there is no terminal.
    bar: ProgressBar,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    ended: usize,
    at_work: BTreeMap<String, AtWork>,
}

struct AtWork {
    iteration: u32,
    most: u32,
    loss: Option<f64>,
    first_stage: bool,
}

/// Steps of the bar for each job.
const STEPS: u64 = 1000;

impl Log {
    pub fn new(json: bool, quiet: bool, verbose: u8, jobs: usize) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = match terminal && !json && !quiet {
            true => ProgressBar::new(STEPS * jobs as u64),
            false => ProgressBar::hidden(),
        };
        let template = "[{bar:24}] {elapsed} elapsed, {eta} left: {wide_msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.enable_steady_tick(Duration::from_millis(500));
        Self { json, quiet, verbose: verbose > 0, terminal, jobs, bar, state: Mutex::default() }
    }

    fn event(&self, event: Value) {
        if self.json && !self.quiet {
            eprintln!("{event}");
        }
    }

    /// Prints a line above the bar.
    fn line(&self, line: &str) {
        self.bar.suspend(|| eprintln!("{}", cli::plain(line)));
    }

    pub fn warn(&self, job: &str, warning: &str) {
        self.bar.suspend(|| tracing::warn!("{job}: {warning}"));
    }

    /// Which jobs of a batch this process does.
    pub fn shard(&self, shard: &impl std::fmt::Display, jobs: usize, all: usize) {
        self.event(json!({ "event": "shard", "shard": shard.to_string(), "jobs": jobs, "of": all }));
        if !self.json && !self.quiet {
            self.line(&format!("shard {shard}: {jobs} of {all} jobs"));
        }
    }

    pub fn begin(&self, file: &JobFile, backend: &Backend, estimate: &CostEstimate) {
        let (job, problem) = (&file.job, file.job.problem());
        let (unknowns, views) = (problem.parameters.len(), problem.targets.len());
        let seconds = estimate.seconds;
        self.event(json!({
            "event": "begin",
            "job": job.name,
            "backend": backend.kind(),
            "device": backend.device_name(),
            "threads": backend.threads(),
            "fits": quantities(file),
            "unknowns": unknowns,
            "views": views,
            "optimiser": job.optimiser(),
            "device_bytes": estimate.device_bytes,
            "device_budget": estimate.device_budget,
            "estimated_seconds_per_iteration": seconds,
        }));
        if !self.json && !self.quiet {
            self.line(&format!(
                "{}: {unknowns} unknowns ({}), {views} view{}; solves of about {seconds:.1} s per iteration, {} of {} \
                 of memory; backend {:?}",
                job.name,
                quantities(file),
                if views == 1 { "" } else { "s" },
                Bytes(estimate.device_bytes),
                Bytes(estimate.device_budget),
                backend,
            ));
        }
    }

    /// For the iterations of a job, at most `most`.
    pub fn job(&self, name: &str, most: u32) -> JobLog<'_> {
        self.state()
            .at_work
            .insert(name.to_owned(), AtWork { iteration: 0, most, loss: None, first_stage: false });
        self.show();
        JobLog { log: self, name: name.to_owned(), since: Instant::now() }
    }

    /// Prints on standard output, unless quiet.
    pub fn results(&self, text: &str) {
        if !self.quiet && !self.json {
            self.bar.suspend(|| antirad::say!("{}", text.trim_end()));
        }
    }

    pub fn ended(&self, row: &Row) {
        {
            let mut state = self.state();
            state.at_work.remove(&row.job);
            state.ended += 1;
        }
        self.show();
        self.event(json!({ "event": "end", "job": row.job, "result": row }));
        if self.json {
            return;
        }
        match row.status {
            // Errors are printed even with --quiet.
            Ended::Failed => self.line(&format!("antirad: {}: {}", row.job, row.message)),
            Ended::Interrupted => self.line(&format!(
                "antirad: {}: interrupted after iteration {}; --resume goes on from there",
                row.job,
                row.iterations.unwrap_or(0)
            )),
            Ended::FinishedBefore if !self.quiet => self.line(&format!("{}: finished before", row.job)),
            Ended::Finished | Ended::FinishedBefore | Ended::NotStarted | Ended::Running => {}
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn show(&self) {
        let (position, message) = self.state().summary(self.jobs);
        self.bar.set_position(position);
        self.bar.set_message(message);
    }
}

impl State {
    /// Position and text of the bar.
    fn summary(&self, jobs: usize) -> (u64, String) {
        let mut position = STEPS * self.ended as u64;
        let mut parts = Vec::new();
        if jobs > 1 {
            parts.push(format!("{} of {jobs} jobs", self.ended));
        }
        for (name, AtWork { iteration, most, loss, first_stage }) in &self.at_work {
            let loss = loss.map_or_else(String::new, |loss| format!(", loss {loss:.3e}"));
            if *first_stage {
                parts.push(format!("{name} first stage{loss}"));
                continue;
            }
            position += STEPS * u64::from(*iteration) / u64::from(*most).max(1);
            parts.push(format!("{name} iteration {iteration} of {most}{loss}"));
        }
        (position.min(STEPS * jobs as u64), parts.join("; "))
    }
}

pub struct JobLog<'a> {
    log: &'a Log,
    name: String,
    since: Instant,
}

impl JobLog<'_> {
    pub fn iteration(&self, record: &Record) {
        let seconds = self.since.elapsed().as_secs_f64();
        let Record { iteration, loss, gradient, step, first_stage, .. } = *record;
        let stage = if first_stage { " first stage," } else { "" };
        self.log.event(json!({
            "event": "iteration",
            "job": self.name,
            "iteration": iteration,
            "first_stage": first_stage,
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
        if !self.log.terminal || self.log.verbose {
            self.log.line(&format!(
                "{}{stage} iteration {iteration}: loss {loss:.6e}, gradient {gradient:.2e}, step {step:.2e}, {seconds:.1} s",
                self.name
            ));
        }
        if let Some(job) = self.log.state().at_work.get_mut(&self.name) {
            (job.iteration, job.loss, job.first_stage) = (iteration, Some(loss), first_stage);
        }
        self.log.show();
    }
}

/// The fitted quantities, in one line.
fn quantities(file: &JobFile) -> String {
    let mut words: Vec<&str> = file.job.settings().fits.iter().map(|fit| fit.quantity.word()).collect();
    words.sort_unstable();
    words.dedup();
    words.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_bar_shows_all_jobs() {
        let mut state = State { ended: 3, ..State::default() };
        state.at_work.insert(
            String::from("b"),
            AtWork { iteration: 5, most: 20, loss: Some(0.5), first_stage: false },
        );
        state
            .at_work
            .insert(String::from("a"), AtWork { iteration: 0, most: 20, loss: None, first_stage: false });
        let (position, message) = state.summary(8);
        assert_eq!(position, 3250);
        assert_eq!(message, "3 of 8 jobs; a iteration 0 of 20; b iteration 5 of 20, loss 5.000e-1");
        let (_, message) = State { ended: 0, ..state }.summary(1);
        assert!(message.starts_with("a iteration 0"), "{message}");
        let mut state = State::default();
        state
            .at_work
            .insert(String::from("a"), AtWork { iteration: 3, most: 20, loss: Some(0.5), first_stage: true });
        assert_eq!(state.summary(1), (0, String::from("a first stage, loss 5.000e-1")));
    }
}
