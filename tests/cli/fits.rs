//! `antirad fit`: single jobs, batches, and what remains of them when they are killed.

use crate::{Folder, ROOM, Run, names, run, says};
use antirad::scene::{LoadOptions, Scene};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Few bins: these tests are about files and processes.
const SETTINGS: &str = "\n[settings]\nbins = { concentric = 2 }\ntolerance = 1e-5\nnear_field = 4\n";

/// Result files that differ between runs.
const DIFFERS: [&str; 5] = [".lock", "checkpoint", "checkpoint.previous", "report.json", "status.json"];

pub const JOB: &str = r#"scene = "room.toml"

[[target]]
picture = "out/main.exr"
camera = "main"

[[target]]
picture = "out/side.exr"
camera = "side"

[[fit]]
parameter = "albedo"
materials = ["wall"]
initial = 0.5

[[fit]]
parameter = "emission"
materials = ["lamp"]
initial = 3

[stop]
relative_decrease = 0
iterations = 12

[checkpoint]
every = 2

# Slowly, so that there is something to interrupt.
[optimiser]
gauss_newton = 0
"#;

/// A folder with the room, pictures of it, and jobs besides.
pub fn folder(jobs: &[(&str, &str)]) -> Folder {
    let mut files = vec![("room.toml", format!("{ROOM}{SETTINGS}"))];
    files.extend(jobs.iter().map(|(name, text)| (*name, (*text).to_owned())));
    let files: Vec<(&str, &str)> = files.iter().map(|(name, text)| (*name, text.as_str())).collect();
    let folder = Folder::with(&files);
    folder.render("room.toml").succeeded();
    folder
}

/// Names and bytes of a job's results, except for files that hold times or the course of the run.
fn results(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let kept = names(folder).into_iter().filter(|name| !DIFFERS.contains(&name.as_str()));
    kept.map(|name| (name.clone(), fs::read(folder.join(name)).expect("a file"))).collect()
}

#[track_caller]
pub fn same_results(a: &Path, b: &Path) {
    let (a, b) = (results(a), results(b));
    assert!(a.len() > 10, "{:?}", a.iter().map(|(name, _)| name).collect::<Vec<_>>());
    for ((name_a, bytes_a), (name_b, bytes_b)) in a.iter().zip(&b) {
        assert_eq!(name_a, name_b);
        assert!(bytes_a == bytes_b, "{name_a} differs");
    }
    assert_eq!(a.len(), b.len());
}

fn value(folder: &Folder, file: &str, quantity: &str) -> Vec<f64> {
    let list = folder.json(file);
    let found = list.as_array().expect("a list").iter().find(|r| r["quantity"] == quantity).expect("a value");
    found["value"].as_array().expect("numbers").iter().map(|v| v.as_f64().expect("a number")).collect()
}

#[test]
fn a_job_finds_what_the_pictures_were_made_with() {
    let folder = folder(&[("job.toml", JOB)]);
    let mut tool = folder.tool(["fit", "job.toml", "--output", "fits"]);
    let run = run(tool.env("ANTIRAD_VALIDATION", "1")).succeeded();
    says(&run.stdout, &["job:", "iterations", "albedo", "of wall", "fits/job"]);
    // One line at the start and one per iteration, nothing else, as there is no terminal.
    let lines: Vec<&str> = run.stderr.lines().collect();
    assert!(lines[0].contains("6 unknowns") && lines[0].contains("s per iteration"), "{lines:?}");
    assert!(lines[1..].iter().all(|line| line.starts_with("job iteration ")), "{lines:?}");
    let history = String::from_utf8(folder.read("fits/job/history.csv")).expect("text");
    assert_eq!(history.lines().count(), lines.len());

    let near = |found: Vec<f64>, truth: [f64; 3], error: f64| {
        assert!(found.iter().zip(truth).all(|(f, t)| (f - t).abs() < error), "{found:?}, not {truth:?}");
    };
    near(value(&folder, "fits/job/parameters.json", "albedo"), [0.7, 0.5, 0.3], 2e-3);
    near(value(&folder, "fits/job/parameters.json", "emission"), [10.0; 3], 2e-2);
    let report = folder.json("fits/job/report.json");
    assert_eq!(report["optimiser"], "quasi-newton");
    assert!(report["run"]["device"]["name"].is_string());
    assert!(report["run"]["backend"].is_string() && report["run"]["threads"].as_u64() > Some(0));
    assert!(report["loss"]["fell_by_factor"].as_f64().is_some_and(|factor| factor > 1e4), "{report}");
    let (peak, planned) = (&report["run"]["memory"]["peak"], &report["estimate"]["device_bytes"]);
    assert!(peak.as_u64() <= planned.as_u64(), "{peak} of the planned {planned}");

    assert!(
        String::from_utf8(folder.read("fits/job/relight.toml")).expect("text").ends_with("\nlamp = 1.0\n")
    );
    let relit = "render fits/job/scene.toml --relight fits/job/relight.toml --camera side --output relit";
    says(&folder.run(relit).succeeded().stdout, &["relit       lamp x 1"]);

    let compared = folder.run("compare room.toml fits/job/scene.toml").succeeded().stdout;
    says(&compared, &["albedo of wall", "0.7000 0.5000 0.3000", "emission of lamp", "power on true lamps"]);
    assert!(!compared.contains("albedo of lamp") && !compared.contains("vertices"), "{compared}");

    // The fitted scene is a scene, and its picture is the fitted one, but for rays that followed the light of the start.
    let fitted = Scene::load(&folder.path("fits/job/scene.toml"), &LoadOptions::default()).expect("a scene");
    assert_eq!((fitted.triangles.len(), fitted.cameras.len()), (200, 2));
    folder.run("render fits/job/scene.toml --camera main --output again").succeeded();
    let picture = |name: &str| antirad::image::Picture::read_exr(folder.path(name)).expect("a picture");
    let pairs = picture("again/main.exr").pixels.into_iter().zip(picture("fits/job/main.exr").pixels);
    for (again, fitted) in pairs {
        assert!(
            (0..3).all(|c| (again[c] - fitted[c]).abs() <= 2e-3 * (0.1 + fitted[c].abs())),
            "{again:?} {fitted:?}"
        );
    }
}

#[test]
fn a_box_is_moved_back_by_what_two_views_see() {
    let boxed = "\n[[mesh]]\nname = \"block\"\nshape = { kind = \"box\", cells = 1 }\nmaterial = \"lamp\"\n\
                 scale = 0.2\ntranslate = [0.4, 0.1, 0.5]\n";
    let room =
        format!("{ROOM}{boxed}{SETTINGS}").replace("width = 32\nheight = 24", "width = 64\nheight = 48");
    let room = room.replace("width = 16\nheight = 16", "width = 48\nheight = 48");
    let job = "scene = \"room.toml\"\n[[target]]\npicture = \"out/main.exr\"\ncamera = \"main\"\n[[target]]\n\
               picture = \"out/side.exr\"\ncamera = \"side\"\n[[fit]]\nparameter = \"position\"\n\
               meshes = [\"block\"]\nmotion = \"translation\"\ninitial = [0.02, -0.02, 0.02]\n\
               [stop]\nrelative_decrease = 1e-3\niterations = 25\n[solve]\nsupersample = 8\n";
    let folder = Folder::with(&[("room.toml", room.as_str()), ("job.toml", job)]);
    folder.render("room.toml --supersample 8").succeeded();
    folder.run("fit job.toml --output fits").succeeded();
    let way = value(&folder, "fits/job/parameters.json", "translation");
    // Initially off by a tenth of its size.
    assert!(way.iter().all(|w| w.abs() < 1e-3), "{way:?}");
}

/// A photo whose camera is not quite known: the fitted scene has it where it is found, beside its own cameras. It is rolled, since level edges
/// pass all samples of a row at once.
/// Lamps are exact, as in fits of cameras by themselves.
#[test]
fn a_camera_is_found_and_kept() {
    let boxed = "\n[[mesh]]\nname = \"block\"\nshape = { kind = \"box\", cells = 1 }\nmaterial = \"lamp\"\n\
                 scale = 0.2\nrotate_degrees = [20, 30, 10]\ntranslate = [0.4, 0.3, 0.5]\n";
    let room = format!("{ROOM}{boxed}{SETTINGS}lamps = \"exact\"\n")
        .replace("width = 32\nheight = 24", "up = [0.3, 1, 0.1]\nwidth = 64\nheight = 48");
    let job = "scene = \"room.toml\"\n[[target]]\npicture = \"out/photo.exr\"\nview = { position = [0.505, 0.496, 0.05], \
               target = [0.512, 0.5, 1], up = [0.3, 1, 0.1], fov_x_degrees = 85, width = 64, height = 48 }\n[[fit]]\n\
               parameter = \"camera\"\n[stop]\niterations = 25\n[solve]\nsupersample = 8\n";
    let folder = Folder::with(&[("room.toml", room.as_str()), ("job.toml", job)]);
    folder.render("room.toml --supersample 8").succeeded();
    std::fs::rename(folder.path("out/main.exr"), folder.path("out/photo.exr")).expect("renamed");
    folder.run("fit job.toml --output fits").succeeded();
    let place = value(&folder, "fits/job/parameters.json", "camera position");
    let truth = [0.5, 0.5, 0.05];
    // One small picture tells places from turns only roughly.
    let off = |place: &[f64]| place.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    assert!(off(&place) < 0.5 * off(&[0.505, 0.496, 0.05]), "{place:?}");
    let fitted = Scene::load(&folder.path("fits/job/scene.toml"), &LoadOptions::default()).expect("a scene");
    let names: Vec<&str> = fitted.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["main", "side", "photo"]);
    let [first, .., photo] = &fitted.cameras[..] else { panic!("cameras") };
    assert_eq!(first.position.to_array(), truth);
    assert!(photo.position.abs_diff_eq(glam::DVec3::from_slice(&place), 1e-12), "{}", photo.position);
    folder.run("render fits/job/scene.toml --camera photo --supersample 8 --output again").succeeded();
    let picture = |name: &str| antirad::image::Picture::read_exr(folder.path(name)).expect("a picture");
    let pairs = picture("again/photo.exr").pixels.into_iter().zip(picture("fits/job/photo.exr").pixels);
    for (again, fitted) in pairs {
        let near = (0..3).all(|c| (again[c] - fitted[c]).abs() <= 1e-3 * (0.1 + fitted[c].abs()));
        assert!(near, "{again:?} {fitted:?}");
    }
}

#[test]
fn the_log_can_be_json() {
    let folder = folder(&[("job.toml", &JOB.replace("iterations = 12", "iterations = 2"))]);
    let run = folder.run("fit job.toml --output fits --log-format json").succeeded();
    assert_eq!(run.stdout, "");
    let events: Vec<Value> = run
        .stderr
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}")))
        .collect();
    let of = |kind: &str| events.iter().filter(|e| e["event"] == kind).count();
    assert_eq!((of("begin"), of("iteration"), of("end")), (1, 3, 1));
    assert!(events[0]["backend"].is_string() && events[0]["device"].is_string());
    assert!(events[1]["loss"].is_f64() && events[1]["passes"].as_u64() > Some(0));
    assert_eq!(events[4]["result"]["status"], "finished");
    let quiet = folder.run("fit job.toml --output fits --quiet --restart").succeeded();
    assert_eq!((quiet.stdout.as_str(), quiet.stderr.as_str()), ("", ""));
}

/// Each broken job is reported in a line; the others are what they would have been alone.
#[test]
fn a_broken_job_harms_no_other() {
    let short = JOB.replace("iterations = 12", "iterations = 3");
    let folder = folder(&[]);
    fs::create_dir(folder.path("jobs")).expect("a folder");
    for (name, text) in [
        ("a.toml", short.clone()),
        ("b.toml", short.replace("albedo", "albido")),
        ("c.toml", short.replace("main.exr", "none.exr")),
        ("d.toml", short.replace("initial = 0.5", "initial = 0.4")),
        ("no_job.toml", format!("{ROOM}{SETTINGS}")),
        ("notes.txt", String::from("not a job")),
        ("z.toml", String::from("scene = ")),
    ] {
        let text = text.replace("room.toml", "../room.toml").replace("out/", "../out/");
        fs::write(folder.path("jobs").join(name), text).expect("written");
    }
    let batch = folder.run("fit jobs --output fits");
    assert_eq!(batch.code, Some(1), "{batch:?}");
    says(
        &batch.stderr,
        &[
            "antirad: b: jobs/b.toml:12",
            "did you mean `albedo`?",
            "antirad: c: jobs/c.toml:4",
            "antirad: z: jobs/z.toml:1",
        ],
    );
    says(&batch.stdout, &["2 of 5 jobs are done", "index.html", "finished", "FAILED"]);
    assert_eq!(names(&folder.path("fits")), [".lock", "a", "b", "c", "d", "index.html", "summary.csv", "z"]);
    assert_eq!(folder.json("fits/b/status.json")["state"], "failed");
    says(&folder.json("fits/b/status.json")["message"].to_string(), &["did you mean `albedo`?"]);
    let summary = String::from_utf8(folder.read("fits/summary.csv")).expect("text");
    let rows: Vec<&str> = summary.lines().collect();
    assert_eq!(rows.len(), 6);
    assert!(rows[1].starts_with("a,finished,3,") && rows[2].starts_with("b,failed,,"), "{summary}");
    says(&batch.stdout, &["picture error"]);
    let picture_error = |rows: &[&str], row: usize| {
        let column = rows[0].split(',').position(|name| name == "picture_error").expect("a column");
        rows[row].split(',').nth(column).and_then(|cell| cell.parse::<f64>().ok())
    };
    let report = folder.json("fits/a/report.json");
    let error = report["picture_error"].as_f64();
    assert!(error.is_some_and(|error| error > 0.0 && error < 0.5), "{report}");
    // Reading JSON may round the last digit.
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-12 * b;
    assert!(picture_error(&rows, 1).zip(error).is_some_and(|(a, b)| near(a, b)), "{summary}");
    assert_eq!(picture_error(&rows, 2), None, "{summary}");

    for name in ["a", "d"] {
        folder.run(&format!("fit jobs/{name}.toml --output alone")).succeeded();
        same_results(&folder.path("fits").join(name), &folder.path("alone").join(name));
    }
    // Run again: finished jobs are skipped.
    let again = folder.run("fit jobs/a.toml jobs/d.toml --output fits --resume").succeeded();
    says(&again.stderr, &["a: finished before", "d: finished before"]);
    let summary = String::from_utf8(folder.read("fits/summary.csv")).expect("text");
    assert_eq!(picture_error(&summary.lines().collect::<Vec<_>>(), 1), error, "{summary}");
    assert!(!again.stderr.contains("iteration"), "{}", again.stderr);
}

#[test]
fn what_is_refused_before_anything_starts() {
    let folder = folder(&[("job.toml", JOB)]);
    fs::create_dir_all(folder.path("empty")).expect("a folder");
    fs::create_dir_all(folder.path("other")).expect("a folder");
    fs::write(folder.path("other/job.toml"), JOB).expect("written");
    folder.run("fit empty --output fits").refused(&["empty", "no job file"]);
    folder.run("fit job.toml other/job.toml --output fits").refused(&["both", "\"job\"", "rename one"]);
    folder.run("fit job.toml --output room.toml").refused(&["room.toml", "cannot be written"]);
    folder.run("fit job.toml --output fits --device nonesuch").refused(&["\"nonesuch\""]);
    for (backend, budget, bytes) in [("cpu", "64KiB", "65536 bytes"), ("vulkan", "1MiB", "1048576 bytes")] {
        let job = format!("fit job.toml --output fits --backend {backend} --memory-budget {budget}");
        let small = folder.run(&job);
        assert_eq!(small.code, Some(1), "{small:?}");
        says(&small.stderr, &["antirad: job: ", &format!("{bytes} is too small"), "may need"]);
    }
    assert!(!folder.path("fits/job/report.json").exists());
    assert_eq!(folder.run("fit").code, Some(2));
    fs::write(folder.path("other.toml"), ROOM.replace("cells = 4", "cells = 3")).expect("written");
    folder.run("compare room.toml other.toml").refused(&[
        "other.toml",
        "cannot be compared",
        "200 and 116 triangles",
    ]);
}

#[cfg(unix)]
mod killed {
    use super::*;
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};
    use std::time::Duration;

    /// Starts a fit and sends it a signal once it has reported a job's iteration.
    fn kill_at(folder: &Folder, arguments: &str, iteration: &str, signal: &str) -> Run {
        kill_tool_at(folder.tool(arguments.split_whitespace()), iteration, signal)
    }

    fn kill_tool_at(mut tool: Command, iteration: &str, signal: &str) -> Run {
        let mut child = tool.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool runs");
        let mut stderr = BufReader::new(child.stderr.take().expect("piped"));
        let mut said = String::new();
        while !said.contains(iteration) {
            assert!(stderr.read_line(&mut said).expect("text") > 0, "ended early: {said}");
        }
        let pid = child.id().to_string();
        assert!(Command::new("kill").args([signal, &pid]).status().expect("kill runs").success());
        // Signals come in twos: `timeout` signals its child, and then the group that the child is in.
        std::thread::sleep(Duration::from_millis(5));
        let _ = Command::new("kill").args([signal, &pid]).status();
        let output = child.wait_with_output().expect("the tool ends");
        stderr.read_to_string(&mut said).expect("text");
        Run { stderr: said, ..Run::from(output) }
    }

    #[test]
    fn signals_end_it_with_a_checkpoint_and_resuming_leaves_no_trace() {
        let folder = folder(&[("job.toml", JOB)]);
        folder.run("fit job.toml --output whole").succeeded();
        for (signal, code) in [("-TERM", Some(143)), ("-INT", Some(130)), ("-KILL", None)] {
            let _ = fs::remove_dir_all(folder.path("cut"));
            // Twice: early, and again after it was resumed.
            for (iteration, resume) in [("iteration 3:", ""), ("iteration 7:", "--resume")] {
                let run = kill_at(&folder, &format!("fit job.toml --output cut {resume}"), iteration, signal);
                assert_eq!(run.code, code, "{run:?}");
                if code.is_some() {
                    says(&run.stderr, &["antirad: job: interrupted after iteration", "--resume"]);
                }
                assert!(folder.path("cut/job/checkpoint").is_file(), "{run:?}");
                assert!(!folder.path("cut/job/report.json").exists());
            }
            let run = folder.run("fit job.toml --output cut --resume").succeeded();
            // Only the iterations since the last checkpoint, written every two, are repeated.
            let first = run.stderr.lines().nth(1).expect("an iteration");
            assert!(
                ["6", "7", "8", "9"].iter().any(|n| first.starts_with(&format!("job iteration {n}:"))),
                "{first}"
            );
            same_results(&folder.path("whole/job"), &folder.path("cut/job"));
        }
    }

    /// `timeout` of GNU signals its child and, within milliseconds, the group that the child is in.
    #[test]
    #[cfg(target_os = "linux")]
    fn a_timeout_ends_it_with_a_checkpoint() {
        let long = JOB.replace("iterations = 12", "iterations = 100000") + "kind = \"adam\"\n";
        let folder = folder(&[("job.toml", &long)]);
        let timeout = |limit: &str| {
            let mut tool = Command::new("timeout");
            tool.current_dir(folder.path(""))
                .args(["--preserve-status", limit, env!("CARGO_BIN_EXE_antirad")])
                .args(["fit", "job.toml", "--output", "cut", "--resume"]);
            tool
        };
        let ended = |run: &Run| {
            assert_eq!(run.code, Some(143), "{run:?}");
            says(&run.stderr, &["antirad: job: interrupted after iteration", "--resume"]);
        };
        // A signal to `timeout` itself is passed on in the same way. The checkpoint before the signal may be one of an
        // earlier iteration.
        let run = kill_tool_at(timeout("1h"), "iteration 3:", "-TERM");
        ended(&run);
        let reached: u32 = last_iteration(&run.stderr);
        // `timeout` ends it by itself.
        let run = Run::from(timeout("1s").output().expect("timeout runs"));
        ended(&run);
        let first = run.stderr.lines().nth(1).expect("an iteration");
        assert!(first.starts_with(&format!("job iteration {}:", reached + 1)), "{reached}, then {first}");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn nohup_outlives_its_terminal() {
        let folder = folder(&[("job.toml", JOB)]);
        let mut tool = Command::new("nohup");
        tool.current_dir(folder.path("")).arg(env!("CARGO_BIN_EXE_antirad"));
        tool.args(["fit", "job.toml", "--output", "fits"]);
        let run = kill_tool_at(tool, "iteration 3:", "-HUP");
        assert_eq!(run.code, Some(0), "{run:?}");
    }

    /// The last one reported.
    fn last_iteration(stderr: &str) -> u32 {
        let mut told = stderr.lines().filter_map(|line| line.strip_prefix("job iteration ")?.split_once(':'));
        told.next_back().and_then(|(number, _)| number.parse().ok()).expect("an iteration")
    }

    #[test]
    fn a_batch_is_killed_twice_and_resumed() {
        let folder = folder(&[]);
        fs::create_dir(folder.path("jobs")).expect("a folder");
        let job = JOB.replace("iterations = 12", "iterations = 3").replace("every = 2", "every = 1");
        let job = job.replace("room.toml", "../room.toml").replace("out/", "../out/");
        let broken = ["j02", "j06"];
        let names: Vec<String> = (0..10).map(|k| format!("j{k:02}")).collect();
        for (k, name) in names.iter().enumerate() {
            let text = match broken.contains(&name.as_str()) {
                true => job.replace("\"wall\"", "\"wal\""),
                false => job.replace("initial = 0.5", &format!("initial = 0.{}", 30 + k)),
            };
            fs::write(folder.path("jobs").join(format!("{name}.toml")), text).expect("written");
        }
        assert_eq!(folder.run("fit jobs --output whole").code, Some(1));
        assert_eq!(kill_at(&folder, "fit jobs --output cut", "j01 iteration 2:", "-KILL").code, None);
        let resumed = "fit jobs --output cut --resume";
        // The summary is written while the next jobs run.
        let second = kill_at(&folder, resumed, "j08 iteration 1:", "-KILL");
        assert_eq!(second.code, None);
        says(&second.stderr, &["j00: finished before", "antirad: j02: ", "antirad: j06: "]);
        let summary = String::from_utf8(folder.read("cut/summary.csv")).expect("text");
        says(&summary, &["j00,finished-before", "j01,finished,3", "j02,failed", "j04,finished,3"]);

        let last = folder.run(resumed);
        assert_eq!(last.code, Some(1));
        says(&last.stdout, &["8 of 10 jobs are done"]);
        says(&last.stderr, &["antirad: j02: ", "antirad: j06: ", "did you mean \"wall\"?"]);
        for name in names.iter().filter(|name| !broken.contains(&name.as_str())) {
            // The kills left nothing behind, no half-written file either.
            same_results(&folder.path(&format!("whole/{name}")), &folder.path(&format!("cut/{name}")));
        }
    }

    /// A batch that a signal interrupts reports every job.
    #[test]
    fn a_signal_ends_a_batch() {
        let job = JOB.replace("iterations = 12", "iterations = 3");
        let folder = folder(&[("a.toml", &job), ("b.toml", &job), ("c.toml", &job)]);
        let run = kill_at(&folder, "fit a.toml b.toml c.toml --output cut", "b iteration 1:", "-TERM");
        assert_eq!(run.code, Some(143), "{run:?}");
        let summary = String::from_utf8(folder.read("cut/summary.csv")).expect("text");
        says(&summary, &["a,finished,3", "b,interrupted", "c,not-started"]);
    }

    #[test]
    fn damaged_checkpoints_and_changed_jobs_are_refused() {
        let folder = folder(&[("job.toml", JOB)]);
        kill_at(&folder, "fit job.toml --output fits", "iteration 5:", "-KILL");
        let path = folder.path("fits/job/checkpoint");
        let good = fs::read(&path).expect("a checkpoint");
        fs::write(&path, &good[..good.len() / 2]).expect("written");
        let run = folder.run("fit job.toml --output fits --resume");
        assert_eq!(run.code, Some(1), "{run:?}");
        says(
            &run.stderr,
            &["fits/job/checkpoint: ", "should hold", "remove it to continue from", "checkpoint.previous"],
        );
        assert_eq!(fs::read(&path).expect("a checkpoint").len(), good.len() / 2);
        // The remedy of the message.
        fs::remove_file(&path).expect("removed");
        let changed = JOB.replace("initial = 3", "initial = 4");
        fs::write(folder.path("job.toml"), &changed).expect("written");
        let run = folder.run("fit job.toml --output fits --resume");
        says(&run.stderr, &["checkpoint.previous", "another job", "settings"]);
        fs::write(folder.path("job.toml"), JOB).expect("written");
        folder.run("fit job.toml --output fits --resume").succeeded();
        folder.run("fit job.toml --output whole").succeeded();
        same_results(&folder.path("whole/job"), &folder.path("fits/job"));
    }

    /// A limit on file sizes simulates a full disk without the right to mount one: writes end half-way.
    #[test]
    fn a_failed_write_is_an_error_and_costs_no_checkpoint() {
        let folder = folder(&[("job.toml", JOB)]);
        let mut limited = Command::new("sh");
        // Some KiB: a checkpoint has two, pictures and plots more.
        limited.args(["-c", "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_antirad")]);
        limited.args(["fit", "job.toml", "--output", "full"]).current_dir(folder.path(""));
        let run = run(&mut limited);
        assert_eq!(run.code, Some(75), "{run:?}");
        says(&run.stderr, &["antirad: job: full/job/", "cannot be written: File too large"]);
        let left = names(&folder.path("full/job"));
        assert!(left.contains(&String::from("checkpoint")), "{left:?}");
        assert!(!left.contains(&String::from("report.json")), "{left:?}");
        assert!(left.iter().all(|name| !name.starts_with(".antirad")), "{left:?}");
        // Without the limit it continues from there.
        let resumed = folder.run("fit job.toml --output full --resume").succeeded();
        assert!(!resumed.stderr.contains("iteration 1:"), "{}", resumed.stderr);
        folder.run("fit job.toml --output whole").succeeded();
        same_results(&folder.path("whole/job"), &folder.path("full/job"));
    }

    /// Without --resume or --restart existing progress stays as it is.
    #[test]
    fn progress_is_not_destroyed_in_silence() {
        let folder = folder(&[("job.toml", JOB)]);
        kill_at(&folder, "fit job.toml --output cut", "iteration 5:", "-TERM");
        let kept = folder.read("cut/job/checkpoint");
        let refused = folder.run("fit job.toml --output cut");
        assert_eq!(refused.code, Some(1), "{refused:?}");
        says(&refused.stderr, &["antirad: job: cut/job/checkpoint: ", "--resume", "--restart"]);
        assert!(!refused.stderr.contains("iteration"), "{}", refused.stderr);
        assert!(folder.read("cut/job/checkpoint") == kept);
        assert_eq!(folder.run("fit job.toml --output cut --resume --restart").code, Some(2));
        let anew = folder.run("fit job.toml --output cut --restart").succeeded();
        says(&anew.stderr, &["job iteration 0:", "job iteration 12:"]);
        // A finished fit is protected in the same way.
        says(&folder.run("fit job.toml --output cut").stderr, &["--resume", "--restart"]);
    }

    #[test]
    fn two_processes_do_not_fit_in_one_folder() {
        let long = JOB.replace("iterations = 12", "iterations = 100000") + "kind = \"adam\"\n";
        let folder = folder(&[("job.toml", &long), ("other.toml", &JOB.replace("12", "2"))]);
        let mut first = folder.tool("fit job.toml --output fits".split_whitespace());
        let mut first = first.stderr(Stdio::piped()).spawn().expect("the tool runs");
        let mut stderr = BufReader::new(first.stderr.take().expect("piped"));
        let mut said = String::new();
        while !said.contains("iteration 2:") {
            assert!(stderr.read_line(&mut said).expect("text") > 0, "ended early: {said}");
        }
        let second = folder.run("fit job.toml other.toml --output fits --restart");
        assert!(Command::new("kill").arg(first.id().to_string()).status().expect("kill runs").success());
        stderr.read_to_string(&mut said).expect("text");
        assert_eq!(first.wait().expect("the tool ends").code(), Some(143), "{said}");
        assert_eq!(second.code, Some(75), "{second:?}");
        let holder = format!("antirad: job: fits/job: process {} on ", first.id());
        says(&second.stderr, &[&holder, "at work in this folder", "other iteration 2:"]);
        // The first one is unharmed, and its lock was released at its end.
        let resumed = kill_at(&folder, "fit job.toml --output fits --resume", "iteration ", "-TERM");
        assert!(!resumed.stderr.contains("iteration 1:"), "{}", resumed.stderr);
    }

    /// Files that are named like a job and cannot be read as one.
    #[test]
    fn unreadable_jobs_are_reported() {
        let short = JOB.replace("iterations = 12", "iterations = 2");
        let folder = folder(&[]);
        fs::create_dir_all(folder.path("jobs/folder.toml")).expect("a folder");
        let good = short.replace("room.toml", "../room.toml").replace("out/", "../out/");
        fs::write(folder.path("jobs/a.toml"), good).expect("written");
        fs::write(folder.path("jobs/empty.toml"), "").expect("written");
        std::os::unix::fs::symlink("gone.toml", folder.path("jobs/link.toml")).expect("a link");
        let batch = folder.run("fit jobs --output fits");
        assert_eq!(batch.code, Some(1), "{batch:?}");
        says(&batch.stdout, &["1 of 3 jobs are done"]);
        says(
            &batch.stderr,
            &[
                "antirad: empty: jobs/empty.toml:1: ",
                "missing field `scene`",
                "antirad: link: jobs/link.toml: ",
                "a link to a file that does not exist",
            ],
        );
    }
}
