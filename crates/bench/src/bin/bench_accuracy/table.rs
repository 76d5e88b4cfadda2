//! The measurements as a table and as plots.

use crate::cases::Case;
use crate::sweep::{BY_ANTIRADIANCE, Setting};
use antirad::cli::{Curve, Drawn, LogPlot};
use antirad::output::{OutputError, atomic_write};
use antirad::scene::SolveSettings;
use std::fmt;
use std::path::Path;

/// One measurement. `None` where a value does not apply to the scene, or the solve failed.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Row {
    pub scene: String,
    pub varies: &'static str,
    pub triangles: usize,
    /// How often the scene's triangles are cut into four.
    pub cuts: u32,
    pub bins: String,
    pub bin_count: usize,
    pub near_field: f64,
    pub precision: String,
    pub lamps: String,
    pub solver: String,
    pub tolerance: f64,
    /// The target error, if settings were found for one.
    pub asked: Option<f64>,
    /// The estimate of the error.
    pub estimate: Option<f64>,
    /// Time of the direct light of lamps and the solve, s; for a target error, of all attempts.
    pub seconds: f64,
    pub passes: u32,
    /// Device memory.
    pub bytes: u64,
    /// Area-weighted relative L2 of irradiance.
    pub error: Option<f64>,
    /// Largest error of a triangle's irradiance, relative to the mean.
    pub largest_error: Option<f64>,
    /// L2 inside shadows, relative to the light blocked there.
    pub shadow_error: Option<f64>,
    /// L2 over all triangles, relative to the blocked light.
    pub floor_error: Option<f64>,
    /// Relative mean squared error of the picture.
    pub picture_error: Option<f64>,
    /// Relative error of the power absorbed by diffuse surfaces.
    pub absorbed_error: Option<f64>,
    /// Triangles with negative irradiance.
    pub negative: usize,
    pub failure: String,
    #[serde(skip)]
    pub residuals: Vec<f64>,
}

impl Row {
    pub fn new(case: &Case, setting: &Setting) -> Self {
        let SolveSettings { bins, near_field, tolerance, solver, precision, lamps, .. } = setting.solve;
        Self {
            scene: case.name.clone(),
            varies: setting.varies,
            triangles: 0,
            cuts: setting.level,
            bins: bins.to_string(),
            bin_count: bins.count(),
            near_field,
            precision: format!("{precision:?}").to_lowercase(),
            lamps: format!("{lamps:?}").to_lowercase(),
            solver: format!("{solver:?}").to_lowercase(),
            tolerance,
            asked: None,
            estimate: None,
            seconds: 0.0,
            passes: 0,
            bytes: 0,
            error: None,
            largest_error: None,
            shadow_error: None,
            floor_error: None,
            picture_error: None,
            absorbed_error: None,
            negative: 0,
            failure: String::new(),
            residuals: Vec::new(),
        }
    }

    fn setting(&self) -> String {
        let Self { bins, near_field, precision, solver, tolerance, lamps, .. } = self;
        let cuts = match self.cuts {
            0 => String::new(),
            n => format!(", cut {n}x"),
        };
        let asked = match (self.asked, self.estimate) {
            (Some(asked), Some(estimate)) => {
                format!(" (target {:.1} %, estimated {:.2} %)", 100.0 * asked, 100.0 * estimate)
            }
            _ => String::new(),
        };
        format!("{bins} near {near_field} {precision} {solver} {tolerance:.0e}, lamps {lamps}{cuts}{asked}")
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.error {
            Some(error) => {
                write!(f, "{:.3} % in {:.2} s, {} passes", 100.0 * error, self.seconds, self.passes)
            }
            None => write!(f, "{}", self.failure),
        }
    }
}

const FILE: &str = "accuracy.csv";

pub fn write(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    atomic_write(&directory.join(FILE), |file| {
        let mut table = csv::Writer::from_writer(file);
        for row in rows {
            table.serialize(row).map_err(std::io::Error::other)?;
        }
        table.flush()
    })
}

/// The measurements of one scene after the other, in their order.
fn scenes(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(|a, b| a.scene == b.scene)
}

/// The Pareto front of error and time of some rows, by time.
fn front(rows: &[Row], of: impl Fn(&Row) -> bool) -> Vec<&Row> {
    let mut sorted: Vec<&Row> = rows.iter().filter(|row| row.error.is_some() && of(row)).collect();
    sorted.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let mut best = f64::INFINITY;
    sorted.retain(|row| {
        let better = row.error.is_some_and(|error| error < best);
        if better {
            best = row.error.unwrap_or(best);
        }
        better
    });
    sorted
}

pub fn plot(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    for rows in scenes(rows) {
        let name = &rows[0].scene;
        let of = |varies: &str| -> Vec<(f64, f64)> {
            let same = rows.iter().filter(|row| row.varies == varies);
            same.filter_map(|row| Some((row.seconds, row.error?))).collect()
        };
        let mut kinds: Vec<&str> = rows.iter().map(|row| row.varies).collect();
        kinds.sort_unstable();
        kinds.dedup();
        let mut curves: Vec<Curve> = kinds
            .iter()
            .map(|kind| Curve { label: (*kind).to_owned(), points: of(kind), drawn: Drawn::Points })
            .collect();
        for (label, older) in [("Pareto front", false), ("the same, lamps by antiradiance", true)] {
            let of = |row: &Row| (row.varies == BY_ANTIRADIANCE) == older;
            let best =
                front(rows, of).into_iter().filter_map(|row| Some((row.seconds, row.error?))).collect();
            curves.push(Curve { label: label.to_owned(), points: best, drawn: Drawn::Line });
        }
        plot_one(
            directory,
            "error_seconds",
            name,
            "time of direct light and solve / s",
            "relative error of irradiance",
            curves,
        )?;

        let mut layouts: Vec<&str> =
            rows.iter().filter(|row| row.varies == "bins").map(|row| row.bins.as_str()).collect();
        layouts.sort_unstable();
        layouts.dedup();
        let curve = |bins: &&str| {
            let same = rows.iter().filter(|row| row.varies == "bins" && row.bins == **bins);
            let points = same.filter_map(|row| Some((row.triangles as f64, row.error?))).collect();
            Curve { label: format!("bins {bins}"), points, drawn: Drawn::Curve }
        };
        let curves = layouts.iter().map(curve).collect();
        plot_one(directory, "error_triangles", name, "triangles", "relative error of irradiance", curves)?;

        let solves = rows.iter().filter(|row| row.varies == "solver" && !row.residuals.is_empty());
        let curves: Vec<Curve> = solves
            .map(|row| Curve {
                label: row.solver.clone(),
                points: row.residuals.iter().enumerate().map(|(k, r)| (k as f64 + 1.0, *r)).collect(),
                drawn: Drawn::Curve,
            })
            .collect();
        plot_one(directory, "residual_passes", name, "passes", "relative residual", curves)?;
    }
    Ok(())
}

fn plot_one(
    directory: &Path,
    kind: &str,
    scene: &str,
    x: &str,
    y: &str,
    curves: Vec<Curve>,
) -> Result<(), OutputError> {
    if curves.iter().all(|curve| curve.points.is_empty()) {
        return Ok(());
    }
    let linear_x = kind == "residual_passes";
    let (x, y, title) = (x.to_owned(), y.to_owned(), scene.to_owned());
    // A dot in the scene's name would start the file's extension.
    let file = format!("{kind}_{}", scene.replace('.', "-"));
    LogPlot { title, x, y, curves, linear_x }.write(&directory.join(file))
}

/// Prints the best rows of each scene.
pub fn print(rows: &[Row]) {
    let share =
        |value: Option<f64>| value.map_or_else(|| String::from("-"), |v| format!("{:.3} %", 100.0 * v));
    for rows in scenes(rows) {
        antirad::say!("{}", rows[0].scene);
        antirad::say!(
            "  {:>9} {:>9} {:>9} {:>9} {:>8} {:>7} {:>9}  setting",
            "error",
            "largest",
            "shadows",
            "picture",
            "seconds",
            "passes",
            "triangles"
        );
        let usual = |older| {
            let of = move |row: &&Row| {
                row.bins == "10x13" && row.cuts == 0 && (row.varies == BY_ANTIRADIANCE) == older
            };
            rows.iter().find(of)
        };
        let asked = rows.iter().filter(|row| row.asked.is_some());
        for (row, mark) in usual(false)
            .into_iter()
            .map(|row| (row, "usual"))
            .chain(usual(true).map(|row| (row, "older")))
            .chain(front(rows, |_| true).into_iter().map(|row| (row, "front")))
            .chain(asked.map(|row| (row, "asked")))
        {
            antirad::say!(
                "  {:>9} {:>9} {:>9} {:>9} {:>8.2} {:>7} {:>9}  {mark}: {}",
                share(row.error),
                share(row.largest_error),
                share(row.floor_error.or(row.shadow_error)),
                share(row.picture_error),
                row.seconds,
                row.passes,
                row.triangles,
                row.setting()
            );
        }
        for row in rows.iter().filter(|row| !row.failure.is_empty()) {
            antirad::say!("  failed: {}: {}", row.setting(), row.failure);
        }
    }
}
