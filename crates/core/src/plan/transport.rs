//! Transport: the sum over all pairs, or rays.

use std::fmt;

/// How light passes between triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PlannedTransport {
    /// The sum over all pairs: visibility is implicit.
    #[default]
    AllPairs,
    /// Rays: visibility is explicit.
    Rays {
        /// Rays of a triangle.
        rays: u32,
        /// Why visibility is explicit.
        why: &'static str,
    },
}

impl PlannedTransport {
    /// Whether visibility is explicit: light goes by rays.
    pub fn is_explicit(self) -> bool {
        matches!(self, Self::Rays { .. })
    }

    /// Rays of a triangle where visibility is explicit.
    pub fn rays(self) -> Option<u32> {
        match self {
            Self::Rays { rays, .. } => Some(rays),
            Self::AllPairs => None,
        }
    }
}

impl fmt::Display for PlannedTransport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AllPairs => f.write_str("all pairs"),
            Self::Rays { rays, why } => write!(f, "explicit visibility, {rays} rays a triangle: {why}"),
        }
    }
}

/// Error of irradiance by one ray, relative to its mean over the area: by n it falls as n^(-1/2). The usual error takes 512 rays.
const OF_A_RAY: f64 = 0.113;
/// Fewest and most rays of a triangle.
const FEWEST_RAYS: u32 = 64;
const MOST_RAYS: u32 = 1 << 16;

/// Rays of a triangle for the error that irradiance may have: a power of two, by which Sobol' points are evenly spread.
pub(super) fn rays_for(error: f64) -> u32 {
    let enough = (OF_A_RAY / error).powi(2).ceil().min(f64::from(MOST_RAYS)) as u32;
    enough.next_power_of_two().clamp(FEWEST_RAYS, MOST_RAYS)
}
