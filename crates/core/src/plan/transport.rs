//! Transport: the sum over all pairs, or rays.

use super::{Occlusion, PlanError, PlanOptions};
use antirad_scene::{SolveSettings, VisibilityChoice};
use std::fmt;

/// How light passes between triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PlannedTransport {
    /// The sum over all pairs: visibility is implicit.
    #[default]
    AllPairs,
    /// Rays: visibility is explicit.
    Rays {
        /// Standard error of irradiance that they may cause, relative to its mean.
        error: f64,
        /// Rays of a triangle at most, on average over all.
        rays: u32,
    },
}

impl PlannedTransport {
    /// Whether visibility is explicit: light goes by rays.
    pub fn is_explicit(self) -> bool {
        matches!(self, Self::Rays { .. })
    }

    /// What settings state. Where nothing is to block, or everything, there is nothing for rays to find out.
    ///
    /// # Errors
    /// Fails for derivatives by positions of explicit visibility, which has none.
    pub(super) fn of(
        settings: &SolveSettings,
        options: &PlanOptions,
        triangles: usize,
    ) -> Result<Self, PlanError> {
        match settings.visibility {
            _ if options.occlusion != Occlusion::Exact => Ok(Self::AllPairs),
            VisibilityChoice::Implicit => Ok(Self::AllPairs),
            VisibilityChoice::Explicit if options.gradients.positions => Err(PlanError::ExplicitVisibility),
            VisibilityChoice::Explicit => {
                let rays = (ALL_RAYS / triangles.max(1) as f64).max(USUAL_RAYS) * times_as_many(settings);
                let rays = rays.clamp(f64::from(FEWEST_RAYS), f64::from(MOST_RAYS)) as u32;
                Ok(Self::Rays { error: settings.ray_error, rays })
            }
        }
    }

    /// Rays of a triangle at most, on average over all, where visibility is explicit.
    pub fn rays(self) -> Option<u32> {
        match self {
            Self::Rays { rays, .. } => Some(rays),
            Self::AllPairs => None,
        }
    }

    /// The error of irradiance that rays may cause, relative to its mean.
    pub fn error(self) -> f64 {
        match self {
            Self::AllPairs => 0.0,
            Self::Rays { error, .. } => error,
        }
    }
}

/// How many times as many rays as usual an error asks for.
fn times_as_many(settings: &SolveSettings) -> f64 {
    (USUAL_ERROR / settings.ray_error).powi(2)
}

impl fmt::Display for PlannedTransport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AllPairs => f.write_str("all pairs"),
            Self::Rays { error, rays } => {
                write!(f, "explicit visibility, error {error}, at most {rays} rays a triangle")
            }
        }
    }
}

/// Standard error of irradiance by rays where none is asked for.
const USUAL_ERROR: f64 = 0.005;
/// Rays of a triangle for that, on average over all, and rays of all triangles of small meshes, at most.
const USUAL_RAYS: f64 = 512.0;
const ALL_RAYS: f64 = (1 << 24) as f64;
/// Fewest and most of these averages.
const FEWEST_RAYS: u32 = 64;
const MOST_RAYS: u32 = 1 << 14;
