//! Which layer may use which: the graph of ARCHITECTURE.md, compared with the paths of the sources.

#[path = "support/paths.rs"]
mod paths;

use paths::{Names, is_name, read, sources, words};
use std::collections::BTreeMap;
use std::fs;

/// Each layer, and all that it may use, by the graph of ARCHITECTURE.md.
fn layers() -> Vec<(String, Vec<String>)> {
    let text = fs::read_to_string("ARCHITECTURE.md").expect("ARCHITECTURE.md");
    let (_, section) = text.split_once("### Dependencies").expect("a section on dependencies");
    let names = |list: &str| list.split(',').map(|name| name.trim().to_owned()).collect::<Vec<_>>();
    let rows = section.lines().skip_while(|line| !line.starts_with("    "));
    rows.take_while(|line| line.starts_with("    "))
        .flat_map(|line| match line.split_once('→') {
            Some((name, uses)) => vec![(name.trim().to_owned(), names(uses))],
            None => {
                let free = line.strip_suffix("(nothing)").expect("an arrow, or `(nothing)`");
                names(free).into_iter().map(|name| (name, Vec::new())).collect()
            }
        })
        .collect()
}

/// The crates that hold several layers, one for each file or folder of their `src/`. The others are one layer each.
const SEVERAL: [&str; 3] = ["base", "core", "render"];

/// The layer of a file or folder of a crate's `src/`.
fn layer_of_file<'a>(package: &'a str, name: &'a str) -> &'a str {
    match name {
        _ if !SEVERAL.contains(&package) => package,
        "engine_builder" | "engine_direct" => "engine",
        "gradients_direct" => "gradients",
        name => name,
    }
}

/// The layer of each name at the root of a crate.
fn layer_of<'a>(package: &'a str, name: &'a str) -> &'a str {
    match name {
        _ if !SEVERAL.contains(&package) => package,
        "Gradients" | "MaterialGradients" | "Cotangent" => "gradients",
        "Watch" => "watch",
        "setters" => "options",
        name if name.starts_with(char::is_uppercase) => "engine",
        name => layer_of_file(package, name),
    }
}

/// The names that the paths of a source have behind a root, one for each run of paths with the same; not behind `$crate` in macros.
fn used(source: &str, root: &str) -> Vec<String> {
    let all = words(source);
    let (mut words, mut paths) = (&all[..], Vec::new());
    while let [word, rest @ ..] = words {
        words = match (*word, rest) {
            ("$", [_, rest @ ..]) => rest,
            (word, _) if is_name(word) => read(words, &[], &mut paths),
            _ => rest,
        };
    }
    let behind = |path: Names| path.get(1).filter(|_| path[0] == root).cloned();
    let mut names: Vec<String> = paths.into_iter().filter_map(behind).collect();
    names.dedup();
    names
}

#[test]
fn arrows_go_one_way() {
    let packages = ["base", "rays", "gpu", "scene", "core", "render", "reference", "fit"];
    let allowed: BTreeMap<String, Vec<String>> = layers().into_iter().collect();
    let mut wrong = Vec::new();
    let folders = packages.map(|package| (package, format!("crates/{package}/src")));
    for (package, folder) in folders.into_iter().chain([("cli", "src/cli".to_owned())]) {
        for entry in fs::read_dir(&folder).expect("a folder of sources") {
            let path = entry.expect("an entry").path();
            let file = path.file_stem().and_then(|name| name.to_str()).expect("a name").to_owned();
            if file == "lib" && SEVERAL.contains(&package) {
                continue;
            }
            let name = layer_of_file(package, &file);
            let Some(uses) = allowed.get(name) else {
                wrong.push(format!("{name} is not among the layers"));
                continue;
            };
            for (file, text) in sources(&path) {
                // The root of the crate `antirad` has the names of `antirad-core`, and modules named as in their crates.
                let own = if package == "cli" { "core" } else { package };
                let roots = packages.map(|package| (package, format!("antirad_{package}")));
                for (root, prefix) in roots.into_iter().chain([(own, "crate".to_owned())]) {
                    for used in used(&text, &prefix) {
                        let layer = layer_of(root, &used);
                        if layer != name && uses.iter().all(|used| used != layer) {
                            wrong.push(format!(
                                "{}: {name} may not use {layer} ({prefix}::{used})",
                                file.display()
                            ));
                        }
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_graph_has_no_cycles() {
    let layers = layers();
    for (i, (name, uses)) in layers.iter().enumerate() {
        for used in uses {
            assert!(
                layers[..i].iter().any(|(below, _)| below == used),
                "{name} uses {used}, which must stand above it in ARCHITECTURE.md"
            );
        }
    }
}

#[test]
fn paths_are_found() {
    let source = "use crate::{a::B, C, d::{e, f}};\nuse crate::g::{h};\n// crate::i\nlet x = crate::J::new(); mycrate::k\n\
                  #[cfg(test)]\nmod tests { use crate::l; }";
    assert_eq!(used(source, "crate"), ["a", "C", "d", "g", "J"]);
}
