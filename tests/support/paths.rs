//! Paths in sources, read without a compiler.

use std::fs;
use std::path::{Path, PathBuf};

/// A path: its names in order.
pub type Names = Vec<String>;

/// The source files in a folder and in those within it, or a file itself, with their texts.
pub fn sources(path: &Path) -> Vec<(PathBuf, String)> {
    if path.is_dir() {
        let entries = fs::read_dir(path).expect("a folder of sources");
        entries.flat_map(|entry| sources(&entry.expect("an entry").path())).collect()
    } else if path.extension().is_some_and(|extension| extension == "rs") {
        vec![(path.to_owned(), fs::read_to_string(path).expect("a source file"))]
    } else {
        Vec::new()
    }
}

/// A source up to its module of tests.
pub fn without_tests(source: &str) -> &str {
    source.split("#[cfg(test)]\nmod tests").next().unwrap_or(source)
}

/// Names, `::`, and all other signs one by one, without comments and the module of tests.
pub fn words(source: &str) -> Vec<&str> {
    let mut words = Vec::new();
    for mut line in without_tests(source).lines().map(|line| line.split("//").next().unwrap_or("")) {
        while let Some(first) = line.chars().next() {
            let of_name = |c: char| c.is_alphanumeric() || c == '_';
            let length = match first {
                c if of_name(c) => line.find(|c| !of_name(c)).unwrap_or(line.len()),
                _ if line.starts_with("::") => 2,
                c => c.len_utf8(),
            };
            if !first.is_whitespace() {
                words.push(&line[..length]);
            }
            line = &line[length..];
        }
    }
    words
}

/// Whether a word is a name.
pub fn is_name(word: &str) -> bool {
    word.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Reads a path, or the paths of a tree (`a::{b, c::d}`), and returns the words behind it.
pub fn read<'a, 'w>(mut words: &'w [&'a str], before: &[&'a str], found: &mut Vec<Names>) -> &'w [&'a str] {
    let mut path = before.to_vec();
    loop {
        match words {
            ["{", rest @ ..] => {
                words = rest;
                while let [word, after @ ..] = words {
                    words = match *word {
                        "}" => return after,
                        word if is_name(word) && word != "as" => read(words, &path, found),
                        _ => after,
                    };
                }
                return words;
            }
            [name, rest @ ..] if is_name(name) => {
                path.push(name);
                words = rest;
            }
            _ => {}
        }
        match words {
            ["::", rest @ ..] => words = rest,
            _ => break,
        }
    }
    // `a::{self}` is `a`.
    path.truncate(path.len() - usize::from(path.len() > 1 && path.ends_with(&["self"])));
    found.push(path.into_iter().map(str::to_owned).collect());
    words
}
