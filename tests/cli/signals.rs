//! Ctrl-C and SIGTERM in the middle of a solve.
#![cfg(unix)]

use crate::process::{until_caught, until_worked, work_after};
use crate::{Folder, Run};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

/// CPU time from a signal to the end. Steps and submissions are a quarter of a second at most, on each core; a pass of the scene takes
/// many of them.
const SOON: Duration = Duration::from_secs(2);

#[test]
fn an_interrupted_render_ends_soon_and_writes_nothing() {
    // With states in the memory of the backend, and in a budget that sends them to the host.
    for (signal, code, backend, states, limit) in [
        ("-INT", 130, "cpu", "in the memory of the backend", None),
        ("-INT", 130, "vulkan", "in the memory of the backend", None),
        ("-TERM", 143, "vulkan", "on the host", Some("--memory-budget=16MiB")),
    ] {
        let folder = Folder::with(&[]);
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell_boxes_fine.toml");
        let mut tool = folder.tool([
            "render",
            "--verbose",
            "--output",
            "out",
            "--visibility",
            "implicit",
            "--tolerance",
            "1e-7",
        ]);
        let mut child = tool
            .args(["--backend", backend])
            .args(limit)
            .arg(scene)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the tool runs");

        // Interrupted once a pass is done and the next one is under way.
        let mut stderr = BufReader::new(child.stderr.take().expect("piped"));
        let mut said = String::new();
        while !said.contains("pass 1:") {
            assert!(stderr.read_line(&mut said).expect("text") > 0, "ended early: {said}");
        }
        assert!(said.contains(&format!("states           {states}")), "{said}");
        let worked = work_after(&mut child, signal);
        let output = child.wait_with_output().expect("the tool ends");

        stderr.read_to_string(&mut said).expect("text");
        let run = Run::from(output);
        assert_eq!(run.code, Some(code), "{said}");
        assert_eq!(run.stdout, "");
        assert!(said.ends_with("antirad: interrupted; nothing was written\n"), "{said}");
        assert!(!said.contains("panicked"), "{said}");
        assert!(folder.results().is_empty(), "{:?}", folder.results());
        assert!(worked.is_none_or(|worked| worked < SOON), "{worked:?} from the signal to the end");
    }
}

/// The search for settings plans and solves in turn; it can be interrupted in either.
#[test]
fn an_interrupted_search_for_settings_ends_soon_and_writes_nothing() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell_boxes_fine.toml");
    for worked in [Duration::ZERO, Duration::from_secs(3)] {
        let folder = Folder::with(&[]);
        let mut tool = folder.tool(["render", "--verbose", "--output", "out", "--target-error", "0.01"]);
        let mut child =
            tool.arg(&scene).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool runs");
        until_caught(&mut child);
        until_worked(&mut child, worked);
        let worked = work_after(&mut child, "-INT");
        let run = Run::from(child.wait_with_output().expect("the tool ends"));
        assert_eq!(run.code, Some(130), "{run:?}");
        // Before it stand lines of --verbose.
        assert!(run.stderr.ends_with("antirad: interrupted; nothing was written\n"), "{}", run.stderr);
        assert!(folder.results().is_empty());
        assert!(worked.is_none_or(|worked| worked < SOON), "{worked:?} from the signal to the end");
    }
}
