//! What the folder of a job tells of its fit while it runs and afterwards: `status.json`.

use super::job::{Record, Stop};
use super::lock::FolderLock;
use antirad_base::input;
use antirad_base::output::{OutputError, write_json, write_new_json};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

const FILE: &str = "status.json";

/// How far a job is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Part of a batch that has not come to it.
    NotStarted,
    /// A process is at work.
    Running,
    /// The results are there.
    Finished,
    /// Stopped by a signal, or killed; `--resume` continues it.
    Interrupted,
    /// Ended by an error.
    Failed,
}

/// The state of a job and what is known of its progress.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The job's name.
    pub job: String,
    /// How far it is.
    pub state: State,
    /// The host of the process that fits, or was the last to do so.
    pub host: String,
    /// Number of that process.
    pub process: u32,
    /// When it began, seconds since 1970.
    pub began: u64,
    /// When it last wrote this, seconds since 1970.
    pub written: u64,
    /// The last finished iteration.
    pub iteration: Option<u32>,
    /// The iteration at which the fit ends at the latest.
    pub most_iterations: Option<u32>,
    /// Loss of the initial values.
    pub loss_at_start: Option<f64>,
    /// Loss after the last iteration.
    pub loss: Option<f64>,
    /// Relative L2 difference of the fitted pictures from their targets, once finished.
    pub picture_error: Option<f64>,
    /// Time of all runs, s.
    pub seconds: Option<f64>,
    /// Time to the last possible iteration, s: fits usually end before.
    pub seconds_left: Option<f64>,
    /// Why the fit ended.
    pub stop: Option<Stop>,
    /// Warnings, one line each.
    pub warnings: Vec<String>,
    /// The error of a failed job.
    pub message: String,
    /// Whether another attempt may succeed where this one failed.
    pub may_pass: bool,
}

impl Status {
    /// The status of a job in this process, from now on.
    pub fn new(job: &str, state: State) -> Self {
        let now = now();
        Self {
            job: job.to_owned(),
            state,
            host: gethostname::gethostname().to_string_lossy().into_owned(),
            process: std::process::id(),
            began: now,
            written: now,
            iteration: None,
            most_iterations: None,
            loss_at_start: None,
            loss: None,
            picture_error: None,
            seconds: None,
            seconds_left: None,
            stop: None,
            warnings: Vec::new(),
            message: String::new(),
            may_pass: false,
        }
    }

    /// Takes over what a history says, which took `seconds`.
    pub fn advance(&mut self, history: &[Record], seconds: f64) {
        self.iteration = history.last().map(|r| r.iteration);
        self.loss_at_start = history.first().map(|r| r.loss);
        self.loss = history.last().map(|r| r.loss);
        self.seconds = Some(seconds);
        self.seconds_left = match (self.iteration, self.most_iterations) {
            (Some(done), Some(most)) if done > 0 => {
                Some(seconds / f64::from(done) * f64::from(most.saturating_sub(done)))
            }
            _ => None,
        };
    }

    /// Writes the status into the job's folder. For the process that holds the folder's lock.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(&mut self, directory: &Path) -> Result<(), OutputError> {
        self.written = now();
        write_json(&directory.join(FILE), self)
    }

    /// Writes the status into the job's folder, unless that has one.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn announce(&self, directory: &Path) -> Result<(), OutputError> {
        write_new_json(&directory.join(FILE), self)
    }

    /// The status in a job's folder, with `Running` corrected where no process is at work any more. `None` if there
    /// is none: the folder is not a job's.
    pub fn read(directory: &Path) -> Option<Self> {
        let read =
            || -> Option<Self> { serde_json::from_slice(&input::read(&directory.join(FILE)).ok()?).ok() };
        let status = read()?;
        if status.state != State::Running || FolderLock::is_held(directory) != Some(false) {
            return Some(status);
        }
        // It may have ended in between.
        let status = read()?;
        if status.state != State::Running {
            return Some(status);
        }
        let message = format!("process {} on {} was killed", status.process, status.host);
        Some(Self { state: State::Interrupted, message, seconds_left: None, ..status })
    }

    /// The jobs of a folder of results, by name, each with its folder. Folders of other things are left out.
    ///
    /// # Errors
    /// Fails if the folder cannot be read.
    pub fn of_folder(directory: &Path) -> std::io::Result<Vec<(PathBuf, Self)>> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(directory)? {
            let path = entry?.path();
            if let Some(status) = Self::read(&path) {
                found.push((path, status));
            }
        }
        found.sort_by(|a, b| a.1.job.cmp(&b.1.job));
        Ok(found)
    }
}

/// Seconds since 1970.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(iteration: u32, loss: f64) -> Record {
        Record { iteration, loss, gradient: 1.0, step: 0.1, evaluations: 1, passes: 4, first_stage: false }
    }

    #[test]
    fn a_status_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().expect("a folder");
        let job = folder.path().join("job");
        std::fs::create_dir(&job).expect("a folder");
        std::fs::create_dir(folder.path().join("pictures")).expect("a folder");
        let waiting = Status::new("job", State::NotStarted);
        waiting.announce(&job).expect("written");
        let mut status = Status { most_iterations: Some(30), ..Status::new("job", State::Finished) };
        status.advance(&[record(0, 8.0), record(10, 0.5)], 5.0);
        assert_eq!((status.loss_at_start, status.loss, status.iteration), (Some(8.0), Some(0.5), Some(10)));
        assert_eq!(status.seconds_left, Some(10.0));
        status.write(&job).expect("written");
        // What is known stays.
        waiting.announce(&job).expect("not written");
        assert_eq!(Status::of_folder(folder.path()).expect("read"), [(job, status)]);
    }

    #[test]
    fn a_running_job_needs_a_process() {
        let folder = tempfile::tempdir().expect("a folder");
        let lock = FolderLock::take(folder.path()).expect("free");
        Status::new("job", State::Running).write(folder.path()).expect("written");
        assert_eq!(Status::read(folder.path()).map(|s| s.state), Some(State::Running));
        drop(lock);
        let killed = Status::read(folder.path()).expect("a status");
        assert_eq!(killed.state, State::Interrupted);
        assert!(killed.message.contains("was killed"), "{}", killed.message);
        // Looking does not keep anybody out.
        FolderLock::take(folder.path()).expect("free");
    }
}
