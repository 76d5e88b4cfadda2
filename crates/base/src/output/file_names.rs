//! Names of files for things that have names of their own, such as cameras.

use std::collections::HashSet;

/// Bytes of a name at most: file systems allow 255, and endings follow.
const LONGEST: usize = 200;
/// Names that Windows keeps for devices, whatever their ending.
const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];
const PORTS: [&str; 2] = ["com", "lpt"];

/// Gives each name one for a file: within its folder, legal on all systems, and no other's, even where systems take capitals for small letters.
#[derive(Clone, Debug, Default)]
pub struct FileNames {
    /// In small letters.
    taken: HashSet<String>,
}

impl FileNames {
    /// Without these, which files of other content have.
    pub fn without(taken: &[&str]) -> Self {
        Self { taken: taken.iter().map(|name| name.to_lowercase()).collect() }
    }

    /// The name of the file for a name: the same, where that is possible. Separators, control characters and what Windows forbids become
    /// `_`; the second of a kind is numbered.
    pub fn of(&mut self, name: &str) -> String {
        free_name(&legal(name), |name| self.taken.insert(name.to_lowercase()))
    }
}

/// The first of `NAME`, `NAME_2`, `NAME_3` and so on that is free.
pub fn free_name(name: &str, mut is_free: impl FnMut(&str) -> bool) -> String {
    let numbered = (2u64..).map(|n| format!("{name}_{n}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    names.find(|name| is_free(name)).unwrap_or_default()
}

fn legal(name: &str) -> String {
    let is_bad = |c: char| "/\\:*?\"<>|".contains(c) || c.is_control();
    let mut legal: String = name.chars().map(|c| if is_bad(c) { '_' } else { c }).collect();
    let end = (0..=LONGEST.min(legal.len())).rfind(|&end| legal.is_char_boundary(end)).unwrap_or(0);
    legal.truncate(end);
    // Windows drops them.
    legal.truncate(legal.trim_end_matches(['.', ' ']).len());
    let stem = legal.split('.').next().unwrap_or_default().to_lowercase();
    let is_port =
        |port: &&str| stem.strip_prefix(*port).is_some_and(|n| n.len() == 1 && n.parse::<u8>().is_ok());
    let is_hidden = legal.is_empty() || legal.starts_with('.');
    if is_hidden || DEVICES.contains(&stem.as_str()) || PORTS.iter().any(is_port) {
        legal.insert(0, '_');
    }
    legal
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_their_folder_and_are_told_apart() {
        let mut names = FileNames::without(&["report"]);
        for (name, file) in [
            ("main", "main"),
            ("a/b", "a_b"),
            ("a_b", "a_b_2"),
            ("Main", "Main_2"),
            ("../../x", "_.._.._x"),
            ("/abs/x", "_abs_x"),
            ("..", "_"),
            ("", "__2"),
            (".hidden", "_.hidden"),
            ("a\0b\u{1b}[31m", "a_b_[31m"),
            ("C:\\x", "C__x"),
            ("report", "report_2"),
            ("con", "_con"),
            ("LPT1.old", "_LPT1.old"),
            ("end. ", "end"),
            ("Küche", "Küche"),
        ] {
            assert_eq!(names.of(name), file, "{name:?}");
        }
        let long = names.of(&"ü".repeat(200));
        assert!(long.len() == LONGEST && long.chars().all(|c| c == 'ü'), "{long}");
    }
}
