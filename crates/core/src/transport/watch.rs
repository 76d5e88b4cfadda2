//! Progress within a pass, interruption, and errors of transport.

use antirad_base::ranks::RankError;
use antirad_base::usage::OverBudget;
use antirad_gpu::GpuError;
use std::any::Any;
use std::ops::ControlFlow;

/// Called after each step of a quarter of a second at most, with the number of pairs done and that of the whole
/// pass; may stop the work.
pub type PassCallback = Box<dyn FnMut(u64, u64) -> ControlFlow<()> + Send>;

/// Why a pass failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransportError {
    /// The device, or a call into it, failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// Ranks can no longer work together.
    #[error(transparent)]
    Ranks(#[from] RankError),
    /// The memory budget of the CPU does not hold another array.
    #[error(transparent)]
    OverBudget(#[from] OverBudget),
    /// A plan or a state belongs to another backend, or to operators of another precision.
    #[error(
        "a plan or a state of another backend or precision: plan with PlanOptions::of(backend), and use states with the operators that \
         made them"
    )]
    OtherBackend,
    /// A callback stopped the pass; its output is undefined.
    #[error("interrupted")]
    Interrupted,
    #[error(
        "the host cannot allocate {bytes} bytes for another vector of the solver: use the fixed point, which needs two \
         (--solver fixed-point), fewer bins, or a larger memory budget, with which vectors stay on the device"
    )]
    /// States live on the host, and it has no memory for another one.
    HostMemory {
        /// Size of the state, or of the part that did not fit.
        bytes: u64,
    },
    /// The adjoint requires states on the device, but they live on the host.
    #[error(
        "gradients require the solver's vectors on the device, but they are on the host: request them in \
         PlanOptions::gradients"
    )]
    NotResident,
    /// A kernel or buffer is missing; without it the result would be wrong but plausible.
    #[error("the plan requires {what}, which the engine lacks: a bug in antirad")]
    Missing {
        /// What is missing, in words.
        what: String,
    },
    /// A part lies outside a state on the host.
    #[error(
        "bytes {begin}..{end} are outside the {bytes} bytes of bins of a state on the host: a bug in antirad"
    )]
    OutsideOfState {
        /// First byte of the part.
        begin: u64,
        /// One past its last byte.
        end: u64,
        /// Size of the state's bins.
        bytes: u64,
    },
    /// The thread that brings bins of other ranks has panicked.
    #[error("bins of other ranks could not be brought: {why}: a bug in antirad")]
    Panicked {
        /// What it panicked with, where that is text.
        why: String,
    },
    /// Derivatives that were not planned.
    #[error("gradients were not planned: request them in PlanOptions::gradients and plan again")]
    NotPlanned,
}

impl TransportError {
    /// Whether the same call may succeed later, as [`GpuError::may_pass`] and [`RankError::may_pass`] tell;
    /// false for all other errors.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Gpu(error) => error.may_pass(),
            Self::Ranks(error) => error.may_pass(),
            _ => false,
        }
    }

    pub(super) fn missing(what: impl Into<String>) -> Self {
        Self::Missing { what: what.into() }
    }

    /// The error for a thread that panicked with `payload`.
    pub(super) fn panicked(payload: &(dyn Any + Send)) -> Self {
        let text = payload.downcast_ref::<&str>().copied();
        let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str));
        Self::Panicked { why: text.unwrap_or("the panic of a thread says no more").to_owned() }
    }
}

/// Counts the pairs of a pass.
#[derive(Default)]
pub struct Progress {
    pub callback: Option<PassCallback>,
    done: u64,
    total: u64,
}

impl Progress {
    /// A pass over `total` pairs begins.
    pub fn begin(&mut self, total: u64) {
        (self.done, self.total) = (0, total);
    }

    /// Work on `pairs` pairs has ended, or is recorded.
    ///
    /// # Errors
    /// Fails with [`TransportError::Interrupted`] if the callback stops the pass.
    pub fn done(&mut self, pairs: u64) -> Result<(), TransportError> {
        self.done += pairs;
        match self.callback.as_mut().map(|callback| callback(self.done, self.total)) {
            Some(ControlFlow::Break(())) => Err(TransportError::Interrupted),
            _ => Ok(()),
        }
    }
}
