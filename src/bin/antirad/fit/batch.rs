//! Which jobs a batch consists of.

use crate::Failure;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// A job file.
pub struct Found {
    pub path: PathBuf,
    /// The file's name without its extension: the name of its folder of results.
    pub name: String,
}

/// Keys that a job file has and a scene file has not.
const KEYS: [&str; 3] = ["scene", "target", "fit"];

/// The jobs of files and folders, in the order given, folders by name.
pub fn find(paths: &[PathBuf]) -> Result<Vec<Found>, Failure> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let refuse = |reason: String| Failure::Error(format!("{}: {reason}", path.display()).into());
        let entries = std::fs::read_dir(path).map_err(|error| refuse(format!("cannot be read: {error}")))?;
        let inside: std::io::Result<Vec<PathBuf>> =
            entries.map(|entry| entry.map(|entry| entry.path())).collect();
        let mut inside = inside.map_err(|error| refuse(format!("cannot be read: {error}")))?;
        inside.retain(|path| is_job(path));
        inside.sort();
        if inside.is_empty() {
            return Err(refuse("no job file in it; a job is a .toml that names a scene to fit".to_owned()));
        }
        files.append(&mut inside);
    }
    let mut names: HashMap<String, PathBuf> = HashMap::new();
    let mut found = Vec::with_capacity(files.len());
    for path in files {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(other) = names.insert(name.clone(), path.clone()) {
            let message = format!(
                "{} and {} would both write into a folder \"{name}\"; rename one",
                other.display(),
                path.display()
            );
            return Err(Failure::Error(message.into()));
        }
        found.push(Found { path, name });
    }
    Ok(found)
}

/// Scene files lie beside job files. Any other file counts as a job, so that its errors are reported: one that is empty
/// or not TOML, a dangling link.
fn is_job(path: &Path) -> bool {
    let toml = !path.is_dir() && path.extension().is_some_and(|end| end.eq_ignore_ascii_case("toml"));
    let says = || std::fs::read_to_string(path).ok()?.parse::<toml::Table>().ok();
    // Reading a pipe might never end.
    toml && match path.is_file().then(says).flatten() {
        Some(table) => table.is_empty() || KEYS.iter().any(|key| table.contains_key(*key)),
        None => true,
    }
}
