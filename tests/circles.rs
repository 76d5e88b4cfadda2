//! Files of a crate use each other one way, as layers do. The front of a folder (`mod.rs`, or the file named as it) and what lies in the
//! folder count as one: files may use the front's definitions, and the front uses its files.

#[path = "support/paths.rs"]
mod paths;

use paths::{Names, is_name, read, sources, words};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Files that need each other. The list may only become shorter.
const KNOWN: [&str; 26] = [
    "core: direct::blockers, direct::derivative, direct::highlight, direct::openness, direct::quadrature, direct::sampling, direct::subtraction, direct::visible",
    "core: direct::polygon, direct::solid",
    "core: engine, engine_direct",
    "core: plan::memory, plan::near_matrix, plan::residency",
    "core: transport::cpu::adjoint, transport::cpu::observation_adjoint, transport::cpu::reflection_adjoint",
    "core: transport::cpu::close_derivative, transport::cpu::derivative, transport::cpu::far_derivative",
    "core: transport::cpu::far, transport::cpu::pieces",
    "core: transport::cpu::exchanged, transport::cpu::pairs",
    "core: transport::cpu::real, transport::cpu::state",
    "core: transport::vulkan::adjoint, transport::vulkan::exchange_adjoint, transport::vulkan::exchange_derivative, transport::vulkan::observation_adjoint, transport::vulkan::reflection_adjoint",
    "core: transport::vulkan::distributed, transport::vulkan::residency, transport::vulkan::state",
    "fit: checkpoint, job",
    "fit: exposure, loss, target",
    "fit: job_file, photographs, target_table",
    "fit: parameters, selection",
    "gpu: buffer, commands, device, pipeline, recorder, transfer",
    "gpu: instance, survey",
    "render: image::coverage, image::error, image::picture, image::raster",
    "render: image::photo::codecs, image::photo::labels",
    "render: shading::pattern, shading::sights",
    "scene: assembly, file, tables",
    "scene: check, sky, sun",
    "scene: contacts, refine",
    "scene: error, size",
    "scene: gltf_file, mesh_file, mitsuba, point_lights",
    "scene: mitsuba::transform, mitsuba::values",
];

/// What a file says of others.
#[derive(Default)]
struct File {
    /// All paths of two names or more, those of `use` included.
    paths: Vec<Names>,
    /// What `use` brings in, by its last name.
    imports: BTreeMap<String, Names>,
    /// Those that others may use through this file.
    shown: BTreeMap<String, Names>,
}

fn file(source: &str) -> File {
    let all = words(source);
    let mut file = File::default();
    let (mut words, mut last) = (&all[..], "");
    while let [word, rest @ ..] = words {
        let mut found = Vec::new();
        let is_use = *word == "use";
        words = match word {
            &"use" => read(rest, &[], &mut found),
            word if is_name(word) => read(words, &[], &mut found),
            _ => rest,
        };
        if is_use {
            for path in &found {
                let name = path.last().cloned().unwrap_or_default();
                // `pub use`, or `pub(crate) use`.
                if matches!(last, "pub" | ")") {
                    file.shown.insert(name.clone(), path.clone());
                }
                file.imports.insert(name, path.clone());
            }
        }
        last = word;
        file.paths.extend(found.into_iter().filter(|path| path.len() > 1));
    }
    file
}

/// The files of a folder by the paths of their modules.
fn files(folder: &Path) -> BTreeMap<String, File> {
    let module = |path: &Path| {
        let within = path.strip_prefix(folder).expect("a file of the folder").with_extension("");
        let names: Vec<&str> = within.iter().map(|name| name.to_str().expect("a name")).collect();
        match names[..] {
            [.., "tests"] => None,
            [ref above @ .., "lib" | "mod"] => Some(above.join("::")),
            ref names => Some(names.join("::")),
        }
    };
    let files = sources(folder).into_iter();
    files.filter_map(|(path, source)| Some((module(&path)?, file(&source)))).collect()
}

/// The file that defines what a path in `from` means, if it is one of the crate's.
fn target(files: &BTreeMap<String, File>, from: &str, path: &[String], steps: usize) -> Option<String> {
    let below = |at: &str, name: &str| if at.is_empty() { name.to_owned() } else { format!("{at}::{name}") };
    let above = |at: &str| at.rsplit_once("::").map_or("", |(above, _)| above).to_owned();
    let first = path.first()?;
    let (mut at, mut rest) = (from.to_owned(), path);
    match first.as_str() {
        "crate" => (at, rest) = (String::new(), &path[1..]),
        "self" => rest = &path[1..],
        "super" => {
            while let Some(further) = rest.split_first().filter(|(name, _)| *name == "super") {
                (at, rest) = (above(&at), further.1);
            }
        }
        name if files.contains_key(&below(from, name)) => {}
        name => {
            let import = files.get(from)?.imports.get(name)?;
            let whole = [import, &path[1..]].concat();
            return if steps > 0 { target(files, from, &whole, steps - 1) } else { None };
        }
    }
    while let Some((name, further)) = rest.split_first() {
        match files.contains_key(&below(&at, name)) {
            true => (at, rest) = (below(&at, name), further),
            false => {
                let shown = files.get(&at)?.shown.get(name).filter(|_| steps > 0);
                return shown.and_then(|shown| target(files, &at, shown, steps - 1)).or(Some(at));
            }
        }
    }
    Some(at)
}

/// The circles of a crate: each file that is in one, and all those that it needs and that need it.
fn circles(files: &BTreeMap<String, File>) -> BTreeSet<BTreeSet<&str>> {
    let is_front = |of: &str, file: &str| {
        of.is_empty() || file.strip_prefix(of).is_some_and(|rest| rest.is_empty() || rest.starts_with("::"))
    };
    // More steps than a name is passed on through fronts.
    let steps = 8;
    let mut uses: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (name, file) in files {
        let targets = file.paths.iter().filter_map(|path| target(files, name, path, steps));
        let known = targets.filter_map(|target| files.get_key_value(&target)).map(|(target, _)| &**target);
        uses.insert(name, known.filter(|other| !is_front(other, name) && !is_front(name, other)).collect());
    }
    // All that a file reaches.
    let reached = |from: &str| {
        let mut reached: BTreeSet<&str> = BTreeSet::new();
        let mut next: Vec<&str> = uses[from].iter().copied().collect();
        while let Some(file) = next.pop() {
            if reached.insert(file) {
                next.extend(&uses[file]);
            }
        }
        reached
    };
    let reached: BTreeMap<&str, BTreeSet<&str>> = uses.keys().map(|file| (*file, reached(file))).collect();
    let circle = |file: &&str| -> BTreeSet<&str> {
        reached[*file].iter().copied().filter(|other| reached[other].contains(file)).collect()
    };
    reached.keys().map(circle).filter(|circle| !circle.is_empty()).collect()
}

#[test]
fn files_do_not_need_each_other() {
    let mut found = BTreeSet::new();
    for crates in fs::read_dir("crates").expect("the crates") {
        let folder = crates.expect("an entry").path();
        let name = folder.file_name().and_then(|name| name.to_str()).expect("a name").to_owned();
        for circle in circles(&files(&folder.join("src"))) {
            found.insert(format!("{name}: {}", circle.into_iter().collect::<Vec<_>>().join(", ")));
        }
    }
    let known: BTreeSet<String> = KNOWN.map(str::to_owned).into();
    let lines = |of: &BTreeSet<String>| of.iter().map(|line| format!("    {line:?},\n")).collect::<String>();
    assert!(
        found == known,
        "new circles:\n{}gone:\n{}",
        lines(&(&found - &known)),
        lines(&(&known - &found))
    );
}

#[test]
fn paths_are_resolved() {
    let sources = [
        ("", "mod a; mod b;\npub use a::one::Thing;"),
        ("a", "mod one; mod two; pub(crate) use one::Thing;"),
        ("a::one", "use super::two::{self, Other};\npub struct Thing; // crate::b"),
        ("a::two", "use crate::{a::Thing, b as c};\npub struct Other;"),
        ("b", "fn f() { let _ = crate::Thing; }\n#[cfg(test)]\nmod tests { use crate::a; }"),
    ];
    let files: BTreeMap<String, File> =
        sources.into_iter().map(|(name, source)| (name.to_owned(), file(source))).collect();
    let path = |text: &str| text.split("::").map(str::to_owned).collect::<Names>();
    assert_eq!(target(&files, "b", &path("crate::Thing"), 8).as_deref(), Some("a::one"));
    assert_eq!(target(&files, "a::one", &path("two::Other"), 8).as_deref(), Some("a::two"));
    assert_eq!(target(&files, "b", &path("std::fs"), 8), None);
    // `a::two` uses `b`, which uses `a::one` through the front of the crate.
    assert_eq!(circles(&files), BTreeSet::from([BTreeSet::from(["a::one", "a::two", "b"])]));
}
