//! `bench_scaling` as a process: what it measures, and what it keeps when it is interrupted or a size fails.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Few bins, so that a bounce is short.
const FEW_BINS: &str = "2x3";

fn tool(output: &Path, arguments: &str) -> Command {
    let mut tool = Command::new(env!("CARGO_BIN_EXE_bench_scaling"));
    tool.args(arguments.split_whitespace()).arg("--output").arg(output);
    tool.stdout(Stdio::piped()).stderr(Stdio::piped());
    tool
}

fn run(output: &Path, arguments: &str) -> (Option<i32>, String) {
    let Output { status, stderr, .. } = tool(output, arguments).output().expect("the tool runs");
    let stderr = String::from_utf8(stderr).expect("text in UTF-8");
    assert!(!stderr.contains("panicked"), "{stderr}");
    (status.code(), stderr)
}

/// A folder for results.
fn folder() -> (TempDir, PathBuf) {
    let folder = TempDir::new().expect("a temporary folder");
    let out = folder.path().join("out");
    (folder, out)
}

fn names(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).expect("a folder");
    let name = |entry: std::io::Result<fs::DirEntry>| entry.expect("an entry").file_name();
    let mut names: Vec<String> = entries.map(|e| name(e).into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

/// Rows of the table, by the names of its columns.
fn rows(out: &Path) -> Vec<std::collections::HashMap<String, String>> {
    let mut reader = csv::Reader::from_path(out.join("scaling.csv")).expect("a table");
    reader.deserialize().map(|row| row.expect("a row")).collect()
}

fn sizes(out: &Path) -> Vec<String> {
    rows(out).iter().map(|row| row["size"].clone()).collect()
}

const ALL_FILES: [&str; 3] = ["memory.svg", "scaling.csv", "time.svg"];

#[test]
fn planned_is_allocated_and_agrees_with_the_growth_of_the_process() {
    let (_folder, out) = folder();
    let arguments = "--triangles 10000 --backend vulkan,cpu --quiet";
    assert_eq!(run(&out, arguments), (Some(0), String::new()));
    let rows = rows(&out);
    assert_eq!(rows.iter().map(|row| row["backend"].as_str()).collect::<Vec<_>>(), ["cpu", "vulkan"]);
    for row in rows {
        let number = |name: &str| row[name].parse::<f64>().expect("a number");
        assert_eq!(number("bytes_planned"), number("bytes_allocated"));
        assert_eq!(number("bytes_planned"), number("bytes_peak"));
        // Lavapipe compiles kernels in this process, some MiB of code.
        let code = if row["backend"] == "vulkan" { f64::from(8 << 20) } else { 0.0 };
        let off = (number("resident_growth") - number("bytes_allocated")).abs();
        assert!(off <= 0.15 * number("bytes_allocated") + code, "{}: {off}", row["backend"]);
        assert!(number("bytes_per_triangle") < 4000.0);
        assert!(!row["device"].is_empty() && number("threads") >= 1.0);
    }
    assert_eq!(names(&out), ALL_FILES);
}

/// A budget of a Vulkan device too small for the states: the bounce runs all the same, within the budget.
#[test]
fn a_short_budget_is_kept() {
    let (_folder, out) = folder();
    assert_eq!(run(&out, "--triangles 2000 --quiet --memory-budget 6MiB"), (Some(0), String::new()));
    let rows = rows(&out);
    let number = |name: &str| rows[0][name].parse::<u64>().expect("a number");
    assert_eq!(number("bytes_planned"), number("bytes_allocated"));
    assert!(number("bytes_peak") <= 6 << 20);
    assert!(number("bytes_host") > 6 << 20);
    assert!(number("bytes_moved") > number("bytes_host") / 2);
}

/// Under `mpirun` every process would measure everything; the tool starts `mpirun` itself.
#[test]
fn several_processes_started_together_are_refused() {
    let (_folder, out) = folder();
    for variable in ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"] {
        let mut tool = tool(&out, "--triangles 1000 --quiet");
        let Output { status, stderr, .. } = tool.env(variable, "2").output().expect("the tool runs");
        let stderr = String::from_utf8(stderr).expect("text in UTF-8");
        assert_eq!(status.code(), Some(2), "{stderr}");
        assert!(stderr.contains(variable) && stderr.contains("--ranks"), "{stderr}");
        assert!(!out.exists());
    }
}

/// Sizes too large for the budget fail with the budget that would suffice; the others are kept.
#[test]
fn a_size_that_fails_keeps_the_others() {
    let (_folder, out) = folder();
    let arguments = format!("--triangles 1000,40000,2000 --bins {FEW_BINS} --quiet --memory-budget 6MiB");
    let (code, stderr) = run(&out, &arguments);
    assert_eq!(code, Some(2), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(
        stderr.starts_with("bench_scaling: 40000 triangles: a memory budget of 6291456 bytes"),
        "{stderr}"
    );
    assert_eq!(sizes(&out), ["1000", "2000"]);
    assert_eq!(names(&out), ALL_FILES);
}

#[cfg(unix)]
#[test]
fn interrupted_it_ends_soon_and_goes_on_where_it_was() {
    let (_folder, out) = folder();
    let few = format!("--bins {FEW_BINS} --quiet");
    let mut child = tool(&out, &format!("--triangles 1000,60000 {few}")).spawn().expect("the tool runs");
    // The first size is done, the second under way.
    until(&mut child, || out.join("scaling.csv").exists());
    std::thread::sleep(Duration::from_secs(1));
    let sent = Instant::now();
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().expect("kill runs").success());
    let output = child.wait_with_output().expect("the tool ends");
    let took = sent.elapsed();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert_eq!(stderr, "bench_scaling: interrupted; go on with --resume\n");
    // A bounce that is not interrupted takes minutes.
    assert!(took < Duration::from_secs(20), "{took:?} from the signal to the end");
    assert_eq!(names(&out), ["scaling.csv"]);
    let kept = rows(&out);
    assert_eq!(sizes(&out), ["1000"]);

    assert_eq!(run(&out, &format!("--triangles 1000,2000 {few} --resume")), (Some(0), String::new()));
    assert_eq!(sizes(&out), ["1000", "2000"]);
    assert_eq!(rows(&out)[0], kept[0], "measured again");
    assert_eq!(names(&out), ALL_FILES);

    // Other bins are another measurement.
    assert_eq!(run(&out, "--triangles 1000 --bins 2x4 --quiet --resume"), (Some(0), String::new()));
    assert_eq!((sizes(&out), rows(&out)[0]["bins"].as_str()), (vec!["1000".to_owned()], "2x4"));
}

#[cfg(unix)]
fn until(child: &mut Child, done: impl Fn() -> bool) {
    while !done() {
        assert!(child.try_wait().expect("a child").is_none(), "ended early");
        std::thread::sleep(Duration::from_millis(20));
    }
}
