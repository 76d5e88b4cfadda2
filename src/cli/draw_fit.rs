//! The pictures and plots of a fit.

use super::comparison;
use super::plot::{Curve, Drawn, LogPlot};
use crate::fit::{FitError, Job, Outcome, Record, results};
use crate::output::OutputError;
use std::path::Path;

/// Draws into `directory`, beside what [`results::write`] leaves there; each file appears whole or not at all.
///
/// - `loss.svg`: the loss over the iterations.
/// - `VIEW.png`: target, fitted picture in its exposure, and error side by side.
pub fn draw_fit(directory: &Path, job: &Job, outcome: &Outcome) -> Result<(), FitError> {
    plot(directory, job, &outcome.history)?;
    let views = job.problem().targets.iter().zip(outcome.exposed());
    for ((target, fitted), name) in views.zip(results::view_names(job)) {
        comparison::write(&directory.join(format!("{name}.png")), target, &fitted)?;
    }
    Ok(())
}

fn plot(directory: &Path, job: &Job, history: &[Record]) -> Result<(), OutputError> {
    let curve = |label: &str, of: fn(&Record) -> f64| Curve {
        label: label.to_owned(),
        points: history.iter().map(|r| (f64::from(r.iteration), of(r))).collect(),
        drawn: Drawn::Curve,
    };
    LogPlot {
        title: format!("Fit of {}", job.name),
        x: "iteration".to_owned(),
        y: "loss, and largest derivative by an unknown".to_owned(),
        curves: vec![curve("loss", |r| r.loss), curve("gradient", |r| r.gradient)],
        linear_x: true,
    }
    .write(&directory.join("loss"))
}
