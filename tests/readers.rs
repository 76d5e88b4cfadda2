//! The readers of files accept any bytes without panicking: the corpus of the fuzzer (fuzz/corpus), and mutations of
//! it, the same on every run. scripts/fuzz looks further.

#[path = "../fuzz/readers.rs"]
mod readers;
mod support;

use readers::{Folder, Reader};
use std::time::{Duration, Instant};
use support::path;
use support::random::Random;

/// Mutations per reader; ANTIRAD_MUTATIONS asks for more.
const MUTATIONS: usize = 1000;
/// Longest time for one small input.
const HANG: Duration = Duration::from_secs(10);

const WORDS: [&str; 44] = [
    "v",
    "f",
    "usemtl",
    "mtllib",
    "newmtl",
    "Kd",
    "Ks",
    "Ns",
    "Ke",
    "1e309",
    "-1",
    "0",
    "nan",
    "inf",
    "1e-320",
    "/",
    "//",
    "\\\n",
    "\n",
    "\r\n",
    "#",
    "\u{feff}",
    "é",
    "[[mesh]]",
    "path = ",
    "shape = ",
    "{ kind = \"quad\" }",
    "material",
    "[",
    "]",
    "{",
    "}",
    "\"",
    "=",
    "[camera.",
    "[settings]",
    "scene = ",
    "[[fit]]",
    "[[target]]",
    "99999999999999999999",
    "/dev/zero",
    "..",
    "4294967296",
    "-9223372036854775808",
];

fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = std::fs::read_dir(path("fuzz/corpus").join(name)).expect("a corpus");
    let mut files: Vec<_> = folder.map(|entry| entry.expect("an entry").path()).collect();
    files.sort();
    assert!(!files.is_empty());
    files.iter().map(|file| std::fs::read(file).expect("an input")).collect()
}

/// One to four changes: bytes, words, numbers, lines twice or gone, pieces of another input.
fn mutated(corpus: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    let mut below = |n: usize| ((random.next() * n as f64) as usize).min(n.saturating_sub(1));
    let mut data = corpus[below(corpus.len())].clone();
    for _ in 0..=below(4) {
        let at = below(data.len() + 1);
        let end = (at + below(12)).min(data.len());
        match below(7) {
            0 if at < data.len() => data[at] = below(256) as u8,
            1 => drop(data.splice(at..end, [])),
            2 => drop(data.splice(at..at, WORDS[below(WORDS.len())].bytes())),
            3 => drop(data.splice(at..end, WORDS[below(WORDS.len())].bytes())),
            4 => {
                let other = &corpus[below(corpus.len())];
                let from = below(other.len() + 1);
                let piece = other[from..(from + below(80)).min(other.len())].to_vec();
                drop(data.splice(at..at, piece));
            }
            5 => {
                let piece = data[at..(at + below(80)).min(data.len())].to_vec();
                drop(data.splice(end..end, piece));
            }
            _ => {
                if let Some(digit) = (at..data.len()).find(|&k| data[k].is_ascii_digit()) {
                    data[digit] = b"0123456789-.e"[below(13)];
                }
            }
        }
    }
    data
}

fn read_all(reader: Reader, name: &str) {
    let folder = Folder::new();
    let read = |data: &[u8]| {
        let begin = Instant::now();
        folder.read(reader, data);
        assert!(begin.elapsed() <= HANG, "{reader:?} hangs over {}", String::from_utf8_lossy(data));
    };
    let corpus = corpus(name);
    corpus.iter().for_each(|data| read(data));
    let count = std::env::var("ANTIRAD_MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(MUTATIONS);
    let mut random = Random::new(1);
    for _ in 0..count {
        read(&mutated(&corpus, &mut random));
    }
}

#[test]
fn meshes() {
    read_all(Reader::Obj, "obj");
}

#[test]
fn cameras() {
    read_all(Reader::Cameras, "cameras");
}

#[test]
fn materials() {
    read_all(Reader::Mtl, "mtl");
}

#[test]
fn scenes() {
    read_all(Reader::Scene, "scene");
}

#[test]
fn jobs() {
    read_all(Reader::Job, "job");
}

#[test]
fn gltf() {
    read_all(Reader::Gltf, "gltf");
}

#[test]
fn mitsuba() {
    read_all(Reader::Mitsuba, "mitsuba");
}

#[test]
fn ply() {
    read_all(Reader::Ply, "ply");
}

/// They would yield bytes without end.
#[test]
#[cfg(unix)]
fn devices_are_no_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let refused = |name: &str, text: &str| {
        let file = folder.path().join(name);
        std::fs::write(&file, text).expect("a file");
        let error =
            antirad::scene::Scene::load(&file, &Default::default()).expect_err("a device").to_string();
        assert!(error.contains("a device or a pipe") && error.contains(":1: "), "{error}");
    };
    refused("s.toml", "mesh = [{ path = \"/dev/zero\" }]\n");
    refused("m.obj", "mtllib /dev/zero\nv 0 0 0\n");
}
