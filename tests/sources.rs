//! References between the sources.

use std::fs;
use std::path::{Path, PathBuf};

/// Where files are named by their path from the root.
const FOLDERS: [&str; 6] = ["src/", "crates/", "tests/", "benches/", "examples/", "docs/"];
const SHADERS: &str = "crates/core/glsl";
const ENDINGS: [&str; 4] = [".rs", ".comp", ".glsl", ".md"];

/// The files of the project that a text names: by their path, perhaps with one `*` in the file's name, or a shader by
/// its name alone. Names in capitals are placeholders.
fn mentions(text: &str) -> impl Iterator<Item = String> {
    let part = |c: char| c.is_ascii_alphanumeric() || "_-*./".contains(c);
    text.split(move |c| !part(c))
        .map(|word| word.trim_start_matches("../").trim_end_matches('.'))
        .filter(|word| !word.rsplit('/').next().is_some_and(|name| name.starts_with("NAME")))
        .filter_map(|word| {
            let ending =
                ENDINGS.iter().find(|ending| word.len() > ending.len() && word.ends_with(**ending))?;
            let shader = [".comp", ".glsl"].contains(ending) && !word.contains('/');
            match FOLDERS.iter().any(|folder| word.starts_with(folder)) {
                true => Some(word.to_owned()),
                false => shader.then(|| format!("{SHADERS}/{word}")),
            }
        })
}

fn is_there(mention: &str) -> bool {
    let Some((before, after)) = mention.split_once('*') else { return Path::new(mention).is_file() };
    let (folder, before) = before.rsplit_once('/').unwrap_or((".", before));
    let names = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    names
        .filter_map(|name| name.into_string().ok())
        .any(|name| name.strip_prefix(before).is_some_and(|rest| rest.ends_with(after)))
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files(&path, found);
        } else if path.to_str().is_some_and(|name| ENDINGS.iter().any(|ending| name.ends_with(ending))) {
            found.push(path);
        }
    }
}

#[test]
fn files_that_are_mentioned_are_there() {
    let mut sources = ["README.md", "ARCHITECTURE.md"].map(PathBuf::from).to_vec();
    for folder in FOLDERS {
        files(Path::new(folder), &mut sources);
    }
    let mut gone = Vec::new();
    let mut count = 0;
    for source in sources {
        let text = fs::read_to_string(&source).expect("a text");
        for (at, line) in text.lines().enumerate() {
            for mention in mentions(line) {
                count += 1;
                if !is_there(&mention) {
                    gone.push(format!("{}:{}: {mention}", source.display(), at + 1));
                }
            }
        }
    }
    assert_eq!(gone, [""; 0]);
    assert!(count > 40, "only {count} mentions were found");
}

#[test]
fn mentions_are_found() {
    let (src, glsl) = ("src", "glsl");
    let text = format!(
        "Twin: {src}/lib.rs, ({src}/gone/x.rs); ../{src}/b*.rs. {src}/NAME.rs {src}/x.rsx a/{src}/lib.rs x.{glsl} .{glsl}"
    );
    let found: Vec<String> = mentions(&text).collect();
    let expected = ["lib.rs", "gone/x.rs", "b*.rs"].map(|name| format!("{src}/{name}"));
    assert_eq!(found[..3], expected);
    assert_eq!(found[3..], [format!("{SHADERS}/x.{glsl}")]);
    assert!(is_there("src/lib.rs") && is_there("crates/core/glsl/near*.comp"));
    assert!(!is_there(&format!("{src}/gone.rs")) && !is_there(&format!("{src}/gone*.rs")));
}
