//! Several processes, the ranks, that solve one scene together, each with a device of its own. All run the same program on
//! the same input and call the same operations in the same order; of each pass a rank computes its share, and so it does of what the host
//! computes of lamps and pictures.

mod map;
#[cfg(feature = "mpi")]
mod mpi;
mod threads;

#[cfg(feature = "mpi")]
pub use mpi::World;
pub use threads::in_threads;

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Ranks can no longer work together.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RankError {
    /// Another rank has ended, by an error of its own or because it was killed.
    #[error(
        "another process that works on this scene has ended: see its own message, and start all of them again"
    )]
    Left,
    /// The MPI library serves one thread alone, but another thread exchanges bins of states while kernels
    /// work.
    #[error(
        "this MPI library cannot be called from several threads in turn (MPI_THREAD_SERIALIZED): use one that is built with support for \
         threads, as Open MPI and MPICH are by default"
    )]
    Threads,
    /// Ranks did not call the same operation.
    #[error(
        "{given} bytes were expected from rank {root}, which has {sent}: all processes must run the same program on the same input"
    )]
    OutOfStep {
        /// The rank that sends.
        root: usize,
        /// Bytes that it sends.
        sent: usize,
        /// Bytes that this rank expects.
        given: usize,
    },
    /// What a rank has sent is not what this one expects.
    #[error(
        "what rank {root} has sent cannot be read ({why}): all processes must run the same program on the same input"
    )]
    Unreadable {
        /// The rank that sends.
        root: usize,
        /// What is wrong with what it sent.
        why: String,
    },
}

impl RankError {
    /// Whether the same work may succeed where all ranks are started again: neither the program nor its input is at fault.
    pub fn may_pass(&self) -> bool {
        matches!(self, Self::Left)
    }
}

/// How ranks exchange bytes.
pub trait Communicator: Send + Sync {
    /// Number of this rank, from 0.
    fn rank(&self) -> usize;
    /// Number of ranks.
    fn count(&self) -> usize;
    /// Replaces `bytes` by those of the rank `root`. All ranks call it, with as many bytes.
    fn broadcast(&self, root: usize, bytes: &mut [u8]) -> Result<(), RankError>;
}

/// This process as one of those that solve a scene together. By default it is alone.
#[derive(Clone, Default)]
pub struct Ranks(Option<Arc<Several>>);

struct Several {
    communicator: Box<dyn Communicator>,
    /// Bytes sent to one other rank or more, and bytes received.
    sent: AtomicU64,
    received: AtomicU64,
}

impl fmt::Debug for Ranks {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "rank {} of {}", self.rank(), self.count())
    }
}

impl Ranks {
    /// This process among the ranks that a communicator connects.
    pub fn new(communicator: impl Communicator + 'static) -> Self {
        let (sent, received) = (AtomicU64::new(0), AtomicU64::new(0));
        Self(Some(Arc::new(Several { communicator: Box::new(communicator), sent, received })))
    }

    /// Number of this rank, from 0.
    pub fn rank(&self) -> usize {
        self.0.as_ref().map_or(0, |several| several.communicator.rank())
    }

    /// Number of ranks.
    pub fn count(&self) -> usize {
        self.0.as_ref().map_or(1, |several| several.communicator.count())
    }

    /// Replaces `bytes` by those of the rank `root`.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not call it with as many bytes.
    #[doc(hidden)]
    pub fn broadcast(&self, root: usize, bytes: &mut [u8]) -> Result<(), RankError> {
        let Some(Several { communicator, sent, received }) = self.0.as_deref() else { return Ok(()) };
        if communicator.count() > 1 {
            let moved = if root == communicator.rank() { sent } else { received };
            moved.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        }
        communicator.broadcast(root, bytes)
    }

    /// The values of rank 0, so that all decide alike: devices that differ may round differently.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not call it with as many values.
    #[doc(hidden)]
    pub fn agree(&self, values: &mut [f64]) -> Result<(), RankError> {
        self.broadcast(0, bytemuck::cast_slice_mut(values))
    }

    /// The values of each rank, by its number.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not call it.
    #[doc(hidden)]
    pub fn each<const N: usize>(&self, own: [u64; N]) -> Result<Vec<[u64; N]>, RankError> {
        let of = |root| {
            let mut values = own;
            self.broadcast(root, bytemuck::cast_slice_mut(&mut values))?;
            Ok(values)
        };
        (0..self.count()).map(of).collect()
    }

    /// Bytes that this rank has sent, however many receive them, and received.
    #[doc(hidden)]
    pub fn moved(&self) -> [u64; 2] {
        let read = |of: &AtomicU64| of.load(Ordering::Relaxed);
        self.0.as_ref().map_or([0; 2], |several| [read(&several.sent), read(&several.received)])
    }
}
