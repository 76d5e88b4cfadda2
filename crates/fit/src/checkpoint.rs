//! The state of a fit on disk: written atomically, with a checksum; the previous one is kept.

use super::job::FitProgress;
use antirad_base::input;
use antirad_base::output::{OutputError, atomic_write};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const MAGIC: &[u8; 16] = b"antirad-fit-ckpt";
/// Incremented whenever the stored layout changes.
const VERSION: u32 = 5;
const FILE: &str = "checkpoint";
const PREVIOUS: &str = "checkpoint.previous";
/// Names of all files of a checkpoint.
pub const CHECKPOINT_FILES: [&str; 2] = [FILE, PREVIOUS];
/// Magic, version, length, checksum.
const HEADER: usize = 16 + 4 + 8 + 32;

/// A checkpoint cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The folder holds progress that a new fit would overwrite.
    #[error(
        "{}: holds the progress of an earlier fit; --resume continues it, --restart discards it and starts over",
        path.display()
    )]
    Present {
        /// The checkpoint.
        path: PathBuf,
    },
    /// The file cannot be read.
    #[error("{}: cannot be read: {reason}", path.display())]
    Read {
        /// The checkpoint.
        path: PathBuf,
        /// Error of the operating system.
        reason: io::Error,
    },
    /// The file is not a checkpoint, or is corrupt.
    #[error("{}: {damage}; {remedy}", path.display())]
    Damaged {
        /// The checkpoint.
        path: PathBuf,
        /// What is wrong with it.
        damage: String,
        /// The remedy.
        remedy: String,
    },
    /// The file was written by another version.
    #[error(
        "{}: it has version {found}, but this program reads version {VERSION}; continue with the program that wrote it, \
         or start over with --restart",
        path.display()
    )]
    Version {
        /// The checkpoint.
        path: PathBuf,
        /// Version of the file.
        found: u32,
    },
    /// The file belongs to a different job.
    #[error(
        "{}: it belongs to another job: {what} has changed; start over with --restart, or undo the change",
        path.display()
    )]
    OtherJob {
        /// The checkpoint.
        path: PathBuf,
        /// What differs.
        what: String,
    },
}

/// Everything that determines a fit. Two fits with the same identity take the same steps.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity(Vec<(String, [u8; 32])>);

impl Identity {
    /// Adds a part, with its name in messages.
    ///
    /// # Errors
    /// Fails if the value cannot be serialised.
    pub fn add(&mut self, what: impl Into<String>, value: &impl Serialize) -> Result<(), postcard::Error> {
        let bytes = postcard::to_stdvec(value)?;
        self.0.push((what.into(), Sha256::digest(bytes).into()));
        Ok(())
    }

    /// Name of the first part that differs.
    fn difference(&self, other: &Self) -> Option<&str> {
        let pairs = self.0.iter().zip(&other.0);
        let differs = pairs.clone().find(|(a, b)| a != b).map(|(a, _)| a.0.as_str());
        differs.or((self.0.len() != other.0.len()).then_some("the number of targets"))
    }
}

#[derive(Serialize, Deserialize)]
struct Payload<'a> {
    identity: std::borrow::Cow<'a, Identity>,
    progress: std::borrow::Cow<'a, FitProgress>,
}

/// The checkpoints in a folder.
pub(super) struct Checkpoints {
    directory: PathBuf,
}

impl Checkpoints {
    pub fn new(directory: &Path) -> Self {
        Self { directory: directory.to_path_buf() }
    }

    fn current(&self) -> PathBuf {
        self.directory.join(FILE)
    }

    fn previous(&self) -> PathBuf {
        self.directory.join(PREVIOUS)
    }

    /// Removes existing checkpoints: a new fit must not mix with an earlier one.
    ///
    /// # Errors
    /// Fails if a checkpoint cannot be removed.
    pub fn clear(&self) -> Result<(), OutputError> {
        for path in [self.current(), self.previous()] {
            match fs::remove_file(&path) {
                Err(reason) if reason.kind() != io::ErrorKind::NotFound => {
                    return Err(OutputError::new(&path, reason));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Checks that there is no checkpoint that a new fit would overwrite.
    ///
    /// # Errors
    /// Fails if there is one.
    pub fn refuse(&self) -> Result<(), CheckpointError> {
        match [self.current(), self.previous()].into_iter().find(|path| path.exists()) {
            Some(path) => Err(CheckpointError::Present { path }),
            None => Ok(()),
        }
    }

    /// Stores a state. On failure the previous checkpoint is left intact.
    ///
    /// # Errors
    /// Fails if the state cannot be serialised, or a file cannot be written or renamed.
    pub fn write(&self, identity: &Identity, progress: &FitProgress) -> Result<(), OutputError> {
        use std::borrow::Cow::Borrowed;
        let path = self.current();
        let payload = Payload { identity: Borrowed(identity), progress: Borrowed(progress) };
        let payload = postcard::to_stdvec(&payload)
            .map_err(|error| OutputError::new(&path, io::Error::other(error)))?;
        // Written in full under another name first: a full disk must not destroy the existing one.
        let fresh = self.directory.join("checkpoint.new");
        let written = atomic_write(&fresh, |file| {
            file.write_all(MAGIC)?;
            file.write_all(&VERSION.to_le_bytes())?;
            file.write_all(&(payload.len() as u64).to_le_bytes())?;
            file.write_all(&Sha256::digest(&payload))?;
            file.write_all(&payload)?;
            // Synced before it replaces another, in case of a power failure.
            file.sync_all()
        });
        written.map_err(|error| OutputError::new(&path, error.reason))?;
        let swap = || {
            self.set_aside()?;
            fs::rename(&fresh, &path)
        };
        swap().map_err(|reason| OutputError::new(&path, reason))
    }

    /// Makes the current checkpoint the previous one, too, so that there is a current one at any time.
    fn set_aside(&self) -> io::Result<()> {
        let (path, previous) = (self.current(), self.previous());
        let unless_absent = |done: io::Result<()>| match done {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        };
        if !path.exists() {
            return Ok(());
        }
        unless_absent(fs::remove_file(&previous))?;
        // Not every file system has links. If killed after the renaming, only the previous one exists, and `read` uses it.
        fs::hard_link(&path, &previous).or_else(|_| unless_absent(fs::rename(&path, &previous)))
    }

    /// The most recent state; `None` if there is none.
    ///
    /// # Errors
    /// Fails if the checkpoint cannot be read, is corrupt, or is of another version or another job.
    pub fn read(&self, identity: &Identity) -> Result<Option<FitProgress>, CheckpointError> {
        for path in [self.current(), self.previous()] {
            match input::read(&path) {
                Ok(bytes) => return self.decode(&path, &bytes, identity).map(Some),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(reason) => return Err(CheckpointError::Read { path, reason }),
            }
        }
        Ok(None)
    }

    fn decode(&self, path: &Path, bytes: &[u8], identity: &Identity) -> Result<FitProgress, CheckpointError> {
        let damaged = |damage: String| {
            let previous = self.previous();
            let remedy = if path != previous && previous.exists() {
                format!("remove it to continue from the one before it, {}", previous.display())
            } else {
                String::from("start over with --restart")
            };
            CheckpointError::Damaged { path: path.to_path_buf(), damage, remedy }
        };
        let Some((header, payload)) = bytes.split_at_checked(HEADER) else {
            return Err(damaged(format!("it ends after {} bytes, within its header", bytes.len())));
        };
        let (magic, rest) = header.split_at(16);
        let (version, rest) = rest.split_at(4);
        let (length, checksum) = rest.split_at(8);
        if magic != MAGIC {
            return Err(damaged(String::from("it is not a checkpoint: its first bytes are wrong")));
        }
        let version = version.iter().rev().fold(0, |n, &b| n << 8 | u32::from(b));
        if version != VERSION {
            return Err(CheckpointError::Version { path: path.to_path_buf(), found: version });
        }
        let length = length.iter().rev().fold(0, |n, &b| n << 8 | u64::from(b));
        if payload.len() as u64 != length {
            return Err(damaged(format!(
                "it should hold {length} bytes of state but holds {}",
                payload.len()
            )));
        }
        if Sha256::digest(payload).as_slice() != checksum {
            return Err(damaged(String::from("its checksum is wrong: it is corrupt")));
        }
        let stored: Payload = postcard::from_bytes(payload)
            .map_err(|error| damaged(format!("its content is invalid: {error}")))?;
        match stored.identity.difference(identity) {
            Some(what) => Err(CheckpointError::OtherJob { path: path.to_path_buf(), what: what.to_owned() }),
            None => Ok(stored.progress.into_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::optimiser::{Adam, AdamOptions, Bounds, Optimiser};
    use super::*;
    use tempfile::{TempDir, tempdir};

    fn progress(x: f64) -> FitProgress {
        FitProgress::new(Optimiser::Adam(Adam::new(vec![x; 500], Bounds::free(500), AdamOptions::default())))
    }

    fn identity(job: &str) -> Identity {
        let mut identity = Identity::default();
        identity.add("the job", &job).expect("bytes");
        identity.add("the scene", &"scene").expect("bytes");
        identity
    }

    fn written(states: &[f64]) -> (TempDir, Checkpoints) {
        let folder = tempdir().expect("a folder");
        let checkpoints = Checkpoints::new(folder.path());
        for &x in states {
            checkpoints.write(&identity("job"), &progress(x)).expect("written");
        }
        (folder, checkpoints)
    }

    fn names(folder: &TempDir) -> Vec<String> {
        let entries = fs::read_dir(folder.path()).expect("a folder");
        let mut names: Vec<String> =
            entries.map(|e| e.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
        names.sort();
        names
    }

    #[test]
    fn the_last_two_are_kept() {
        let (folder, checkpoints) = written(&[1.0, 2.0, 1.0 / 3.0]);
        assert_eq!(names(&folder), [FILE, PREVIOUS]);
        assert_eq!(checkpoints.read(&identity("job")).expect("read"), Some(progress(1.0 / 3.0)));
        // Killed between the two renames.
        fs::remove_file(checkpoints.current()).expect("removed");
        assert_eq!(checkpoints.read(&identity("job")).expect("read"), Some(progress(2.0)));
        let message = checkpoints.refuse().expect_err("something to lose").to_string();
        assert!(message.contains("--resume") && message.contains("--restart"), "{message}");
        checkpoints.clear().expect("cleared");
        assert_eq!(checkpoints.read(&identity("job")).expect("read"), None);
        checkpoints.refuse().expect("nothing to lose");
    }

    #[test]
    fn damage_is_an_error_that_names_the_way_out() {
        let (folder, checkpoints) = written(&[1.0, 2.0]);
        let good = fs::read(checkpoints.current()).expect("bytes");
        let read = |bytes: &[u8]| {
            fs::write(checkpoints.current(), bytes).expect("written");
            checkpoints.read(&identity("job")).map_err(|error| error.to_string())
        };
        // Cut at every length, and with any byte of the header or some of the rest changed.
        for length in (0..good.len()).step_by(41).chain(0..HEADER + 2) {
            let message = read(&good[..length]).expect_err("truncated");
            assert!(message.contains("checkpoint: ") && message.contains("checkpoint.previous"), "{message}");
        }
        for at in (0..HEADER).chain((HEADER..good.len()).step_by(97)) {
            let mut bytes = good.clone();
            bytes[at] ^= 0x10;
            read(&bytes).expect_err("changed");
        }
        let mut longer = good.clone();
        longer.push(0);
        assert!(read(&longer).expect_err("longer").contains("should hold"));
        let mut version = good.clone();
        version[16] = 9;
        assert!(read(&version).expect_err("of the future").contains("version 9"));
        // The remedy of the message works: without the damaged one, the previous one is used.
        fs::remove_file(checkpoints.current()).expect("removed");
        assert_eq!(checkpoints.read(&identity("job")).expect("read"), Some(progress(1.0)));
        drop(folder);
    }

    #[test]
    fn another_job_is_refused() {
        let (_folder, checkpoints) = written(&[1.0]);
        let message = checkpoints.read(&identity("another")).expect_err("another job").to_string();
        assert!(message.contains("the job has changed"), "{message}");
        let mut more = identity("job");
        more.add("target 2", &1).expect("bytes");
        let message = checkpoints.read(&more).expect_err("another job").to_string();
        assert!(message.contains("number of targets"), "{message}");
    }

    /// Environment variable that is set in the process that runs under a limit on file size.
    const LIMITED: &str = "ANTIRAD_TEST_LIMITED";

    /// A limit on file size stands in for a full disk, since both make writes fail half-way, and needs no privileges. It is
    /// irrevocable and holds for all threads, so the test runs itself in a separate process.
    #[test]
    #[cfg(unix)]
    fn a_failed_write_leaves_the_previous_checkpoint() {
        if std::env::var_os(LIMITED).is_none() {
            let name = "checkpoint::tests::a_failed_write_leaves_the_previous_checkpoint";
            let limit = "trap '' XFSZ; ulimit -f 64; exec \"$0\" \"$@\"";
            let output = std::process::Command::new("sh")
                .args(["-c", limit])
                .arg(std::env::current_exe().expect("this program"))
                .args(["--exact", name])
                .env(LIMITED, "1")
                .output()
                .expect("a shell");
            let said = String::from_utf8_lossy(&output.stdout);
            assert!(output.status.success() && said.contains("1 passed"), "{said}");
            return;
        }
        let (folder, checkpoints) = written(&[1.0, 2.0]);
        let large = Adam::new(vec![3.0; 50_000], Bounds::free(50_000), AdamOptions::default());
        let large = FitProgress::new(Optimiser::Adam(large));
        let message = checkpoints.write(&identity("job"), &large).expect_err("too large").to_string();
        assert!(message.contains("checkpoint: cannot be written: File too large"), "{message}");
        assert_eq!(checkpoints.read(&identity("job")).expect("read"), Some(progress(2.0)));
        assert_eq!(names(&folder), [FILE, PREVIOUS]);
        // Without the limit.
        checkpoints.write(&identity("job"), &progress(4.0)).expect("written");
        assert_eq!(checkpoints.read(&identity("job")).expect("read"), Some(progress(4.0)));
    }
}
