//! Why there is no plan.

use crate::scene::{Precision, SceneError};

/// One clear line, with the way out.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The scene or the accuracy cannot be solved.
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("tiles of {0} triangles: kernels take 32 or 64")]
    Tile(u32),
    #[error(
        "a tolerance of {wanted:e} is more than precision \"{precision}\" can tell: choose {least:e} or more, or another \
         precision (\"f64\" on a device that has it)"
    )]
    Tolerance { wanted: f64, least: f64, precision: Precision },
    #[error("the scene has no triangle with an area: there is nothing to solve")]
    NothingToSolve,
    #[error(
        "a memory budget of {budget} bytes is too small: this scene needs at least {needed} bytes with these bins \
         (--memory-budget {needed}, or fewer bins, or fewer triangles)"
    )]
    OverBudget { budget: u64, needed: u64 },
    #[error(
        "the buffer \"{label}\" needs {bytes} bytes, and the device's kernels see at most {limit} bytes of one buffer: \
         fewer triangles, or a smaller near field (accuracy.subsample)"
    )]
    BufferTooLarge { label: String, bytes: u64, limit: u64 },
    #[error(
        "{count} {what} are more than 32-bit indices can tell apart: fewer triangles, or a smaller near field \
         (accuracy.subsample)"
    )]
    TooManyPairs { what: &'static str, count: u64 },
}
