//! Which settings are measured.

use crate::cases::Case;
use antirad::scene::{BinLayout, Lamps, Precision, SolveSettings, SolverChoice, VisibilityChoice};
use antirad::target_error::TargetErrorOptions;
use std::fmt;

/// One measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    pub solve: SolveSettings,
    /// How often every triangle is cut into four.
    pub level: u32,
    /// The setting that is varied.
    pub varies: &'static str,
}

impl Setting {
    /// Rough cost, for the progress bar.
    pub fn cost(&self) -> f64 {
        let precision = match self.solve.precision {
            Precision::F32 => 1.0,
            Precision::F64 => 3.0,
        };
        16_f64.powi(self.level as i32) * precision
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let SolveSettings { bins, near_field, tolerance, solver, precision, lamps, .. } = self.solve;
        let cuts = self.level;
        write!(
            f,
            "{bins} near {near_field} {precision:?} {solver:?} {tolerance:.0e}, lamps {lamps:?}, {cuts} cuts"
        )
    }
}

/// Target errors for which settings are found. Each costs about [`ASKED_COST`].
pub fn asked(quick: bool) -> Vec<TargetErrorOptions> {
    let options = |&error| match quick {
        true => TargetErrorOptions::new(error).max_triangles(20_000),
        false => TargetErrorOptions::new(error),
    };
    [0.05, 0.02, 0.01].iter().map(options).collect()
}

/// Rough cost of a target error, in the unit of [`Setting::cost`].
pub const ASKED_COST: f64 = 20.0;

const TIGHT: f64 = 1e-5;

/// The varied setting where the light of lamps goes through bins, as all other light does.
pub const BY_ANTIRADIANCE: &str = "lamps by antiradiance";

/// The defaults and variations of one setting each; triangles, bins and lamps together. `quick` leaves out finer meshes of
/// scenes that are large already, and settings known to matter little.
pub fn settings(case: &Case, quick: bool) -> Vec<Setting> {
    let usual = SolveSettings::default().tolerance(TIGHT).visibility(VisibilityChoice::Implicit);
    let mut settings: Vec<Setting> = Vec::new();
    let mut add = |varies: &'static str, level: u32, solve: SolveSettings| {
        let setting = Setting { solve, level, varies };
        let known = settings.iter().any(|s| s.solve == solve && s.level == level);
        if !known {
            settings.push(setting);
        }
    };
    let equal = |theta, phi| BinLayout::EqualAngle { theta, phi };
    let square = |n| BinLayout::Concentric { n };
    let layouts: &[BinLayout] = match quick {
        true => &[equal(6, 8), equal(10, 13), square(8), square(12)],
        false => &[
            equal(4, 6),
            equal(6, 8),
            equal(10, 13),
            equal(14, 18),
            equal(20, 26),
            square(6),
            square(8),
            square(12),
            square(16),
            square(24),
        ],
    };
    let finest = match (case.scene.triangles.len(), quick) {
        (0..1000, true) | (1000..4000, false) => 1,
        (0..1000, false) => 2,
        _ => 0,
    };
    for level in 0..=finest {
        for &bins in layouts {
            add("bins", level, usual.bins(bins));
            add(BY_ANTIRADIANCE, level, usual.bins(bins).lamps(Lamps::Antiradiance));
        }
    }
    let near: &[f64] = if quick { &[0.0, 10.0, 60.0] } else { &[0.0, 3.0, 10.0, 60.0, 120.0] };
    for &near_field in near {
        add("near field", 0, usual.near_field(near_field));
        if !quick || near_field <= 10.0 {
            add("near field", 0, usual.near_field(near_field).bins(square(8)));
        }
    }
    if !quick {
        add("precision", 0, usual.precision(Precision::F64));
    }
    let tolerances: &[f64] = if quick { &[1e-2, 1e-3] } else { &[1e-1, 1e-2, 1e-3, 1e-4, 1e-6] };
    for solver in [SolverChoice::FixedPoint, SolverChoice::Gmres] {
        add("solver", 0, usual.solver(solver));
        for &tolerance in tolerances {
            add("tolerance", 0, usual.solver(solver).tolerance(tolerance));
        }
    }
    settings
}
