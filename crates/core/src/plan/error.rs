//! Errors of planning.

use super::RankWeights;
use antirad_scene::{Precision, SceneError};

/// Why a scene cannot be planned. Each message is one line with the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The scene or its settings are invalid.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The number of triangles per tile is not supported.
    #[error("tiles of {0} triangles: kernels support 32 or 64")]
    #[doc(hidden)]
    Tile(u32),
    #[error(
        "a tolerance of {wanted:e} is below the rounding of precision \"{precision}\": choose {least:e} or more, or \
         another precision (\"f64\" on a device that has it)"
    )]
    /// The precision does not resolve residuals that small.
    Tolerance {
        /// The relative residual required.
        wanted: f64,
        /// The smallest that the precision resolves.
        least: f64,
        /// Precision of the numbers on the device.
        precision: Precision,
    },
    /// Derivatives by positions are wanted, and sampled direct light.
    #[error(
        "direct light by rays has no derivatives by positions: choose lamps = \"exact\" or \"antiradiance\""
    )]
    SampledLamps,
    /// Derivatives by positions are wanted, and explicit visibility.
    #[error("explicit visibility has no derivatives by positions: choose visibility = \"implicit\"")]
    ExplicitVisibility,
    /// No triangle has an area.
    #[error("the scene has no triangle with an area, so there is nothing to solve")]
    NothingToSolve,
    #[error(
        "a memory budget of {budget} bytes is too small: this scene needs at least {needed} bytes with these bins \
         (--memory-budget {needed}, or fewer bins, or fewer triangles)"
    )]
    /// Even the smallest plan exceeds the budget.
    OverBudget {
        /// Bytes that buffers may take.
        budget: u64,
        /// Bytes that the smallest plan takes.
        needed: u64,
    },
    #[error(
        "the buffer \"{label}\" needs {bytes} bytes, but kernels on this device can bind at most {limit} bytes: \
         fewer triangles, or a smaller near field (settings.near_field)"
    )]
    /// A buffer exceeds the size that kernels can bind.
    #[doc(hidden)]
    BufferTooLarge {
        /// Label of the buffer.
        label: String,
        /// Size of the buffer, bytes.
        bytes: u64,
        /// Bytes of a buffer that kernels can bind.
        limit: u64,
    },
    /// A process is not one of those that solve a scene together.
    #[error("process {rank} of {ranks}: numbers count from 0 to one less than the number of processes")]
    Rank {
        /// The number given.
        rank: u32,
        /// How many there are.
        ranks: u32,
    },
    /// Not every process has a share of the work.
    #[error("{weights:?} for {ranks} processes: each needs one above 0, or none has one (RankWeights::EVEN)")]
    #[doc(hidden)]
    Weights {
        /// The weights given.
        weights: RankWeights,
        /// How many processes there are.
        ranks: u32,
    },
    /// More pairs, or runs of tiles, than 32-bit indices can address.
    #[error(
        "{count} {what} exceed 32-bit indices: use fewer triangles, or a smaller near field \
         (settings.near_field)"
    )]
    #[doc(hidden)]
    TooManyPairs {
        /// What is counted.
        what: &'static str,
        /// How many there are.
        count: u64,
    },
}
