//! A TOML file with its text, for errors that name lines: shared by scene files and job files.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use super::error::{Place, SceneError, nearest};

/// The text of a TOML file.
pub struct TomlFile<'a> {
    /// Where it was read.
    pub path: &'a Path,
    /// Its text.
    pub text: String,
}

impl<'a> TomlFile<'a> {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// Where it cannot be read as UTF-8.
    pub fn read(path: &'a Path) -> Result<Self, SceneError> {
        match antirad_base::input::read_text(path) {
            Ok(text) => Ok(Self { path, text }),
            Err(reason) => Err(SceneError::Read { path: path.to_path_buf(), reason }),
        }
    }

    /// Deserialises the file. An unknown key is an error that names the closest known one.
    ///
    /// # Errors
    /// Fails if the text is no TOML, or does not fit the type; the error names the line.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, SceneError> {
        toml::from_str(&self.text).map_err(|error: toml::de::Error| {
            self.place(error.span().unwrap_or(0..0)).error(one_line(error.message()))
        })
    }

    /// The line where a span starts.
    pub fn place(&self, span: Range<usize>) -> Place<'a> {
        let line = 1 + self.text.bytes().take(span.start).filter(|&b| b == b'\n').count();
        Place { path: self.path, line }
    }

    /// Resolves a path relative to the file.
    pub fn beside(&self, path: &Path) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(path)
    }
}

/// The parser's message on one line, with the closest known word for an unknown one.
///
/// serde lists the known words only in its message, "unknown field `a`, expected one of `b`, `c`". A message in another
/// form is left unchanged.
fn one_line(message: &str) -> String {
    let message = message.lines().map(str::trim).collect::<Vec<_>>().join(", ");
    let mut quoted = message.split('`').skip(1).step_by(2);
    let unknown = message.starts_with("unknown field") || message.starts_with("unknown variant");
    let near = match (unknown, quoted.next()) {
        (true, Some("transport")) if message.contains("`ray_error`") => Some("ray_error"),
        (true, Some(word)) => nearest(word, quoted),
        _ => None,
    };
    let message = message.replacen("unknown field", "unknown key", 1);
    match near {
        Some(near) => format!("{message}; did you mean `{near}`?"),
        None => message,
    }
}
