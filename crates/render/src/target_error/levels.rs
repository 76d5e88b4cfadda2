//! Refinement levels: settings from cheap to accurate, and the level at which a scene starts.

use antirad_scene::{BinLayout, SolveSettings};
use std::f64::consts::SQRT_2;

/// One refinement level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    /// Bins along a side of the square, of glossy triangles alone.
    bins: u32,
    /// The error of irradiance that rays may cause.
    rays: f64,
    pub tolerance: f64,
    /// Typical error of the level in the sweep of `bench_accuracy`.
    usual: f64,
}

const fn level(bins: u32, rays: f64, tolerance: f64, usual: f64) -> Level {
    Level { bins, rays, tolerance, usual }
}

/// What is left to refine is the mesh, where the estimate says.
pub(super) const LEVELS: [Level; 5] = [
    level(8, 0.0072, 3e-3, 0.015),
    level(16, 0.0036, 1e-3, 0.008),
    level(16, 0.0018, 1e-3, 0.004),
    level(24, 0.0009, 3e-4, 0.002),
    level(32, 0.00045, 1e-4, 0.001),
];

/// The largest error that rays may cause.
const COARSEST: f64 = 0.2;

impl Level {
    /// The first level whose usual error is within `error`, or the last.
    pub fn start(error: f64) -> usize {
        LEVELS.iter().position(|level| level.usual <= error).unwrap_or(LEVELS.len() - 1)
    }

    /// The level for a mesh of so many times as many triangles as it started with: of the same number of rays in all.
    pub fn with_finer(self, times: f64) -> Self {
        Self { rays: (self.rays * times.sqrt()).min(COARSEST), ..self }
    }

    pub fn settings(&self, base: &SolveSettings) -> SolveSettings {
        base.bins(BinLayout::Concentric { n: self.bins }).tolerance(self.tolerance).ray_error(self.rays)
    }

    /// Settings of the comparison solve: fewer bins and half the rays, so that its errors are as large or larger. The difference between half
    /// of the rays and all is then as large as the error of these, if halves are independent; evenly spread as they are, it is larger.
    pub fn comparison(&self, base: &SolveSettings) -> SolveSettings {
        let fewer = (self.bins * 5 / 6).next_multiple_of(2);
        let n = if fewer < self.bins { fewer } else { fewer - 2 };
        self.settings(base).bins(BinLayout::Concentric { n }).ray_error(SQRT_2 * self.rays)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comparisons_have_other_settings() {
        for level in &LEVELS {
            let base = SolveSettings::default();
            let (own, other) = (level.settings(&base), level.comparison(&base));
            assert!(other.ray_error > own.ray_error && other.bins != own.bins, "{own:?}, {other:?}");
        }
    }

    /// What a level is expected to leave falls from each to the next, and so does what its rays may cause.
    #[test]
    fn levels_go_from_cheap_to_accurate() {
        let falls = LEVELS.windows(2).all(|two| two[1].usual < two[0].usual && two[1].rays < two[0].rays);
        assert!(falls, "{LEVELS:?}");
    }
}
