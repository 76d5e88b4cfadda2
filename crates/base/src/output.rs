//! Atomic writes: files appear whole or not at all, so that an interrupted run leaves no half-written output.

mod file_names;

pub use file_names::{FileNames, free_name};

use crate::npy::{self, Number};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// Prefix of the names of files being written.
const UNFINISHED: &str = ".antirad-";

/// A file could not be written. Its previous content is intact.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot be written: {reason}", path.display())]
#[non_exhaustive]
pub struct OutputError {
    /// The file that could not be written.
    pub path: PathBuf,
    /// The system's reason. Not a `source`: the message holds it already.
    pub reason: io::Error,
}

impl OutputError {
    /// The error that `path` cannot be written, for this reason.
    pub fn new(path: &Path, reason: io::Error) -> Self {
        Self { path: path.to_path_buf(), reason }
    }
}

/// Calls `write` with a new file in the directory of `path`, which then replaces `path`. Buffering is up to `write`.
/// What is not a regular file (`/dev/stdout`, a pipe) is written directly; links are followed.
///
/// # Errors
/// Fails if the file cannot be created or replaced, or if `write` fails.
pub fn atomic_write(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> Result<(), OutputError> {
    replace(path, write).map_err(|reason| OutputError { path: path.to_path_buf(), reason })
}

fn replace(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let target = match fs::metadata(path) {
        Ok(existing) if existing.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        Ok(existing) if !existing.is_file() => return write(&mut File::options().write(true).open(path)?),
        Ok(_) => fs::canonicalize(path)?,
        Err(_) => path.to_path_buf(),
    };
    let directory = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // Opened here rather than by `tempfile`, whose files only their owner may read.
    let mut file = tempfile::Builder::new()
        .prefix(UNFINISHED)
        .make_in(directory, |path| File::options().read(true).write(true).create_new(true).open(path))?;
    write(file.as_file_mut())?;
    file.persist(&target).map_err(|error| error.error)?;
    Ok(())
}

/// Writes RGB rows as a float array [rows, 3] (NumPy's format).
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write_npy<T: Number>(path: &Path, rows: &[[T; 3]]) -> Result<(), OutputError> {
    write_array(path, &[rows.len() as u64, 3], rows.iter().flatten().copied())
}

/// Writes numbers as an array of a shape, the last index running fastest (NumPy's format).
///
/// # Errors
/// Fails if the file cannot be written, or if there are more or fewer numbers than the shape has.
pub fn write_array<T: Number>(
    path: &Path,
    shape: &[u64],
    numbers: impl Iterator<Item = T>,
) -> Result<(), OutputError> {
    atomic_write(path, |file| npy::write(io::BufWriter::new(file), shape, numbers))
}

/// RGB values as f32, for pictures and files.
pub fn single(rows: &[[f64; 3]]) -> Vec<[f32; 3]> {
    rows.iter().map(|rgb| rgb.map(|x| x as f32)).collect()
}

/// Writes a value as indented JSON.
///
/// # Errors
/// Fails if the value cannot be serialised, or the file cannot be written.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), OutputError> {
    atomic_write(path, |file| {
        let mut text = serde_json::to_vec_pretty(value)?;
        text.push(b'\n');
        io::Write::write_all(file, &text)
    })
}

/// Writes a value as indented JSON unless the file exists: of several processes one writes it.
///
/// # Errors
/// Fails if the value cannot be serialised, or the file cannot be written; not if it exists.
pub fn write_new_json(path: &Path, value: &impl serde::Serialize) -> Result<(), OutputError> {
    let directory = path.parent().unwrap_or(Path::new("."));
    let attempt = || {
        let mut file = tempfile::Builder::new()
            .prefix(UNFINISHED)
            .make_in(directory, |path| File::options().write(true).create_new(true).open(path))?;
        serde_json::to_writer_pretty(file.as_file_mut(), value)?;
        match file.persist_noclobber(path) {
            Err(error) if error.error.kind() != io::ErrorKind::AlreadyExists => Err(error.error),
            _ => Ok(()),
        }
    };
    attempt().map_err(|reason| OutputError { path: path.to_path_buf(), reason })
}

/// Creates a directory, and checks that files can be created in it before any work is done for them.
///
/// # Errors
/// Fails if the directory cannot be created, or if no file can be created in it.
pub fn prepare_directory(path: &Path) -> Result<(), OutputError> {
    let attempt = || {
        // The system's message would only say that the file exists.
        if let Some(link) = path.ancestors().find(|above| above.is_symlink() && !above.exists()) {
            let (link, target) = (link.display(), fs::read_link(link)?);
            let reason = format!(
                "{link} is a link to {}, which does not exist: create it or remove the link",
                target.display()
            );
            return Err(io::Error::new(io::ErrorKind::NotFound, reason));
        }
        fs::create_dir_all(path)?;
        tempfile::Builder::new().prefix(UNFINISHED).tempfile_in(path).map(drop)
    };
    attempt().map_err(|reason| OutputError { path: path.to_path_buf(), reason })
}

/// Removes files that killed runs left half-written in a directory. For directories that one run at a time writes into.
///
/// # Errors
/// Fails if the directory cannot be read, or a file cannot be removed.
pub fn remove_unfinished(path: &Path) -> Result<(), OutputError> {
    let attempt = || {
        for entry in fs::read_dir(path)? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(UNFINISHED) {
                fs::remove_file(entry.path())?;
            }
        }
        Ok(())
    };
    attempt().map_err(|reason| OutputError { path: path.to_path_buf(), reason })
}
