//! The errors as a table and as plots.

use crate::kind::Kind;
use antirad::cli::{Curve, Drawn, LogPlot};
use antirad::output::{OutputError, atomic_write};
use std::path::Path;

/// Gradients below this fraction of the largest of their kind count as zero, and their errors are taken relative to the
/// largest: relative to itself, a negligible gradient shows rounding alone.
const NO_INFLUENCE: f64 = 1e-2;

/// One parameter at one step. The loss per step of 1.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Row {
    pub mesh: String,
    pub bins: String,
    pub kind: Kind,
    /// Index of the triangle, vertex or camera.
    pub index: usize,
    /// ε, relative to the size of the parameter.
    pub step: f64,
    /// |∇|
    pub gradient: f64,
    /// |fd|
    pub slope: f64,
    /// |fd - ∇|
    pub difference: f64,
}

impl Row {
    /// |fd - ∇| / (|fd| + |∇|).
    pub fn error(&self) -> f64 {
        if self.difference == 0.0 { 0.0 } else { self.difference / (self.slope + self.gradient) }
    }

    /// Error relative to |fd| + |∇|, or to `largest` where the parameter has no influence.
    fn error_beside(&self, largest: f64) -> f64 {
        let matters = self.gradient >= NO_INFLUENCE * largest;
        if matters || self.difference == 0.0 { self.error() } else { self.difference / largest }
    }
}

/// The minima shown in *Differentiable Radiosity for Inverse Rendering*.
fn of_paper(kind: Kind) -> Option<f64> {
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

/// Rows of the same mesh and kind, which follow one another.
fn groups(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(|a, b| (a.kind, &a.mesh) == (b.kind, &b.mesh))
}

/// e(ε): the mean over all samples at every step.
fn errors(group: &[Row]) -> Vec<(f64, f64)> {
    let largest = group.iter().map(|row| row.gradient).fold(f64::MIN_POSITIVE, f64::max);
    let mean = |rows: &[Row]| rows.iter().map(|r| r.error_beside(largest)).sum::<f64>() / rows.len() as f64;
    group.chunk_by(|a, b| a.step == b.step).map(|rows| (rows[0].step, mean(rows))).collect()
}

/// The largest of the samples' own minima over the step: the error of the worst of them, relative to itself.
fn worst_sample(group: &[Row]) -> f64 {
    let own = |row: &Row| {
        let same = group.iter().filter(|other| other.index == row.index);
        same.map(Row::error).min_by(f64::total_cmp).unwrap_or(f64::NAN)
    };
    group.iter().map(own).max_by(f64::total_cmp).unwrap_or(f64::NAN)
}

fn curve(group: &[Row], label: String) -> Curve {
    // A logarithmic axis has no place for zero.
    let points = errors(group).into_iter().map(|(step, error)| (step, error.max(1e-17))).collect();
    Curve { label, points, drawn: Drawn::Curve }
}

/// The panels of the paper (emission, albedo, centroid), each with all its meshes, and one with all other kinds.
pub fn plot(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    let panels = [Kind::Emission, Kind::Albedo, Kind::Centroid];
    let draw = |title: &str, curves: Vec<Curve>, file: &str| match curves.is_empty() {
        true => Ok(()),
        false => LogPlot {
            title: title.to_owned(),
            x: "step ε, relative to the size of the parameter".to_owned(),
            y: "e(ε) = |fd - g| / (|fd| + |g|)".to_owned(),
            curves,
            linear_x: false,
        }
        .write(&directory.join(file)),
    };
    for panel in panels {
        let mut curves: Vec<Curve> = groups(rows)
            .filter(|group| group[0].kind == panel)
            .map(|group| curve(group, format!("{} mesh", group[0].mesh)))
            .collect();
        if let (Some(level), false) = (of_paper(panel), curves.is_empty()) {
            let ends = curves[0].points.iter().map(|&(step, _)| (step, level)).collect();
            curves.push(Curve { label: "minimum in the paper".to_owned(), points: ends, drawn: Drawn::Line });
        }
        draw(
            &format!("Gradients with respect to {}", panel.name()),
            curves,
            &format!("gradients_{}", key(panel)),
        )?;
    }
    let rest = groups(rows).filter(|group| !panels.contains(&group[0].kind));
    let curves =
        rest.map(|group| curve(group, format!("{}, {} mesh", group[0].kind.name(), group[0].mesh))).collect();
    draw("Gradients beyond those of the paper", curves, "gradients_rest")
}

fn key(kind: Kind) -> &'static str {
    kind.name().split(' ').next().unwrap_or_default()
}

pub fn print(rows: &[Row], all: bool) {
    antirad::say!(
        "{:<9} {:<10} {:>8} {:>8} {:>8} {:>9} {:>13}",
        "mesh",
        "kind",
        "minimum",
        "at ε",
        "must be",
        "paper",
        "worst sample"
    );
    for group in groups(rows) {
        let errors = errors(group);
        let Some((step, error)) = errors.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
        let or_none = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.0e}"));
        antirad::say!(
            "{:<9} {:<10} {error:>8.1e} {step:>8.0e} {:>8} {:>9} {:>13.1e}",
            group[0].mesh,
            group[0].kind.name(),
            or_none(group[0].kind.target(&group[0].mesh)),
            or_none(of_paper(group[0].kind)),
            worst_sample(group),
        );
        if all {
            let all: Vec<String> = errors.iter().map(|(_, error)| format!("{error:.1e}")).collect();
            antirad::say!("          from the largest step: {}", all.join(" "));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(index: usize, step: f64, [gradient, slope, difference]: [f64; 3]) -> Row {
        let (mesh, bins) = ("m".to_owned(), "b".to_owned());
        Row { mesh, bins, kind: Kind::Albedo, index, step, gradient, slope, difference }
    }

    #[test]
    fn errors_are_relative_where_there_is_influence() {
        let rows = [
            row(0, 0.1, [0.5, 1.5, 1.0]),
            row(1, 0.1, [0.0, 0.0, 0.0]),
            row(0, 0.01, [0.5, 0.5, 1e-6]),
            row(1, 0.01, [0.0, 1e-6, 1e-6]),
        ];
        assert_eq!(errors(&rows), [(0.1, 0.25), (0.01, 1.5e-6)]);
        assert_eq!(worst_sample(&rows), 1e-6);
    }

    /// NaN must stand out.
    #[test]
    fn a_nan_is_not_a_minimum() {
        let rows = [row(0, 0.1, [1.0, f64::NAN, f64::NAN]), row(0, 0.01, [1.0, f64::NAN, f64::NAN])];
        assert!(errors(&rows).iter().all(|e| e.1.is_nan()) && worst_sample(&rows).is_nan());
    }
}
