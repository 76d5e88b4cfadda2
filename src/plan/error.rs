//! Why there is no plan.

use crate::scene::{Precision, SceneError};

/// One clear line, with the remedy.
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
    /// Numbers of the precision cannot tell residuals as small as that.
    Tolerance {
        /// The relative residual that was asked for.
        wanted: f64,
        /// The smallest that the precision can tell.
        least: f64,
        /// Of the numbers on the device.
        precision: Precision,
    },
    /// No triangle has an area.
    #[error("the scene has no triangle with an area: there is nothing to solve")]
    NothingToSolve,
    #[error(
        "a memory budget of {budget} bytes is too small: this scene needs at least {needed} bytes with these bins \
         (--memory-budget {needed}, or fewer bins, or fewer triangles)"
    )]
    /// Not even the least memory fits the budget.
    OverBudget {
        /// Bytes that buffers may take.
        budget: u64,
        /// Bytes that would do.
        needed: u64,
    },
    #[error(
        "the buffer \"{label}\" needs {bytes} bytes, and the device's kernels see at most {limit} bytes of one buffer: \
         fewer triangles, or a smaller near field (settings.near_field)"
    )]
    BufferTooLarge {
        /// Of the buffer.
        label: String,
        /// Its size.
        bytes: u64,
        /// Bytes that kernels see of a buffer.
        limit: u64,
    },
    /// More pairs, or runs of tiles, than an index can number.
    #[error(
        "{count} {what} are more than 32-bit indices can tell apart: fewer triangles, or a smaller near field \
         (settings.near_field)"
    )]
    TooManyPairs {
        /// What is counted.
        what: &'static str,
        /// How many there are.
        count: u64,
    },
}
