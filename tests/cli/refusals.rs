//! Bad input and impossible options: one line that says where and what, exit code 2, no results.

use crate::{Folder, MTL, OBJ, ROOM, run, says, without_driver};
use std::fs;
use std::path::Path;

/// One bad file among the good ones, and the parts of the error.
#[track_caller]
fn refused(file: &str, text: &str, parts: &[&str]) {
    let folder = Folder::with(&[(file, text)]);
    let scene = if file == "m.mtl" { "m.obj" } else { file };
    folder.render(scene).refused(parts);
    assert!(folder.results().is_empty(), "{:?}", folder.results());
}

/// The room with one piece replaced.
fn room(old: &str, new: &str) -> String {
    assert!(ROOM.contains(old), "{old}");
    ROOM.replace(old, new)
}

#[test]
fn missing_files() {
    let folder = Folder::with(&[("lost.toml", "[[mesh]]\npath = \"lost.obj\"\n"), ("notes.txt", "")]);
    folder.render("nowhere.toml").refused(&["nowhere.toml", "cannot be read"]);
    folder.render("lost.toml").refused(&["lost.obj", "cannot be read"]);
    folder.render("notes.txt").refused(&["notes.txt", ".toml", ".obj"]);
    fs::remove_file(folder.path("m.mtl")).expect("it was there");
    folder.render("m.obj --strict").refused(&["m.obj:1", "m.mtl", "cannot be read"]);
    assert!(folder.results().is_empty());
}

#[test]
fn broken_meshes() {
    for (line, parts) in [
        ("f 1 2", ["m.obj:10", "2 corner(s)"]),
        ("f 1 2 x", ["m.obj:10", "`x` is not a vertex index"]),
        ("f 1 2 9", ["m.obj:10", "vertex index 9 is out of range"]),
        ("f 1 2 -5", ["m.obj:10", "vertex index -5 is out of range"]),
        ("v 1 2 x", ["m.obj:10", "`x` is not a number"]),
        ("v nan 0 0", ["m.obj:10", "`nan` is not finite"]),
        ("v 0 inf 0", ["m.obj:10", "`inf` is not finite"]),
    ] {
        refused("m.obj", &format!("{OBJ}{line}\n"), &parts);
    }
    refused("m.mtl", &MTL.replace("Kd .5 .5 .5\nKe", "Kd .5 .5\nKe"), &["m.mtl:4", "2 numbers"]);
}

#[test]
fn vertices_that_become_infinite_where_they_stand() {
    let huge = "[[mesh]]\npath = \"m.obj\"\nscale = 1e308\ntranslate = [1e308, 0, 0]\n";
    refused("huge.toml", huge, &["triangle 0 of mesh \"m\"", "vertex 1", "inf", "must be finite"]);
}

#[test]
fn broken_scene_files() {
    refused(
        "room.toml",
        &room("emission =", "emision ="),
        &["room.toml:17", "unknown key `emision`", "did you mean `emission`?"],
    );
    refused("room.toml", &room("[[mesh]]\nshape", "[[mesh]\nshape"), &["room.toml:1"]);
    refused("room.toml", &room("width = 32", "width = -32"), &["room.toml:23"]);
    refused("room.toml", &room("\"quad\"", "\"quat\""), &["room.toml:7", "quat", "did you mean `quad`?"]);
    refused(
        "room.toml",
        &room("material = \"lamp\"", "material = \"lamb\""),
        &["room.toml:8", "\"lamb\"", "lamp"],
    );
    refused("empty.toml", "", &["empty.toml", "no triangles"]);
    refused("points.obj", "v 0 0 0\n", &["points.obj", "no triangles"]);
}

#[test]
fn impossible_materials() {
    let wall = |lines: &str| room("albedo = [0.7, 0.5, 0.3]", lines);
    refused("room.toml", &wall("albedo = [0.7, -0.5, 0.3]"), &["room.toml:13", "\"wall\"", "albedo is -0.5"]);
    refused("room.toml", &wall("albedo = 1"), &["room.toml:13", "\"wall\"", "1.000", "below 1"]);
    refused(
        "room.toml",
        &wall("albedo = 0.5\nspecular = 0.2\npower = 50"),
        &["room.toml:13", "\"wall\"", "total albedo is 1.2", "must be below 1"],
    );
}

/// Mesh files as other programs write them: taken, but for strict readers.
#[test]
fn what_strict_refuses() {
    for (file, text, parts) in [
        ("m.mtl", MTL.replacen(".5 .5 .5", ".5 .5 1.5", 1), ["m.mtl:1", "\"white\"", "below 1"]),
        (
            "m.obj",
            format!("{OBJ}usemtl whit\nf 1 2 4\n"),
            ["m.obj:10", "\"whit\" is not defined in", "m.mtl; did you mean \"white\"?"],
        ),
    ] {
        let folder = Folder::with(&[(file, &text)]);
        folder.render("m.obj --strict").refused(&parts);
        assert!(folder.results().is_empty(), "{:?}", folder.results());
    }
    let bright = MTL.replacen(".5 .5 .5", ".5 .5 1.5", 1);
    let taken = Folder::with(&[("m.mtl", &bright)]).render("m.obj").succeeded();
    says(&taken.stderr, &["WARN", "1 material(s)", "\"white\" (1.50 to 0.90)"]);
}

#[test]
fn triangles_without_area_are_an_error_when_strict() {
    let folder = Folder::with(&[("m.obj", &format!("{OBJ}f 1 1 2\nf 3 3 3\n"))]);
    folder.render("m.obj --strict").refused(&["m.obj", "2 triangle(s) without area", "triangle 2 of mesh"]);
    assert!(folder.results().is_empty());
    let lenient = folder.render("m.obj").succeeded();
    says(&lenient.stderr, &["WARN", "2 triangle(s) have no area", "triangle 2 of mesh"]);
    assert_eq!(folder.json("out/report.json")["plan"]["degenerate"], 2);

    let folder = Folder::with(&[("flat.obj", "v 0 0 0\nf 1 1 1\n")]);
    folder.render("flat.obj --quiet").refused(&["flat.obj", "none of the scene's triangles has an area"]);
    assert!(folder.results().is_empty());
}

/// Fails for root, too: nothing can be created below a regular file.
#[test]
fn results_that_cannot_be_written() {
    let folder = Folder::with(&[]);
    for output in ["room.toml", "room.toml/below"] {
        folder.run(&format!("render room.toml --output {output}")).refused(&[output, "cannot be written"]);
    }
    assert_eq!(folder.read("room.toml"), ROOM.as_bytes());
}

/// The system's message would only say that the file exists.
#[test]
#[cfg(unix)]
fn a_link_for_results_that_leads_nowhere() {
    let folder = Folder::with(&[]);
    std::os::unix::fs::symlink("gone", folder.path("out")).expect("a link");
    folder.render("room.toml").refused(&["out is a link to gone", "does not exist", "remove the link"]);
    folder.run("render room.toml --output out/below").refused(&[
        "out is a link to gone",
        "does not exist",
        "remove the link",
    ]);
}

/// A stray coordinate is named, rather than blamed on what the others turn into.
#[test]
fn coordinates_of_any_size() {
    refused("m.obj", &format!("{OBJ}v 1e30 0 0\nf 1 2 5\n"), &["triangle 2 of mesh", "1e30"]);
    refused("m.obj", &OBJ.replace("v 1 0 0", "v 1e300 0 0"), &["1.000e300", "scale its meshes"]);
    // A scene that is large or small as a whole is only in another unit.
    for unit in ["1e30", "1e-30"] {
        let folder = Folder::with(&[(
            "m.obj",
            &OBJ.replace(" 1 0", &format!(" {unit} 0"))
                .replace("0 1\n", &format!("0 {unit}\n"))
                .replace("v 1 0 0", &format!("v {unit} 0 0")),
        )]);
        folder.render("m.obj").succeeded();
    }
}

#[test]
fn no_device_or_not_that_one() {
    let folder = Folder::with(&[("driver.json", "{}")]);
    for driver_file in [folder.path("driver.json").as_path(), Path::new("/nowhere.json")] {
        let arguments = ["render", "room.toml", "--backend", "vulkan", "--output", "out"];
        run(without_driver(&mut folder.tool(arguments), driver_file))
            .refused(&["no Vulkan d", "mesa-vulkan-drivers"]);
    }
    assert!(folder.results().is_empty());

    let listed = folder.run("devices").succeeded().stdout;
    let name = listed.lines().find_map(|line| line.strip_prefix("0: ")).expect("a device");
    let name = name.split(" (").next().expect("its name");
    folder.render("room.toml --device nonesuch").refused(&["\"nonesuch\"", name]);
    folder.render("room.toml --device 99").refused(&["\"99\"", name]);
    assert!(folder.results().is_empty());
}

/// The budget that the error names suffices.
#[test]
fn a_budget_that_is_too_small() {
    let folder = Folder::with(&[]);
    for (scene_and_bins, residency) in [
        ("room.toml --refine=never --visibility implicit --backend cpu", "device"),
        ("room.toml --refine=never --visibility implicit --backend vulkan", "host"),
        ("room.toml --refine=never --visibility implicit --backend vulkan --bins 4x6", "host"),
    ] {
        let small = folder.render(&format!("{scene_and_bins} --memory-budget 64KiB"));
        small.refused(&["65536 bytes is too small"]);
        assert!(folder.results().is_empty());
        let enough = small.stderr.split("--memory-budget ").nth(1).expect("the option that helps");
        let enough: u64 = enough.split(',').next().and_then(|n| n.parse().ok()).expect("a number of bytes");
        let less = folder.render(&format!("{scene_and_bins} --memory-budget {}", enough - 1));
        less.refused(&[&format!("at least {enough} bytes")]);

        folder.render(&format!("{scene_and_bins} --memory-budget {enough}")).succeeded();
        let memory = &folder.json("out/report.json")["memory"];
        assert_eq!(memory["budget"], enough);
        assert!(memory["peak"].as_u64().expect("bytes") <= enough, "{memory}");
        assert_eq!(folder.json("out/report.json")["plan"]["states"]["residency"], residency);
        fs::remove_dir_all(folder.path("out")).expect("the results were there");
    }
}

#[test]
fn cameras_that_are_not_there_and_samples_that_cannot_be() {
    let folder = Folder::with(&[]);
    folder.render("room.toml --camera main --camera sid").refused(&["no camera \"sid\"", "main, side"]);
    for samples in [0, 3, 32] {
        folder
            .render(&format!("room.toml --supersample {samples}"))
            .refused(&[&format!("supersample = {samples}")]);
    }
    assert!(folder.results().is_empty());
}

/// The argument parser reports these in its own format of a few lines.
#[test]
fn arguments_that_say_nothing() {
    let folder = Folder::with(&[]);
    for (argument, parts) in [
        ("--bins 10", ["--bins", "10x13"]),
        ("--bins concentric:5", ["--bins", "must be even"]),
        ("--bins 1x13", ["--bins", "theta = 1"]),
        ("--target-error 0", ["--target-error", "0.02 is 2 %"]),
        ("--target-error 0.1 --bins 10x13", ["--target-error", "--bins"]),
        ("--tolerance 1", ["--tolerance", "1e-7"]),
        ("--tolerance nan", ["--tolerance", "1e-7"]),
        ("--tolerance small", ["--tolerance", "small"]),
        ("--exposure bright", ["--exposure", "auto"]),
        ("--exposure inf", ["--exposure", "auto"]),
        ("--supersample four", ["--supersample", "four"]),
        ("--max-passes 0", ["--max-passes", "0"]),
        ("--solver magic", ["--solver", "gmres"]),
        ("--backend gpu", ["--backend", "vulkan"]),
        ("--memory-budget 5parsec", ["--memory-budget", "MiB"]),
        ("--memory-budget 100000000000000000000GiB", ["--memory-budget", "more than"]),
        ("--camra main", ["--camra", "--camera"]),
    ] {
        let run = folder.render(&format!("room.toml {argument}"));
        assert_eq!(run.code, Some(2), "{run:?}");
        says(&run.stderr, &parts);
    }
    assert!(folder.results().is_empty());
}
