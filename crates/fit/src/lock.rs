//! Locks a folder, so that only one process at a time fits in it.

use antirad_base::input;
use antirad_base::output::OutputError;
use std::fs::{File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Never removed, since two processes could then lock two different files of this name.
const FILE: &str = ".lock";

/// Whoever asks for the state of a lock holds a part of it for an instant.
const PATIENCE: Duration = Duration::from_millis(100);
const BETWEEN: Duration = Duration::from_millis(10);

/// An exclusive advisory lock on a folder, held until it is dropped or the process ends. It binds only processes that take
/// one too.
#[derive(Debug)]
pub struct FolderLock {
    _file: File,
}

/// A folder could not be locked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LockError {
    /// Another process holds the lock.
    #[error("{}: {holder} is at work in this folder; wait for its end, or choose another --output", path.display())]
    Held {
        /// The folder.
        path: PathBuf,
        /// The process and its host.
        holder: String,
    },
    /// The file system does not support locks, like some network drives.
    #[error(
        "{}: cannot be locked: {reason}; make sure that no other process fits in this folder",
        path.display()
    )]
    Unavailable {
        /// The folder.
        path: PathBuf,
        /// Error of the operating system.
        reason: io::Error,
    },
    /// The lock file could not be written.
    #[error(transparent)]
    Write(#[from] OutputError),
}

impl FolderLock {
    /// Locks an existing, writable folder.
    ///
    /// # Errors
    /// Fails if another process holds the lock, if the folder does not support locks, or if the lock file
    /// cannot be written.
    pub fn take(directory: &Path) -> Result<Self, LockError> {
        Self::take_within(directory, PATIENCE)
    }

    /// Locks an existing, writable folder, after waiting at most `patience` for another process to release
    /// it.
    ///
    /// # Errors
    /// Fails as [`Self::take`] does.
    pub fn take_within(directory: &Path, patience: Duration) -> Result<Self, LockError> {
        let path = directory.join(FILE);
        let failed = |reason| OutputError::new(&path, reason);
        // Opened for writing, as NFS requires for locks.
        let mut file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(failed)?;
        let since = Instant::now();
        while let Err(error) = file.try_lock() {
            if matches!(error, TryLockError::Error(_)) || since.elapsed() >= patience {
                return Err(refusal(directory, error));
            }
            std::thread::sleep(BETWEEN);
        }
        let host = gethostname::gethostname();
        let holder = format!("process {} on {}\n", std::process::id(), host.display());
        file.set_len(0).and_then(|()| file.write_all(holder.as_bytes())).map_err(failed)?;
        Ok(Self { _file: file })
    }

    /// Whether a process holds the lock of a folder; `None` where the file system does not say.
    pub fn is_held(directory: &Path) -> Option<bool> {
        let Ok(file) = input::open(&directory.join(FILE)) else { return Some(false) };
        match file.try_lock_shared() {
            Ok(()) => Some(false),
            Err(TryLockError::WouldBlock) => Some(true),
            Err(TryLockError::Error(_)) => None,
        }
    }
}

fn refusal(directory: &Path, error: TryLockError) -> LockError {
    let path = directory.to_path_buf();
    match error {
        TryLockError::WouldBlock => {
            let holder = input::read_text(&directory.join(FILE)).unwrap_or_default();
            let holder = if holder.is_empty() { "another process" } else { holder.trim_end() };
            LockError::Held { path, holder: holder.to_owned() }
        }
        TryLockError::Error(reason) => LockError::Unavailable { path, reason },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_is_told_of_the_first() {
        let folder = tempfile::tempdir().expect("a folder");
        let first = FolderLock::take(folder.path()).expect("free");
        let message = FolderLock::take(folder.path()).expect_err("taken").to_string();
        let host = gethostname::gethostname();
        let holder = format!("process {} on {}", std::process::id(), host.display());
        assert!(message.contains(&holder) && message.contains("--output"), "{message}");
        drop(first);
        FolderLock::take(folder.path()).expect("free again");
    }

    #[test]
    fn what_cannot_be_locked() {
        let folder = tempfile::tempdir().expect("a folder");
        let reason = io::Error::from(io::ErrorKind::Unsupported);
        let message = refusal(folder.path(), TryLockError::Error(reason)).to_string();
        assert!(message.contains("cannot be locked") && message.contains("no other process"), "{message}");
        let gone = folder.path().join("gone");
        let message = FolderLock::take(&gone).expect_err("no folder").to_string();
        assert!(message.contains("cannot be written"), "{message}");
        // A process killed between locking and writing leaves no name.
        let file = File::create(folder.path().join(FILE)).expect("a file");
        file.try_lock().expect("free");
        let message = FolderLock::take(folder.path()).expect_err("taken").to_string();
        assert!(message.contains("another process is at work"), "{message}");
    }
}
