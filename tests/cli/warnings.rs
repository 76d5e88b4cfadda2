//! `antirad check`, `antirad refine`, and the warnings of a render.

use crate::{Folder, run, says, without_driver};
use std::path::Path;

/// A lamp over `count` thin plates over a floor.
fn plates(count: u32) -> String {
    let mut text = String::from(
        "[material.black]\n[material.lamp]\nemission = 10\n[[mesh]]\nname = \"floor\"\nmaterial = \"black\"\nshape = { kind = \
         \"quad\", cells = 4 }\n[[mesh]]\nname = \"lamp\"\nmaterial = \"lamp\"\nshape = { kind = \"quad\" }\nscale = [0.4, -1, \
         0.4]\ntranslate = [0.3, 2, 0.3]\n[camera.main]\nposition = [0.5, 0.1, 0.5]\ntarget = [0.5, 0, 0.6]\nfov_x_degrees = \
         60\nwidth = 8\nheight = 8\n",
    );
    for k in 1..=count {
        let height = 0.2 + 0.1 * f64::from(k);
        text += &format!(
            "[[mesh]]\nname = \"plate {k}\"\nmaterial = \"black\"\nshape = {{ kind = \"slab\", cells = 4 }}\nscale = [1, 0.01, \
             1]\ntranslate = [0, {height}, 0]\n"
        );
    }
    text
}

fn folder() -> Folder {
    Folder::with(&[("plates.toml", &plates(3)), ("one.toml", &plates(1))])
}

#[test]
fn a_check_needs_no_device_and_names_triangles() {
    let folder = folder();
    let nowhere = Path::new("/nowhere.json");
    let checked = run(without_driver(
        &mut folder.tool(["check", "plates.toml", "--all", "--visibility", "implicit"]),
        nowhere,
    ))
    .succeeded();
    assert_eq!(checked.stderr, "");
    let parts = [
        "plates: ",
        "stacked layers\n",
        "\"plate 3\", \"plate 2\", \"plate 1\"",
        "coarse blockers",
        "towards",
        "remedy",
    ];
    says(&checked.stdout, &parts);

    let json = folder.run("check plates.toml --json --visibility implicit").succeeded().stdout;
    let report: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let warnings = report["warnings"].as_array().expect("warnings");
    let kinds: Vec<_> = warnings.iter().map(|w| w["kind"].as_str().expect("a kind")).collect();
    assert_eq!(kinds, ["stacked_layers", "coarse_blockers", "narrow_gaps"]);
    for warning in warnings {
        assert!(
            warning["count"].as_u64() > Some(0) && warning["area_share"].as_f64() > Some(0.0),
            "{warning}"
        );
        let worst = &warning["worst"][0];
        assert!(worst["value"].as_f64() > Some(0.0) && worst["triangle"].is_u64(), "{worst}");
        says(worst["place"].as_str().expect("a place"), &["triangle ", "of mesh \""]);
    }
    says(
        &folder.run("check room.toml --all --visibility implicit").succeeded().stdout,
        &["200 triangles", "open blockers", "\"lamp\""],
    );
    folder.run("check nowhere.toml").refused(&["nowhere.toml", "cannot be read"]);
    // With fewer bins the mesh is fine enough.
    let coarse = folder.run("check one.toml --bins 2x3 --all --visibility implicit").succeeded().stdout;
    assert!(coarse.contains("nothing to warn of"), "{coarse}");
}

#[test]
fn a_refined_scene_is_warned_of_less_and_renders() {
    let folder = folder();
    let count = |file: &str| -> (u64, u64) {
        let json = folder.run(&format!("check {file} --json")).succeeded().stdout;
        let report: serde_json::Value = serde_json::from_str(&json).expect("JSON");
        let counts = report["warnings"]
            .as_array()
            .expect("warnings")
            .iter()
            .map(|w| w["count"].as_u64().expect("a count"));
        (report["triangles"].as_u64().expect("a count"), counts.sum())
    };
    let refined = folder.run("refine one.toml --output fine --bins 6x8 --visibility implicit").succeeded();
    says(
        &refined.stdout,
        &["of mesh \"plate 1\" were cut", "warnings    before: ", "coarse blockers", "after: ", "one.toml"],
    );
    let (before, after) = (count("one.toml --bins 6x8 --visibility implicit"), count("fine/one.toml"));
    assert!(after.0 > before.0 && after.1 < before.1, "{before:?} {after:?}");
    folder.render("fine/one.toml").succeeded();
    // The settings of the command line are those of the finer scene.
    assert_eq!(folder.json("out/report.json")["plan"]["bins"], "6x8");

    folder
        .run("refine one.toml --output fine --max-triangles 10 --visibility implicit")
        .refused(&["triangles already", "--max-triangles"]);
    let bounded = folder
        .run("refine plates.toml --output fine --max-triangles 1000 --visibility implicit")
        .succeeded()
        .stdout;
    says(&bounded, &["more would be cut, but for --max-triangles 1000"]);
    assert!(count("fine/plates.toml").0 <= 1000);
}

#[test]
fn a_render_warns_of_what_makes_it_useless() {
    let folder = folder();
    let rendered = folder
        .render("plates.toml --max-passes 2000 --lamps antiradiance --visibility implicit --refine=never")
        .succeeded();
    says(&rendered.stderr, &["WARN stacked layers: ", "\"plate 2\"", "remedy: "]);
    says(&rendered.stdout, &["warnings    stacked layers ("]);
    let report = folder.json("out/report.json");
    assert_eq!(report["accuracy_warnings"][0]["kind"], "stacked_layers");
    let kinds = report["accuracy_warnings"].as_array().expect("warnings").iter().map(|w| &w["kind"]);
    assert!(kinds.clone().any(|kind| kind == "negative_irradiance"), "{report}");
}

/// A sheet that faces away from the lamp above it: half of its surroundings' light falls on its back.
#[test]
fn a_sheet_with_a_lit_back_is_warned_of_until_it_has_two_sides() {
    let sheet = "[material.grey]\nalbedo = 0.5\n[material.lamp]\nemission = 10\n[[mesh]]\nname = \"floor\"\nmaterial = \"grey\"\n\
                 shape = { kind = \"quad\", cells = 4 }\nscale = 2\n[[mesh]]\nname = \"sheet\"\nmaterial = \"grey\"\nshape = { kind = \
                 \"quad\" }\nscale = [1, -1, 1]\ntranslate = [0.5, 1, 0.5]\n[[mesh]]\nname = \"lamp\"\nmaterial = \"lamp\"\nshape = { \
                 kind = \"quad\" }\nscale = [0.4, -1, 0.4]\ntranslate = [0.8, 2, 0.8]\n[camera.main]\nposition = [1, 1.5, \
                 -2]\ntarget = [1, 0.5, 1]\nfov_x_degrees = 60\nwidth = 8\nheight = 8\n";
    let folder = Folder::with(&[("sheet.toml", sheet)]);
    let lit = |folder: &Folder| {
        let report = folder.json("out/report.json");
        let warnings = report["accuracy_warnings"].as_array().expect("warnings").clone();
        warnings.into_iter().find(|warning| warning["kind"] == "lit_backs")
    };
    let rendered = folder.render("sheet.toml --refine=never").succeeded();
    says(&rendered.stderr, &["WARN lit backs: ", "backs of 2 triangles", "--two-sided"]);
    let warning = lit(&folder).expect("a warning");
    assert!(warning["effect"]["share"].as_f64() > Some(0.01) && warning["count"] == 2, "{warning}");
    says(warning["worst"][0]["place"].as_str().expect("a place"), &["of mesh \"sheet\""]);
    // One of 4 + 1 m²; the lamp only emits.
    let share = warning["area_share"].as_f64().expect("a share");
    assert!((share - 1.0 / 5.0).abs() < 1e-6, "{share}");
    says(&folder.run("check sheet.toml").succeeded().stdout, &["lit backs\n", "two_sided = true"]);

    let two = folder.render("sheet.toml --two-sided").succeeded();
    assert!(!two.stderr.contains("lit backs"), "{two:?}");
    assert!(lit(&folder).is_none());
    // The other remedy: the sheet faces the lamp. What comes back from the floor to its back is too little to count.
    let turned =
        sheet.replace("scale = [1, -1, 1]", "scale = [1, 1, 1]").replace("albedo = 0.5", "albedo = 0.02");
    std::fs::write(folder.path("sheet.toml"), turned).expect("written");
    assert!(!folder.render("sheet.toml --refine=never").succeeded().stderr.contains("lit backs"));
    assert!(lit(&folder).is_none());
}

/// 36 triangles: the files keep them, and the answer is that of more.
#[test]
fn a_render_refines_a_mesh_too_coarse_for_shadows() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/coarse_cornell.toml");
    let folder = Folder::with(&[]);
    let scene = scene.display();
    says(&folder.run(&format!("check {scene}")).succeeded().stdout, &["coarse shadows", "antirad refine"]);
    let plain = folder.render(&format!("{scene} --refine=never")).succeeded();
    says(&plain.stdout, &["solved      36 triangles"]);
    let shown = |arguments: &str| -> (Vec<f32>, u64) {
        let run = folder.render(&format!("{scene} {arguments}")).succeeded();
        let report = folder.json("out/report.json");
        let triangles = report["plan"]["triangles"].as_u64().expect("a number");
        assert!((200..=600).contains(&triangles), "{run:?}");
        assert_eq!(report["given_triangles"], 36);
        says(&run.stdout, &["cut from 36 triangles", "--refine=never"]);
        let irradiance = folder.read("out/irradiance.npy");
        let irradiance = npyz::NpyFile::new(&irradiance[..]).expect("an array");
        assert_eq!(irradiance.shape(), [36, 3]);
        (irradiance.into_vec().expect("numbers"), triangles)
    };
    // It does so by itself, since the mesh is far too coarse.
    let (_, more) = shown("--max-triangles 600");
    let fewer = shown("--max-triangles 300");
    assert!(fewer.1 <= 300 && more > 300, "{} and {more}", fewer.1);
    assert_eq!(fewer, shown("--max-triangles 300 --refine auto"));
    let both = folder.render(&format!("{scene} --refine=auto --target-error 0.1"));
    assert_eq!(both.code, Some(2));
    says(&both.stderr, &["--refine", "--target-error"]);
}

/// Work on the host stops as soon as work on a device.
#[test]
#[cfg(unix)]
fn an_interrupted_refinement_ends_soon_and_writes_nothing() {
    use crate::process::{until_caught, until_worked, work_after};
    use std::process::Stdio;
    use std::time::Duration;
    let fine = plates(8).replace("kind = \"slab\", cells = 4", "kind = \"slab\", cells = 40");
    let folder = Folder::with(&[("plates.toml", &fine)]);
    let mut tool = folder.tool(["refine", "plates.toml", "--output", "out"]);
    let mut child = tool.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool runs");
    until_caught(&mut child);
    until_worked(&mut child, Duration::from_millis(500));
    let worked = work_after(&mut child, "-INT");
    let run = crate::Run::from(child.wait_with_output().expect("the tool ends"));
    assert_eq!(run.code, Some(130), "{run:?}");
    assert!(run.stderr.ends_with("antirad: interrupted; nothing was written\n"), "{run:?}");
    assert!(worked.is_none_or(|worked| worked < Duration::from_secs(2)), "{worked:?}");
    assert!(folder.results().is_empty());
}
