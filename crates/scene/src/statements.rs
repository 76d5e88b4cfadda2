//! The line syntax that OBJ and MTL files share.

use std::borrow::Cow;
use std::path::Path;

use super::error::{Place, SceneError};

/// One statement: a keyword and its arguments.
pub(super) struct Statement<'a> {
    /// Line of the keyword, from 1.
    pub line: usize,
    text: Cow<'a, str>,
}

impl Statement<'_> {
    pub fn keyword(&self) -> &str {
        self.text.split_whitespace().next().unwrap_or_default()
    }

    /// Everything after the keyword, without surrounding blanks: names may contain blanks.
    pub fn rest(&self) -> &str {
        self.text[self.keyword().len()..].trim()
    }

    pub fn words(&self) -> impl Iterator<Item = &str> {
        self.text.split_whitespace().skip(1)
    }
}

/// The statements of a text, without comments and empty lines; a `\` at the end of a line joins it with the next.
pub(super) fn statements(text: &str) -> impl Iterator<Item = Statement<'_>> {
    let text = text.trim_start_matches('\u{feff}');
    let mut lines = text.lines().zip(1..);
    std::iter::from_fn(move || {
        loop {
            let (first, line) = lines.next()?;
            let mut text = Cow::Borrowed(uncommented(first));
            while let Some(head) = text.strip_suffix('\\') {
                let next = lines.next().map_or("", |(next, _)| uncommented(next));
                text = Cow::Owned(format!("{head} {next}"));
            }
            if let Cow::Borrowed(borrowed) = text {
                text = Cow::Borrowed(borrowed.trim());
            } else {
                text = Cow::Owned(text.trim().to_owned());
            }
            if !text.is_empty() {
                return Some(Statement { line, text });
            }
        }
    })
}

/// A `#` starts a comment only after a blank: material names may contain one.
fn uncommented(line: &str) -> &str {
    let mut before = ' ';
    for (at, c) in line.char_indices() {
        if c == '#' && before.is_whitespace() {
            return line[..at].trim_end();
        }
        before = c;
    }
    line.trim_end()
}

/// A finite number.
pub(super) fn number(word: &str, place: Place) -> Result<f64, SceneError> {
    match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        Ok(_) => Err(place.error(format!("`{word}` is not finite; expected a finite number"))),
        Err(_) => Err(place.error(format!("`{word}` is not a number"))),
    }
}

/// Reads a text file in UTF-8, or in UTF-16 if it begins with its mark. Bytes that are neither (comments in other encodings are common)
/// become replacement characters.
pub(super) fn read_text(path: &Path) -> std::io::Result<String> {
    let bytes = antirad_base::input::read(path)?;
    let pairs = || bytes.chunks_exact(2).skip(1).map(|pair| [pair[0], pair[1]]);
    match bytes.get(..2) {
        Some([0xff, 0xfe]) => {
            return Ok(String::from_utf16_lossy(&pairs().map(u16::from_le_bytes).collect::<Vec<_>>()));
        }
        Some([0xfe, 0xff]) => {
            return Ok(String::from_utf16_lossy(&pairs().map(u16::from_be_bytes).collect::<Vec<_>>()));
        }
        _ => {}
    }
    Ok(match String::from_utf8(bytes) {
        Ok(text) => text,
        Err(error) => String::from_utf8_lossy(error.as_bytes()).into_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_continuations_and_crlf() {
        let text = "\u{feff}# head\r\nf 1 2 \\\r\n  3 # tail\r\n\r\nusemtl wood #2\nusemtl wood#2\nf 1 \\";
        let read: Vec<_> =
            statements(text).map(|s| (s.line, s.keyword().to_owned(), s.rest().to_owned())).collect();
        let expected = [(2, "f", "1 2   3"), (5, "usemtl", "wood"), (6, "usemtl", "wood#2"), (7, "f", "1")];
        assert_eq!(read.len(), expected.len());
        for (read, expected) in read.iter().zip(expected) {
            assert_eq!(
                (read.0, read.1.as_str(), read.2.split_whitespace().collect::<Vec<_>>()),
                (expected.0, expected.1, expected.2.split_whitespace().collect::<Vec<_>>())
            );
        }
    }
}
