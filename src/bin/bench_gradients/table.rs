//! The errors as a table and as plots.

use crate::kind::Kind;
use antirad::cli::{Curve, LogLogPlot};
use antirad::output::{OutputError, atomic_write};
use std::path::Path;

/// Errors of one kind at one step.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Row {
    pub mesh: String,
    pub weights: String,
    pub bins: String,
    pub kind: Kind,
    /// ε, relative to the size of the parameter.
    pub step: f64,
    pub samples: usize,
    /// e(ε), the mean over the samples.
    pub error: f64,
    pub worst: f64,
}

/// Published minima.
fn published(kind: Kind) -> Option<f64> {
    match kind {
        Kind::Emission | Kind::Albedo => Some(1e-8),
        Kind::Centroid => Some(1e-3),
        _ => None,
    }
}

pub fn write(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    atomic_write(&directory.join("gradients.csv"), |file| {
        let mut writer = csv::Writer::from_writer(file);
        for row in rows {
            writer.serialize(row)?;
        }
        writer.flush()
    })
}

/// Rows of the same mesh, weights and kind, which follow one another.
fn groups(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(|a, b| (a.kind, &a.mesh, &a.weights) == (b.kind, &b.mesh, &b.weights))
}

fn curve(rows: &[Row], label: String) -> Curve {
    // A logarithmic axis has no place for zero.
    let points = rows.iter().map(|row| (row.step, row.error.max(1e-17))).collect();
    Curve { label, points, reference: false }
}

/// The published panels (emission, albedo, centroid), each with all its meshes, and one with all other kinds.
pub fn plot(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    let panels = [Kind::Emission, Kind::Albedo, Kind::Centroid];
    let draw = |title: &str, curves: Vec<Curve>, file: &str| match curves.is_empty() {
        true => Ok(()),
        false => LogLogPlot {
            title: title.to_owned(),
            x: "step ε, relative to the size of the parameter".to_owned(),
            y: "e(ε) = |fd - ∇| / (|fd| + |∇|)".to_owned(),
            curves,
        }
        .write(&directory.join(file)),
    };
    for panel in panels {
        let mut curves: Vec<Curve> = groups(rows)
            .filter(|group| group[0].kind == panel)
            .map(|group| curve(group, format!("{} mesh, {} weights", group[0].mesh, group[0].weights)))
            .collect();
        if let (Some(level), false) = (published(panel), curves.is_empty()) {
            let ends = curves[0].points.iter().map(|&(step, _)| (step, level)).collect();
            curves.push(Curve { label: "published minimum".to_owned(), points: ends, reference: true });
        }
        draw(&format!("Gradients with respect to {}", panel.name()), curves, &format!("gradients_{}", key(panel)))?;
    }
    let rest = groups(rows).filter(|group| !panels.contains(&group[0].kind));
    let curves = rest
        .map(|group| {
            let weights = if group[0].weights == "bilinear" { "" } else { ", smoothstep" };
            curve(group, format!("{}, {} mesh{weights}", group[0].kind.name(), group[0].mesh))
        })
        .collect();
    draw("Gradients beyond those published", curves, "gradients_rest")
}

fn key(kind: Kind) -> &'static str {
    kind.name().split(' ').next().unwrap_or_default()
}

pub fn print(rows: &[Row], all: bool) {
    let order = |a: &&Row, b: &&Row| a.error.total_cmp(&b.error);
    println!(
        "{:<10} {:<11} {:<12} {:>7} {:>10} {:>8} {:>8} {:>10}",
        "mesh", "weights", "kind", "samples", "minimum", "at ε", "must be", "published"
    );
    for group in groups(rows) {
        let Some(best) = group.iter().min_by(order) else { continue };
        let or_none = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.0e}"));
        println!(
            "{:<10} {:<11} {:<12} {:>7} {:>10.1e} {:>8.0e} {:>8} {:>10}",
            best.mesh,
            best.weights,
            best.kind.name(),
            best.samples,
            best.error,
            best.step,
            or_none(best.kind.target(&best.mesh)),
            or_none(published(best.kind)),
        );
        if all {
            for row in group {
                println!("    ε {:.0e}: mean {:.1e}, worst {:.1e}", row.step, row.error, row.worst);
            }
        }
    }
}
