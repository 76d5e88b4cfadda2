//! The processes that a launcher such as `mpirun` has started together, to work on one scene.

use crate::Failure;
use antirad::backend::{Backend, BackendChoice, BackendKind};
use antirad::cli::Interrupt;
use antirad::gpu::{DeviceOptions, GpuError, list_devices};
use antirad::output::atomic_write;
use antirad::ranks::{RankError, Ranks};
use std::env;
use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

/// Variables with the number of a process on its machine: Open MPI, MPICH, Slurm.
const LOCAL: [&str; 3] = ["OMPI_COMM_WORLD_LOCAL_RANK", "MPI_LOCALRANKID", "SLURM_LOCALID"];

/// This process among them; usually it is alone.
pub struct Together {
    pub ranks: Ranks,
    #[cfg(feature = "mpi")]
    world: Option<antirad::ranks::World>,
}

impl Together {
    #[cfg(feature = "mpi")]
    pub fn join() -> Self {
        let world = antirad::ranks::World::join();
        Self { ranks: world.as_ref().map_or_else(Ranks::default, |world| world.ranks()), world }
    }

    #[cfg(not(feature = "mpi"))]
    pub fn join() -> Self {
        Self { ranks: Ranks::default() }
    }

    /// An error where processes were started together and cannot work so: each would do everything, and all would write the same
    /// files.
    pub fn check(&self) -> Result<(), Failure> {
        #[cfg(feature = "mpi")]
        self.world.as_ref().map_or(Ok(()), |world| world.check())?;
        #[cfg(not(feature = "mpi"))]
        if let Some(name) = antirad::cli::started_together() {
            let why = format!(
                "several processes were started together ({name}), and this antirad was built without MPI: build it with \
                 `--features mpi`, or start one process"
            );
            return Err(Failure::Error(why.into()));
        }
        Ok(())
    }

    /// Whether this process prints and writes: one of them does.
    pub fn speaks(&self) -> bool {
        self.ranks.rank() == 0
    }

    /// An error where there are several processes and the command works in one.
    pub fn alone(&self) -> Result<(), Failure> {
        match self.ranks.count() {
            1 => Ok(()),
            count => {
                let why = format!("this command works in one process, and {count} were started together");
                Err(Failure::Error(why.into()))
            }
        }
    }

    /// Opens a backend, on which a signal ends the work even between kernels that are compiled. Where no device is chosen, processes on
    /// one machine with several of the best kind take one each in turn.
    pub fn open(
        &self,
        choice: BackendChoice,
        options: DeviceOptions,
        interrupt: &Interrupt,
    ) -> Result<Backend, GpuError> {
        let local = LOCAL.iter().find_map(|name| env::var(name).ok()).and_then(|text| text.parse().ok());
        let kind = Backend::chosen(Some(choice), &options);
        let (choice, options) = match (kind, self.ranks.count(), local, &options.selector) {
            (BackendKind::Vulkan, 2.., Some(local), None) => {
                (BackendChoice::Vulkan, options.selector(nth_device(local)?))
            }
            _ => (choice, options),
        };
        Ok(Backend::open(Some(choice), &options)?
            .with_ranks(self.ranks.clone())
            .with_watch(interrupt.watch()))
    }

    /// Gives the files that the first process has in a folder to all others, in theirs, which are new.
    pub fn share(&self, directory: &Path, names: &[&str]) -> Result<(), Box<dyn Error + Send + Sync>> {
        for path in names.iter().map(|name| directory.join(name)).filter(|_| self.ranks.count() > 1) {
            let bytes = self.ranks.by_first(|| Ok::<_, RankError>(fs::read(&path).ok()))?;
            if let Some(bytes) = bytes.filter(|_| !self.speaks()) {
                atomic_write(&path, |file| file.write_all(&bytes))?;
            }
        }
        Ok(())
    }

    /// Ends all processes where this one has failed and the others would wait for it.
    pub fn end(self, code: u8, failed: bool) -> ExitCode {
        #[cfg(feature = "mpi")]
        if let Some(world) = self.world.filter(|_| failed && self.ranks.count() > 1) {
            world.abort(code);
        }
        #[cfg(not(feature = "mpi"))]
        let _ = failed;
        ExitCode::from(code)
    }
}

/// The device for the process with a number on its machine; `None` where there is no choice.
fn nth_device(local: usize) -> Result<Option<String>, GpuError> {
    let mut usable = list_devices()?;
    usable.retain(|device| device.missing.is_empty());
    let best = usable.first().map(|device| device.info.kind);
    usable.retain(|device| Some(device.info.kind) == best);
    Ok((usable.len() > 1).then(|| usable[local % usable.len()].info.index.to_string()))
}
