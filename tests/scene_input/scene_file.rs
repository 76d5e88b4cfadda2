//! TOML scene files.

use antirad::backend::BackendChoice;
use antirad::scene::{BinLayout, SolveSettings, SolverChoice};

use super::{Folder, OBJ, TOML, assert_refused, assert_says, good, with_mesh};

#[test]
fn missing_and_unknown_files() {
    let folder = Folder::with(&[]);
    for (name, parts) in [
        ("none.toml", ["none.toml", "cannot be read"]),
        ("none.obj", ["none.obj", "cannot be read"]),
        ("m.mtl", ["m.mtl", ".toml"]),
    ] {
        let error = folder.load(name, false).expect_err(name);
        assert_says(&error.to_string(), &parts);
    }
    assert_refused("s.toml", "[[mesh]]\npath = \"none.obj\"", &["s.toml:2", "none.obj", "cannot be read"]);
    let lost =
        Folder::with(&[("m.obj", "v 0 0 0\nmtllib none.mtl")]).load("m.obj", true).expect_err("strict");
    assert_says(&lost.to_string(), &["m.obj:2", "none.mtl", "cannot be read"]);
}

#[test]
fn broken_toml() {
    let mesh = "[[mesh]]\nshape = { kind = \"quad\" }\nmaterial = \"a\"\n";
    for (text, parts) in [
        ("mesh = 3", vec!["s.toml:1"]),
        ("[[mesh]\n", vec!["s.toml:1"]),
        ("[[meshes]]", vec!["s.toml:1", "unknown key `meshes`", "did you mean `mesh`?"]),
        ("[[mesh]]\nsubdivid = 1", vec!["s.toml:2", "unknown key `subdivid`", "did you mean `subdivide`?"]),
        ("\n[material.a]\nalbdo = 1", vec!["s.toml:3", "unknown key `albdo`", "did you mean `albedo`?"]),
        ("[material.a]\nalbedo = [1, 1]", vec!["s.toml:2", "three"]),
        ("[material.a]\nalbedo = \"red\"", vec!["s.toml:2", "a number or three"]),
        ("[material.a]\nalbedo = nan", vec!["s.toml:2", "not finite"]),
        ("[material.a]\nnormalization = \"energie\"", vec!["s.toml:2", "did you mean `energy`?"]),
        ("[[mesh]]", vec!["s.toml:1", "without geometry", "path"]),
        ("[[mesh]]\npath = \"m.obj\"\nshape = { kind = \"quad\" }", vec!["s.toml:1", "not both"]),
        ("[[mesh]]\nshape = { kind = \"quad\" }", vec!["s.toml:1", "needs a material"]),
        ("[[mesh]]\nmaterial = \"a\"\nshape = { kind = \"qad\" }", vec!["s.toml:3", "did you mean `quad`?"]),
        (
            "[[mesh]]\nmaterial = \"a\"\nshape = { kind = \"quad\", cels = 2 }",
            vec!["s.toml:3", "did you mean `cells`?"],
        ),
        (
            "[[mesh]]\nmaterial = \"a\"\nshape = { kind = \"quad\", cells = 0 }",
            vec!["s.toml:3", "cells = 0", "1 to 1000"],
        ),
        (mesh, vec!["s.toml:3", "material \"a\" is not defined", "[material.a]"]),
        ("[[mesh]]\npath = \"m.obj\"\nscale = 0", vec!["s.toml:3", "scale of 0"]),
        ("[[mesh]]\npath = \"m.obj\"\nscale = [1, 0, 1]", vec!["s.toml:3", "scale of 0"]),
        ("[[mesh]]\npath = \"m.obj\"\ntranslate = [1, inf, 1]", vec!["s.toml:3", "not finite"]),
        ("[[mesh]]\npath = \"m.obj\"\ntranslate = 1", vec!["s.toml:3", "three numbers"]),
        (
            "[[mesh]]\npath = \"m.obj\"\nsubdivide = 40",
            vec!["s.toml:3", "subdivide = 40", "more than 10^19", "at most 10000000"],
        ),
        (
            "[[mesh]]\npath = \"m.obj\"\nsubdivide = 12",
            vec!["s.toml:3", "turns 2 triangles into 33554432,", "use 11 or less"],
        ),
        ("[[mesh]]\npath = \"m.obj\"\nsubdivide = -1", vec!["s.toml:3"]),
    ] {
        assert_refused("s.toml", text, &parts);
    }
}

#[test]
fn broken_accuracy() {
    for (line, parts) in [
        ("bins = { equal_angle = [1, 13] }", vec!["s.toml:9", "theta = 1", "2 to 64"]),
        ("bins = { equal_angle = [10, 65] }", vec!["s.toml:9", "phi = 65", "3 to 64"]),
        ("bins = { concentric = 7 }", vec!["s.toml:9", "n = 7 is odd"]),
        ("bins = { concentrc = 8 }", vec!["s.toml:10", "did you mean `concentric`?"]),
        ("solver = \"gmre\"", vec!["s.toml:10", "did you mean `gmres`?"]),
        ("backend = \"gpu\"", vec!["s.toml:10", "\"gpu\" is no backend", "auto, vulkan or cpu"]),
        ("near_field = -1", vec!["s.toml:9", "near_field = -1"]),
        ("tolerance = 0", vec!["s.toml:9", "tolerance = 0", "between 0 and 1"]),
        ("error = 0", vec!["s.toml:9", "error = 0", "0.02 is 2 %"]),
        ("ray_error = 0", vec!["s.toml:9", "ray_error = 0", "0.005 is .5 %"]),
        ("ray_error = 0.6", vec!["s.toml:9", "ray_error = 0.6", "0.00001 to 0.5"]),
        ("transport = \"exact\"", vec!["s.toml:10", "unknown key `transport`", "did you mean `ray_error`?"]),
        ("error = 2", vec!["s.toml:9", "between 0 and 1"]),
        (
            "error = 0.1\ntolerance = 1e-3",
            vec!["s.toml:9", "`error` and `tolerance`", "remove one of the two"],
        ),
        ("max_passes = 0", vec!["s.toml:9", "max_passes"]),
        ("max_pases = 3", vec!["s.toml:10", "did you mean `max_passes`?"]),
    ] {
        assert_refused("s.toml", &with_mesh(&format!("[settings]\n{line}\n")), &parts);
    }
    for (name, backend) in
        BackendChoice::NAMES.iter().zip([BackendChoice::Auto, BackendChoice::Vulkan, BackendChoice::Cpu])
    {
        let text = with_mesh(&format!("[settings]\nbackend = \"{name}\"\n"));
        assert_eq!(good("s.toml", &[("s.toml", &text)]).settings.backend, backend);
    }
    let text = "[settings]\nbins = { concentric = 12 }\nsolver = \"fixed-point\"\n";
    let settings = good("s.toml", &[("s.toml", &with_mesh(text))]).settings;
    assert_eq!((settings.bins, settings.solver), (BinLayout::Concentric { n: 12 }, SolverChoice::FixedPoint));
}

/// A target error, and none where none is given.
#[test]
fn target_errors() {
    for (lines, error) in
        [("", None), ("tolerance = 1e-3", None), ("error = 0.02\nmax_passes = 30", Some(0.02))]
    {
        let scene = good("s.toml", &[("s.toml", &with_mesh(&format!("[settings]\n{lines}\n")))]);
        assert_eq!(scene.target_error, error, "{lines}");
    }
}

#[test]
fn broken_cameras() {
    for (change, to, parts) in [
        ("position = [0, 0, 5]", "position = [0, 0, 0]", vec!["s.toml:3", "\"main\"", "position and target"]),
        ("position = [0, 0, 5]", "up = [0, 0, 1]\nposition = [0, 0, 5]", vec!["s.toml:3", "parallel"]),
        ("position = [0, 0, 5]", "up = [0, 0, 0]\nposition = [0, 0, 5]", vec!["s.toml:3", "no length"]),
        ("position = [0, 0, 5]", "position = [nan, 0, 5]", vec!["s.toml:4", "not finite"]),
        ("position = [0, 0, 5]\n", "", vec!["s.toml:3", "missing field `position`"]),
        ("fov_x_degrees = 40", "fov_x_degrees = 180", vec!["s.toml:3", "fov_x_degrees is 180"]),
        ("fov_x_degrees = 40", "fov_x_degrees = nan", vec!["s.toml:3", "fov_x_degrees is NaN"]),
        ("fov_x_degrees = 40", "fov_y_degrees = 0", vec!["s.toml:3", "fov_y_degrees is 0"]),
        ("fov_x_degrees = 40", "fov_x_degrees = 40\nfov_y_degrees = 40", vec!["s.toml:3", "exactly one"]),
        ("fov_x_degrees = 40", "", vec!["s.toml:3", "exactly one"]),
        ("width = 64", "width = 0", vec!["s.toml:3", "width is 0"]),
        ("height = 48", "height = 16385", vec!["s.toml:3", "height is 16385"]),
        ("width = 64", "widht = 64", vec!["s.toml:7", "did you mean `width`?"]),
    ] {
        assert_refused("s.toml", &TOML.replace(change, to), &parts);
    }
    let high = TOML.replace("fov_x_degrees = 40", "fov_y_degrees = 90").replace("width = 64", "width = 48");
    let camera = &good("s.toml", &[("s.toml", &high)]).cameras[0];
    assert!((camera.fov_x_degrees - 90.0).abs() < 1e-12);
}

#[test]
fn cameras_keep_the_order_of_the_file() {
    let more =
        ["zoo", "ape"].map(|name| TOML.replace("main", name).replace("[[mesh]]\npath = \"m.obj\"\n", ""));
    let scene = good("s.toml", &[("s.toml", &with_mesh(&more.concat()))]);
    let names: Vec<_> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["main", "zoo", "ape"]);
    assert!(scene.camera("ape").is_some() && scene.camera("none").is_none());
}

#[test]
fn meshes_are_placed_subdivided_and_named_apart() {
    let text = with_mesh(
        "[[mesh]]\npath = \"m.obj\"\nmaterial = \"white\"\nscale = [-2, 2, 2]\ntranslate = [0, 0, 1]\nsubdivide = 2\n",
    );
    let scene = good("s.toml", &[("s.toml", &text)]);
    let meshes: Vec<_> = scene.meshes.iter().map(|m| (m.name.as_str(), m.range.clone())).collect();
    assert_eq!(meshes, [("m", 0..2), ("m_2", 2..34)]);
    // The parts of a face are consecutive, and a mirrored face keeps its front.
    let [a, b, c] = scene.corners(0);
    let front = (b - a).cross(c - a);
    for triangle in 2..18 {
        let [a, b, c] = scene.corners(triangle);
        let child = (b - a).cross(c - a);
        assert!(child.abs_diff_eq(front * 4.0 / 16.0, 1e-12), "{triangle}: {child}");
        assert_eq!(scene.material(triangle).name, "white");
    }
}

/// The scene file in the documentation of `Scene::load`.
#[test]
fn the_documented_keys_are_the_keys() {
    let source = include_str!("../../crates/scene/src/file.rs");
    let documented: String = source
        .split("/// ```")
        .nth(1)
        .into_iter()
        .flat_map(|block| block.lines().skip(1))
        .map(|line| format!("{}\n", line.trim().trim_start_matches("///")))
        .collect();
    let room = OBJ.replace("usemtl lamp", "usemtl white");
    let scene = good("s.toml", &[("s.toml", &documented), ("room.obj", &room)]);
    // Of the room and of the sky.
    assert_eq!((scene.triangles.len(), scene.cameras.len()), (8 + 12, 1));
    assert_eq!(scene.settings, SolveSettings::default());
}
