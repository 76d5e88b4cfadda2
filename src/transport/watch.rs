//! Looking on while the device works, and stopping it.

use crate::gpu::GpuError;
use std::ops::ControlFlow;

/// Called after every submission, of a quarter of a second at most, with the pairs done and the pairs of the whole pass;
/// may stop the work.
pub type PassCallback = Box<dyn FnMut(u64, u64) -> ControlFlow<()> + Send>;

/// Why a pass did not end.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TransportError {
    /// The device, or a call into it, failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A watcher stopped the pass; what it would have written is undefined.
    #[error("interrupted")]
    Interrupted,
    #[error(
        "the host has no {bytes} bytes for one more vector of the solver: the fixed point needs two (--solver \
         fixed-point), a larger memory budget of the device none, fewer bins smaller ones"
    )]
    /// States live on the host, and it has no room for another one.
    HostMemory {
        /// Size of the state, or of the part that did not fit.
        bytes: u64,
    },
    /// An adjoint was asked of states that live on the host.
    #[error(
        "gradients need the solver's vectors on the device, and these are on the host: name the gradients in Limits"
    )]
    NotResident,
    /// Going on without it would lose light and give a wrong answer that looks like a right one.
    #[error("the plan has work for {what}, which the engine was made without: a defect of antirad")]
    Missing {
        /// What is missing, in words.
        what: String,
    },
    /// The same of a part of a state on the host.
    #[error(
        "bytes {begin}..{end} are outside of the {bytes} bytes of bins of a state on the host: a defect of antirad"
    )]
    OutsideOfState {
        /// First byte of the part.
        begin: u64,
        /// The byte behind its last.
        end: u64,
        /// What there is.
        bytes: u64,
    },
    /// Derivatives that the plan did not foresee.
    #[error("gradients were not planned: name them in PlanOptions::gradients before the plan is made")]
    NotPlanned,
}

impl TransportError {
    pub(super) fn missing(what: impl Into<String>) -> Self {
        Self::Missing { what: what.into() }
    }
}

/// Counts the pairs of a pass.
#[derive(Default)]
pub struct PassMonitor {
    pub callback: Option<PassCallback>,
    done: u64,
    total: u64,
}

impl PassMonitor {
    /// A pass over `total` pairs begins.
    pub fn begin(&mut self, total: u64) {
        (self.done, self.total) = (0, total);
    }

    /// Work on `pairs` pairs has ended.
    pub fn done(&mut self, pairs: u64) -> Result<(), TransportError> {
        self.done += pairs;
        match self.callback.as_mut().map(|callback| callback(self.done, self.total)) {
            Some(ControlFlow::Break(())) => Err(TransportError::Interrupted),
            _ => Ok(()),
        }
    }
}
