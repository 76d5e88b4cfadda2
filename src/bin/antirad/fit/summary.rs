//! The outcome of each job of a batch, and of others with results in the same folder.

use super::page::Page;
use antirad::fit::{FolderLock, LockError, State, Status};
use antirad::output::{OutputError, atomic_write};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ended {
    Finished,
    /// Finished in an earlier run.
    FinishedBefore,
    Failed,
    Interrupted,
    NotStarted,
    /// Running in another process.
    Running,
}

impl Ended {
    pub fn is_good(self) -> bool {
        matches!(self, Self::Finished | Self::FinishedBefore)
    }

    fn word(self) -> &'static str {
        match self {
            Self::Finished => "finished",
            Self::FinishedBefore => "finished before",
            Self::Failed => "FAILED",
            Self::Interrupted => "interrupted",
            Self::NotStarted => "not started",
            Self::Running => "running",
        }
    }
}

impl From<State> for Ended {
    fn from(state: State) -> Self {
        match state {
            State::NotStarted => Self::NotStarted,
            State::Running => Self::Running,
            State::Finished => Self::Finished,
            State::Interrupted => Self::Interrupted,
            State::Failed => Self::Failed,
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub job: String,
    pub status: Ended,
    pub iterations: Option<u32>,
    pub loss_at_start: Option<f64>,
    pub loss: Option<f64>,
    /// Relative L2 difference of the fitted pictures from their targets.
    pub picture_error: Option<f64>,
    pub seconds: Option<f64>,
    /// Why the fit ended.
    pub stop: Option<&'static str>,
    /// The error, if it failed.
    pub message: String,
    /// Whether it may succeed if it is tried again.
    #[serde(skip)]
    pub may_pass: bool,
}

impl From<Status> for Row {
    fn from(status: Status) -> Self {
        Self {
            job: status.job,
            status: status.state.into(),
            iterations: status.iteration,
            loss_at_start: status.loss_at_start,
            loss: status.loss,
            picture_error: status.picture_error,
            seconds: status.seconds,
            stop: status.stop.map(|stop| stop.reason()),
            message: status.message,
            may_pass: status.may_pass,
        }
    }
}

/// How long to wait for another batch that writes its summary.
const PATIENCE: Duration = Duration::from_secs(5);

/// Writes `summary.csv`: these rows, and those of the jobs of other batches in this folder, by name; and, if it is due or
/// this is the `last` time, the page. A lock keeps other batches from writing an older state after this one.
pub fn write(directory: &Path, rows: &[Row], page: &mut Page, last: bool) -> Result<(), OutputError> {
    let _lock = match FolderLock::take_within(directory, PATIENCE) {
        Err(LockError::Write(error)) => return Err(error),
        // Better a summary that misses a row of another batch than none.
        other => other.ok(),
    };
    let jobs = Status::of_folder(directory).map_err(|reason| OutputError::new(directory, reason))?;
    let others = jobs.iter().map(|(_, status)| status.clone().into());
    let own = rows.iter().cloned();
    let all: BTreeMap<String, Row> = others.chain(own).map(|row: Row| (row.job.clone(), row)).collect();
    atomic_write(&directory.join("summary.csv"), |file| {
        let mut writer = csv::Writer::from_writer(file);
        for row in all.values() {
            writer.serialize(row)?;
        }
        writer.flush()
    })?;
    match last || page.is_due() {
        true => page.write(&jobs),
        false => Ok(()),
    }
}

pub fn print(rows: &[Row], directory: &Path) {
    let width = rows.iter().map(|row| row.job.chars().count()).max().unwrap_or(0).max(3);
    antirad::say!(
        "{:<width$}  {:<15} {:>10} {:>12} {:>12} {:>13} {:>9}",
        "job",
        "status",
        "iterations",
        "start",
        "loss",
        "picture error",
        "seconds"
    );
    for row in rows {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.4e}"));
        antirad::say!(
            "{:<width$}  {:<15} {:>10} {:>12} {:>12} {:>13} {:>9} {}",
            row.job,
            row.status.word(),
            row.iterations.map_or(String::new(), |n| n.to_string()),
            number(row.loss_at_start),
            number(row.loss),
            row.picture_error.map_or(String::new(), |error| format!("{:.3} %", 100.0 * error)),
            row.seconds.map_or(String::new(), |s| format!("{s:.1}")),
            row.message
        );
    }
    let good = rows.iter().filter(|row| row.status.is_good()).count();
    antirad::say!("{good} of {} jobs are done; {}", rows.len(), directory.join("index.html").display());
}
