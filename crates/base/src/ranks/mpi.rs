//! Ranks that an MPI library has started, such as `mpirun` of Open MPI or MPICH.

use super::{Communicator, RankError, Ranks};
use ::mpi::Threading;
use ::mpi::environment::Universe;
use ::mpi::topology::SimpleCommunicator;
use ::mpi::traits::{Communicator as _, Root as _};

/// Most bytes of one message: MPI counts in signed 32 bits.
const MOST: usize = 1 << 30;

/// Variables by which launchers tell a process that it is one of several: Open MPI, MPICH and PMI, PMIx.
const LAUNCHERS: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"];

/// The processes that a launcher has started together. MPI ends when this is dropped.
pub struct World {
    _universe: Universe,
    /// The threads that may call the MPI library.
    threading: Threading,
}

impl World {
    /// Starts MPI where a launcher has started this process, and only there: without one it may take seconds and fail.
    pub fn join() -> Option<Self> {
        let launched = LAUNCHERS.iter().any(|name| std::env::var_os(name).is_some());
        let (universe, threading) =
            launched.then(|| ::mpi::initialize_with_threading(Threading::Serialized)).flatten()?;
        Some(Self { _universe: universe, threading })
    }

    /// Checks that the MPI library serves the threads of a solve.
    ///
    /// # Errors
    /// Fails with [`RankError::Threads`] if it does not.
    pub fn check(&self) -> Result<(), RankError> {
        if self.threading < Threading::Serialized { Err(RankError::Threads) } else { Ok(()) }
    }

    /// This process among those of the world.
    pub fn ranks(&self) -> Ranks {
        let world = SimpleCommunicator::world();
        Ranks::new(MpiRank { rank: world.rank() as usize, count: world.size() as usize })
    }

    /// Ends all processes, for an error of this one: the others would wait for it forever.
    pub fn abort(&self, code: u8) -> ! {
        SimpleCommunicator::world().abort(code.into())
    }
}

struct MpiRank {
    rank: usize,
    count: usize,
}

impl Communicator for MpiRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.count
    }

    /// MPI itself ends all processes where one is lost.
    fn broadcast(&self, root: usize, bytes: &mut [u8]) -> Result<(), RankError> {
        let world = SimpleCommunicator::world();
        let root = world.process_at_rank(root as i32);
        bytes.chunks_mut(MOST).for_each(|bytes| root.broadcast_into(bytes));
        Ok(())
    }
}
