//! Types in public signatures of the library have public names: who calls a function can write down what it takes and gives.

#[path = "support/paths.rs"]
mod paths;

use paths::{read, sources, without_tests, words};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

/// The sources of each crate, by the name that paths have for it.
fn crates() -> BTreeMap<String, Vec<String>> {
    let folders = fs::read_dir("crates").expect("the crates").map(|entry| entry.expect("an entry").path());
    let of = |folder: PathBuf| {
        let name = folder.file_name().and_then(|name| name.to_str()).expect("a name");
        let files = sources(&folder.join("src")).into_iter();
        (format!("antirad_{name}"), files.map(|(_, text)| without_tests(&text).to_owned()).collect())
    };
    folders.map(of).collect()
}

/// The names that a root brings in from each crate, with whether its documentation has them.
fn exported(root: &str) -> Vec<(String, String, bool)> {
    let (mut found, mut hidden) = (Vec::new(), false);
    for (at, line) in root.lines().enumerate() {
        let Some(path) = line.trim_start().strip_prefix("pub use ") else {
            hidden = line.contains("#[doc(hidden)]") || hidden && line.contains("#[");
            continue;
        };
        let rest: Vec<&str> = root.lines().skip(at + 1).collect();
        let statement = format!("{path}\n{}", rest.join("\n"));
        let statement = statement.split(';').next().unwrap_or("");
        let mut paths = Vec::new();
        read(&words(statement), &[], &mut paths);
        for path in paths.iter().filter(|path| path.len() > 1) {
            found.push((path[0].clone(), path[path.len() - 1].clone(), !hidden));
        }
        hidden = false;
    }
    found
}

/// Types that stand in the signatures that users of an item see: its fields, variants, methods, or itself if it is a function. What the
/// documentation hides is not among them.
fn signatures(sources: &[String], item: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut add = |text: &str, variant: bool| {
        let names = words(text).into_iter().filter(|word| word.starts_with(char::is_uppercase));
        found.extend(names.skip(variant.into()).map(str::to_owned));
    };
    for source in sources {
        let lines: Vec<&str> = source.lines().collect();
        let mut at = 0;
        while let Some(line) = lines.get(at) {
            at += 1;
            // Nearly all lines are of something else.
            if !line.contains(item) {
                continue;
            }
            let head = words(line);
            let is = |words: &[&str]| head.starts_with(words) && head.get(words.len()) == Some(&item);
            let of_item = head.first() == Some(&"impl") && !head.contains(&"for") && {
                let name = head.iter().rev().skip(1).find(|word| word.starts_with(char::is_uppercase));
                name == Some(&item) || head.get(1) == Some(&item)
            };
            let kind = ["struct", "enum", "trait"].into_iter().find(|kind| is(&["pub", kind]));
            if is(&["pub", "fn"]) || is(&["pub", "type"]) || kind.is_some() && line.ends_with(';') {
                let end = (at..lines.len()).find(|&k| lines[k - 1].ends_with(['{', ';'])).unwrap_or(at);
                add(&lines[at - 1..end].join(" ").replace(item, ""), false);
            }
            if !(of_item || kind.is_some()) || !line.ends_with('{') {
                continue;
            }
            let mut hidden = false;
            while let Some(line) = lines.get(at).filter(|line| **line != "}") {
                at += 1;
                let Some(text) = line.strip_prefix("    ").filter(|text| !text.starts_with([' ', '}', ')']))
                else {
                    continue;
                };
                if text.starts_with("#[") || text.starts_with("//") || text.is_empty() {
                    hidden |= text == "#[doc(hidden)]";
                    continue;
                }
                // A signature, or a variant with its fields, up to its end.
                let ends: &[char] = match kind {
                    Some("enum") if text.ends_with('{') => &[],
                    _ if text.contains("fn ") => &['{', ';', '}'],
                    _ => &['{', ';', ',', '}'],
                };
                let closes = |at: usize| lines.get(at).is_none_or(|next| next.starts_with("    }"));
                let first = at - 1;
                while if ends.is_empty() { !closes(at) } else { !lines[at - 1].ends_with(ends) } {
                    at += 1;
                }
                let seen = matches!(kind, Some("enum" | "trait")) || text.starts_with("pub ");
                if seen && !hidden {
                    add(&lines[first..at].join("\n"), kind == Some("enum"));
                }
                hidden = false;
            }
        }
    }
    found
}

/// The names of public types of all crates.
fn types(sources: &BTreeMap<String, Vec<String>>) -> BTreeSet<&str> {
    let mut types = BTreeSet::new();
    for line in sources.values().flatten().flat_map(|source| source.lines()) {
        if let ["pub", "struct" | "enum" | "trait", name, ..] = words(line)[..] {
            types.insert(name);
        }
    }
    types
}

#[test]
fn types_in_signatures_have_names() {
    let sources = crates();
    let types = types(&sources);
    let root = fs::read_to_string("src/lib.rs").expect("the library");
    let exported = exported(&root);
    let shown: BTreeSet<&str> = exported.iter().filter(|item| item.2).map(|item| &*item.1).collect();
    let mut wrong = BTreeSet::new();
    for (of, item, _) in exported.iter().filter(|item| item.2) {
        let Some(sources) = sources.get(of) else { continue };
        for used in signatures(sources, item) {
            if types.contains(&*used) && !shown.contains(&*used) {
                wrong.insert(format!("{used}, of {of}::{item}"));
            }
        }
    }
    let wrong: Vec<String> = wrong.into_iter().collect();
    assert!(wrong.is_empty(), "without a name in `antirad`:\n{}", wrong.join("\n"));
}

#[test]
fn signatures_are_found() {
    let source = "/// A.\npub struct A<'a> {\n    /// B.\n    pub b: &'a B,\n    c: C,\n    #[doc(hidden)]\n    pub d: D,\n}\n\nimpl<'a> A<'a> {\n    \
                  pub fn f(&self) -> E {\n        F::new()\n    }\n\n    fn g(&self, g: G) {}\n\n    #[doc(hidden)]\n    pub fn h(h: H) {\n    }\n}\n\n\
                  impl From<I> for A<'_> {\n    fn from(i: I) -> Self {}\n}\n";
    assert_eq!(signatures(&[source.to_owned()], "A"), ["B", "E"]);
    let source = "pub enum A {\n    B(C),\n    #[doc(hidden)]\n    D(E),\n    F {\n        g: G,\n    },\n}\npub fn h(\n    i: I,\n) -> J {\n}\n";
    assert_eq!(signatures(&[source.to_owned()], "A"), ["C", "G"]);
    assert_eq!(signatures(&[source.to_owned()], "h"), ["I", "J"]);
    let root = "pub mod a {\n    #[doc(inline)]\n    pub use b::{C, d::E};\n    #[doc(hidden)]\n    pub use b::F;\n}\n";
    let names = exported(root).into_iter().map(|(_, name, shown)| (name, shown)).collect::<Vec<_>>();
    assert_eq!(names, [("C", true), ("E", true), ("F", false)].map(|(name, shown)| (name.to_owned(), shown)));
}
