//! The outcome of each job of a batch.

use antirad::fit::Record;
use antirad::output::{OutputError, atomic_write};
use serde::Serialize;
use std::path::Path;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    Finished,
    /// In an earlier run.
    FinishedBefore,
    Failed,
    Interrupted,
    NotStarted,
}

impl Status {
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
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub job: String,
    pub status: Status,
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
}

impl Row {
    pub fn new(job: &str, status: Status) -> Self {
        Self {
            job: job.to_owned(),
            status,
            iterations: None,
            loss_at_start: None,
            loss: None,
            picture_error: None,
            seconds: None,
            stop: None,
            message: String::new(),
        }
    }

    pub fn of_history(job: &str, status: Status, history: &[Record], seconds: f64) -> Self {
        Self {
            iterations: history.last().map(|r| r.iteration),
            loss_at_start: history.first().map(|r| r.loss),
            loss: history.last().map(|r| r.loss),
            seconds: Some(seconds),
            ..Self::new(job, status)
        }
    }
}

pub fn write(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    atomic_write(&directory.join("summary.csv"), |file| {
        let mut writer = csv::Writer::from_writer(file);
        for row in rows {
            writer.serialize(row)?;
        }
        writer.flush()
    })
}

pub fn print(rows: &[Row], directory: &Path) {
    let width = rows.iter().map(|row| row.job.chars().count()).max().unwrap_or(0).max(3);
    println!(
        "{:<width$}  {:<15} {:>10} {:>12} {:>12} {:>13} {:>9}",
        "job", "status", "iterations", "start", "loss", "picture error", "seconds"
    );
    for row in rows {
        let number = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.4e}"));
        println!(
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
    println!("{good} of {} jobs are done; {}", rows.len(), directory.join("summary.csv").display());
}
