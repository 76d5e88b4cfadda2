//! `bench_accuracy --pictures` and `bench_gradients --traced`: a scene and a gradient beside the path-traced truth.

#[path = "../../../tests/support/tool.rs"]
mod tool;

use antirad::path_tracer::PathTracer;
use antirad::scene::{LoadOptions, Scene};
use std::fs;
use std::process::Command;
use tool::{Folder, ROOM, Run, run, says};

fn against_truth(folder: &Folder, arguments: &str) -> Run {
    let mut tool = Command::new(env!("CARGO_BIN_EXE_bench_accuracy"));
    tool.current_dir(folder.path("")).args(["--output", "out", "--pictures"]);
    run(tool.args(arguments.split_whitespace()))
}

/// The percentages of a row of the table.
fn shares(row: &str) -> Vec<f64> {
    let cells = row.split('|').filter_map(|cell| cell.trim().strip_suffix(" %"));
    cells.map(|cell| cell.parse().expect("a number")).collect()
}

#[test]
fn a_sheet_for_each_camera_and_a_row_for_each_variation() {
    let folder = Folder::with(&[]);
    let run = against_truth(&folder, "room.toml --paths 2048 --bins 6x8").succeeded();
    assert_eq!(folder.results(), ["room_main_against_truth.png", "room_side_against_truth.png"]);
    let rows: Vec<&str> = run.stdout.lines().collect();
    assert_eq!(rows.len(), 5, "{rows:?}");
    for (row, begin) in
        rows[2..].iter().zip(["10x13 | by antiradiance", "6x8 | by antiradiance", "10x13 | exact"])
    {
        assert!(row.starts_with(&format!("| `room` | 200 | {begin} |")), "{row}");
        let shares = shares(row);
        let (error, largest, noise) = (shares[0], shares[1], shares[shares.len() - 1]);
        assert!((0.1..=15.0).contains(&error) && largest >= error, "{row}");
        assert!(noise <= error && noise > 0.0, "{row}");
    }
    assert!(shares(rows[4])[0] < shares(rows[2])[0], "exact lamps: {rows:?}");

    let picture = image::open(folder.path("out/room_side_against_truth.png")).expect("a picture").to_rgb8();
    let (width, height) = picture.dimensions();
    let mean = |left: u32, channel: usize| {
        let pixels = (0..256).flat_map(|x| (22..22 + 256).map(move |y| (left + x, y)));
        pixels.map(|(x, y)| f64::from(picture.get_pixel(x, y).0[channel])).sum::<f64>() / 65536.0
    };
    assert!(width > 3 * 256 && height > 2 * 256, "{width} x {height}");
    let (found, truth) = (mean(0, 0), mean(256 + 6, 0));
    assert!(truth >= 30.0 && (found / truth - 1.0).abs() <= 0.1, "{found}, {truth}");
    assert!(mean(2 * (256 + 6), 0) + mean(2 * (256 + 6), 2) > 5.0, "the difference");
}

#[test]
fn what_has_no_such_picture_is_refused() {
    let glossy = ROOM.replace("albedo = [0.7, 0.5, 0.3]", "albedo = 0.2\nspecular = 0.05\npower = 20");
    let folder = Folder::with(&[("glossy.toml", &glossy)]);
    against_truth(&folder, "glossy.toml").refused(&["glossy.toml", "glossy materials"]);
    against_truth(&folder, "room.toml --camera back").refused(&["room.toml", "main, side"]);
    against_truth(&folder, "nowhere.toml").refused(&["nowhere.toml", "cannot be read"]);
    assert!(folder.results().is_empty());
}

const ALBEDO: &str = "scene = \"room.toml\"\n
[[target]]\npicture = \"truth/side.exr\"\ncamera = \"side\"\n
[[fit]]\nparameter = \"albedo\"\nmaterials = [\"wall\"]\ninitial = 0.45\n";

/// Writes `truth/side.exr`, the path-traced picture of a camera.
fn trace_the_side(folder: &Folder, samples: u32) {
    let scene = Scene::load(&folder.path("room.toml"), &LoadOptions::default()).expect("a scene");
    let camera = scene.cameras.iter().find(|camera| camera.name == "side").expect("a camera");
    fs::create_dir(folder.path("truth")).expect("a folder");
    let picture = PathTracer::new(&scene).picture(camera, samples, 0).picture();
    picture.write_exr(folder.path("truth/side.exr")).expect("written");
}

fn gradient(folder: &Folder, arguments: &str) -> Run {
    let mut tool = Command::new(env!("CARGO_BIN_EXE_bench_gradients"));
    tool.current_dir(folder.path("")).arg("--traced");
    run(tool.args(arguments.split_whitespace()))
}

#[test]
fn the_gradient_of_a_fit_beside_that_of_path_traced_pictures() {
    let folder = Folder::with(&[("job.toml", ALBEDO)]);
    trace_the_side(&folder, 64);
    let run = gradient(&folder, "job.toml --samples 256 --repetitions 4 --quiet").succeeded();
    let rows: Vec<&str> = run.stdout.lines().filter(|line| line.starts_with("albedo of wall")).collect();
    assert_eq!(rows.len(), 3, "{run:?}");
    for (row, colour) in rows.iter().zip(["red", "green", "blue"]) {
        says(row, &[colour, "±"]);
        // Standard error, and how far antirad's derivatives are off: of the pictures, of the loss.
        let words: Vec<&str> = row.split_whitespace().collect();
        let before = words.iter().zip(&words[1..]).filter(|(_, unit)| **unit == "%");
        let shares: Vec<f64> = before.map(|(share, _)| share.parse().expect("a number")).collect();
        assert!(shares[0] > 0.0 && shares[0] <= 5.0, "{row}");
        assert!(shares[1].abs() <= 10.0, "{row}");
        assert_eq!(shares.len(), 3, "{row}");
    }
}

#[test]
fn fits_without_such_a_gradient_are_refused() {
    let folder =
        Folder::with(&[("job.toml", ALBEDO), ("l1.toml", &format!("{ALBEDO}[loss]\nkind = \"l1\"\n"))]);
    gradient(&folder, "job.toml").refused(&["truth/side.exr", "cannot be read"]);
    trace_the_side(&folder, 2);
    gradient(&folder, "l1.toml").refused(&["l1.toml", "l2 or relative-l2"]);
}
