//! `antirad render` and what it writes.

use crate::{Folder, ROOM, Run, names, run, says, without_driver};
use antirad::image::Picture;
use npyz::NpyFile;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

const PLAIN: [&str; 7] =
    ["irradiance.npy", "main.exr", "main.png", "radiosity.npy", "report.json", "side.exr", "side.png"];

/// Renders under the validation layer, whose messages go to standard error as the warnings do: there must be none.
#[track_caller]
fn clean_render(folder: &Folder, arguments: &str) -> Run {
    let arguments = format!("render {arguments} --output out");
    let mut tool = folder.tool(arguments.split_whitespace());
    let run = run(tool.env("ANTIRAD_VALIDATION", "1")).succeeded();
    // What takes ten seconds, on a slow machine, is told in a line.
    let told: Vec<&str> = run.stderr.lines().filter(|line| !line.contains("% done, ")).collect();
    assert!(told.is_empty(), "warnings, or a progress bar that no terminal asked for: {told:?}");
    run
}

/// Frames of a set are views like the cameras of the scene. Where the set has no size, it is that of the picture.
#[test]
fn views_of_photographs_are_rendered() {
    let frame = |name: &str| {
        format!(
            "{{\"file_path\": \"./{name}\", \"transform_matrix\": [[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1.5], [0, 0, 0, 1]]}}"
        )
    };
    let set = format!("{{\"camera_angle_x\": 1, \"frames\": [{}, {}]}}", frame("left"), frame("right.png"));
    let folder = Folder::with(&[("t.json", &set)]);
    image::RgbImage::new(12, 9).save(folder.path("left.jpg")).expect("a picture");
    let render = |arguments: &str| {
        folder.render(&format!("room.toml --backend cpu --refine=never --cameras {arguments}"))
    };
    render("t.json").refused(&["t.json", "frame \"right\"", "right.png"]);
    render("t.json --camera top").refused(&["t.json has no frame \"top\"", "left, right"]);
    render("none.json").refused(&["none.json", "cannot be read"]);
    render("t.json --camera left").succeeded();
    let shown = picture(&folder, "out/left.exr");
    assert_eq!((shown.width, shown.height), (12, 9));
    assert!(!folder.results().contains(&"main.exr".to_owned()));
}

/// Light is linear: twice the lamp is twice the picture.
#[test]
fn lamps_are_changed_by_name() {
    let folder = Folder::with(&[("half.toml", "lamp = [0.5, 0.5, 0]\n"), ("wrong.toml", "\nlam = 1\n")]);
    let render = |arguments: &str| {
        folder.render(&format!("room.toml --backend cpu --refine=never --camera side {arguments}"))
    };
    render("--lamp lmp=0").refused(&["lamp \"lmp\"", "did you mean \"lamp\"?", "these emit: \"lamp\""]);
    render("--lamp wall=0").refused(&["lamp \"wall\"", "does not emit"]);
    render("--relight wrong.toml").refused(&["wrong.toml:2", "lamp \"lam\""]);
    let usage = |arguments: &str, part: &str| says(&render(arguments).stderr, &[part]);
    usage("--lamp lamp=-1", "0 or more");
    usage("--lamp lamp", "NAME=FACTOR");
    usage("--lamp lamp=1,2", "R,G,B");
    render("").succeeded();
    let plain = picture(&folder, "out/side.exr");
    let run = render("--relight half.toml --lamp lamp=4").succeeded();
    says(&run.stdout, &["relit       lamp x 0.5,0.5,0, lamp x 4"]);
    assert_eq!(folder.json("out/report.json")["lamps"][1]["factor"][0], 4.0);
    let relit = picture(&folder, "out/side.exr");
    for (relit, plain) in relit.pixels.iter().zip(&plain.pixels) {
        assert!((relit[0] - 2.0 * plain[0]).abs() <= 1e-3 * plain[0], "{relit:?} {plain:?}");
        assert_eq!(relit[2], 0.0);
    }
    let run = render("--lamp lamp=0").succeeded();
    says(&run.stderr, &["the picture will be black"]);
    says(&run.stdout, &["nothing emits: the picture is black"]);
}

/// The rows of an array [n, 3].
fn rows(folder: &Folder, name: &str) -> Vec<[f32; 3]> {
    let bytes = folder.read(name);
    let array = NpyFile::new(&bytes[..]).expect("npy");
    assert_eq!(array.shape()[1..], [3]);
    let flat: Vec<f32> = array.into_vec().expect("f32");
    flat.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]]).collect()
}

fn picture(folder: &Folder, name: &str) -> Picture {
    Picture::read_exr(folder.path(name)).expect("an EXR picture")
}

fn png(folder: &Folder, name: &str) -> image::RgbImage {
    image::load_from_memory(&folder.read(name)).expect("a PNG picture").to_rgb8()
}

#[test]
fn a_render_leaves_pictures_arrays_and_a_report() {
    let folder = Folder::with(&[]);
    let run = clean_render(&folder, "room.toml");
    assert_eq!(folder.results(), PLAIN);
    for file in PLAIN {
        says(&run.stdout, &[file]);
    }
    says(&run.stdout, &["200 triangles", "emitted"]);

    for name in ["out/irradiance.npy", "out/radiosity.npy"] {
        let rows = rows(&folder, name);
        assert_eq!(rows.len(), 200);
        assert!(rows.iter().flatten().all(|value| value.is_finite()), "{name}");
    }
    // The lamp's faces are the last ones: their exitance is π times their radiance, and they reflect nothing.
    let lamp = rows(&folder, "out/radiosity.npy")[192..].concat();
    assert!(lamp.iter().all(|b| (b / (10.0 * std::f32::consts::PI) - 1.0).abs() < 1e-5), "{lamp:?}");

    for (camera, width, height) in [("main", 32, 24), ("side", 16, 16)] {
        let picture = picture(&folder, &format!("out/{camera}.exr"));
        assert_eq!((picture.width, picture.height), (width, height));
        // From within a closed room every pixel shows some light, more red than blue.
        assert!(picture.pixels.iter().all(|[r, g, b, _]| r >= g && g >= b && *b > 0.0), "{camera}");
        assert_eq!(png(&folder, &format!("out/{camera}.png")).dimensions(), (width, height));
    }
}

/// Unreliable results are written, and the exit code tells.
#[test]
fn without_convergence_the_best_iterate_is_written() {
    let folder = Folder::with(&[]);
    let run = folder.render("room.toml --refine=never --tolerance 1e-5 --max-passes 5 --quiet");
    assert_eq!(run.code, Some(3), "{run:?}");
    says(&run.stderr, &["no convergence", "after 5 passes", "NOT CONVERGED"]);
    assert_eq!(folder.results(), PLAIN);
    let report = folder.json("out/report.json");
    assert_eq!(report["solve"]["converged"], false);
    assert_eq!(report["solve"]["passes"], 5);
    let reached = rows(&folder, "out/irradiance.npy").concat();

    folder.render("room.toml --refine=never --tolerance 1e-5").succeeded();
    assert_eq!(folder.json("out/report.json")["solve"]["converged"], true);
    let full = rows(&folder, "out/irradiance.npy").concat();
    let norm = |values: &mut dyn Iterator<Item = f32>| values.map(|x| x * x).sum::<f32>().sqrt();
    let error = norm(&mut reached.iter().zip(&full).map(|(a, b)| a - b)) / norm(&mut full.iter().copied());
    assert!(error > 0.0 && error <= 0.2, "{error}");
}

/// A spectral radius of 1 or more: a script must be able to see it.
#[test]
fn an_answer_that_is_not_physical_has_an_exit_code() {
    // Interpenetrating triangles, without the near field that would stabilise them, and all of them lamps, the exact shadows of which
    // would take most of the time.
    let mut state = 1u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    let mut obj = String::new();
    (0..180).for_each(|_| obj += &format!("v {} {} {}\n", random(), random(), random()));
    (0..60).for_each(|k| obj += &format!("f {} {} {}\n", 3 * k + 1, 3 * k + 2, 3 * k + 3));
    let toml = "[settings]\nnear_field = 0\nlamps = \"antiradiance\"\n[[mesh]]\npath = \"soup.obj\"\nmaterial = \"soup\"\n[material.soup]\nalbedo = \
                0.9\nemission = 1\n[camera.main]\nposition = [3, 0.5, 0.5]\ntarget = [0, 0.5, 0.5]\nfov_x_degrees = \
                40\nwidth = 8\nheight = 8\n";
    let folder = Folder::with(&[("soup.obj", &obj), ("soup.toml", toml)]);
    let run = folder.render("soup.toml --max-passes 500 --refine=never --visibility implicit");
    assert_eq!(run.code, Some(3), "{run:?}");
    let report = folder.json("out/report.json");
    let radius = report["solve"]["spectral_radius"].as_f64().expect("an estimate");
    let kinds = report["accuracy_warnings"].as_array().expect("warnings").iter().map(|w| &w["kind"]);
    assert!(radius >= 1.0 && kinds.clone().any(|kind| kind == "unphysical"), "{report}");
    says(&run.stderr, &["unphysical"]);

    // Unless visibility is stated, it is explicit there.
    let run = folder.render("soup.toml --max-passes 500 --refine=never");
    assert_eq!(run.code, Some(0), "{run:?}");
    let report = folder.json("out/report.json");
    assert!(report["plan"]["transport"].to_string().contains("explicit visibility"), "{report}");
    assert!(report["solve"]["spectral_radius"].as_f64().is_none_or(|radius| radius < 1.0), "{report}");
}

/// Lamps beyond the range of f32 give correct results.
#[test]
fn lamps_of_any_brightness() {
    let folder = Folder::with(&[("faint.toml", &ROOM.replace("emission = 10", "emission = 1e-40"))]);
    let bright = ROOM.replace("emission = 10", "emission = 1e37");
    std::fs::write(folder.path("bright.toml"), bright).expect("a scene");
    clean_render(&folder, "room.toml --refine=never");
    let usual = folder.json("out/report.json");
    for (scene, factor) in [("faint.toml", 1e-41), ("bright.toml", 1e36)] {
        clean_render(&folder, &format!("{scene} --refine=never"));
        let report = folder.json("out/report.json");
        assert_eq!(report["solve"]["passes"], usual["solve"]["passes"]);
        let absorbed = |report: &serde_json::Value| report["energy"]["absorbed"][0].as_f64().expect("watts");
        let ratio = absorbed(&report) / absorbed(&usual) / factor;
        assert!((ratio - 1.0).abs() <= 1e-3, "{scene}: {ratio}");
    }
}

/// With a budget of a Vulkan device that cannot hold the states they go to the host, and the result is the same.
#[test]
fn a_render_in_little_memory_finds_the_same() {
    let folder = Folder::with(&[]);
    let render = "room.toml --backend vulkan --refine=never --visibility implicit";
    clean_render(&folder, render);
    let truth = rows(&folder, "out/irradiance.npy");
    assert_eq!(folder.json("out/report.json")["plan"]["states"]["residency"], "device");
    let refused = folder.render(&format!("{render} --memory-budget 1")).stderr;
    let least = refused.split("--memory-budget ").nth(1).and_then(|rest| rest.split(',').next());
    let least: u64 = least.and_then(|n| n.parse().ok()).expect("a number of bytes");
    for budget in [least, least + 500_000] {
        clean_render(&folder, &format!("{render} --memory-budget {budget}"));
        let report = folder.json("out/report.json");
        assert_eq!(report["plan"]["states"]["residency"], "host");
        assert!(report["memory"]["peak"].as_u64().expect("bytes") <= budget);
        let other = rows(&folder, "out/irradiance.npy");
        let square = |f: &dyn Fn(usize, usize) -> f64| -> f64 {
            (0..truth.len()).flat_map(|i| (0..3).map(move |c| f(i, c).powi(2))).sum()
        };
        let size = square(&|i, c| truth[i][c].into());
        let error = square(&|i, c| f64::from(other[i][c]) - f64::from(truth[i][c]));
        assert!((error / size).sqrt() <= 1e-6, "{budget} bytes: {:e}", (error / size).sqrt());
    }
}

/// SwiftShader, as chromium-common of Debian has it, or as ANTIRAD_TEST_SWIFTSHADER says, compiles kernels slowly and has other subgroups.
#[test]
#[ignore = "takes a minute: SwiftShader compiles slowly"]
fn swiftshader_finds_the_same() {
    let given = std::env::var_os("ANTIRAD_TEST_SWIFTSHADER").map(PathBuf::from);
    let library = given.unwrap_or_else(|| "/usr/lib/chromium/libvk_swiftshader.so".into());
    if !library.is_file() {
        // Past the capture of outputs: what is not tested should be seen.
        let _ =
            writeln!(std::io::stderr(), "SKIPPED a render by SwiftShader: there is no {}", library.display());
        return;
    }
    let driver = serde_json::json!({
        "file_format_version": "1.0.0",
        "ICD": { "library_path": library, "api_version": "1.3.0" },
    });
    let folder = Folder::with(&[("driver.json", &driver.to_string())]);
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell_boxes.toml");
    let arguments =
        ["render", scene, "--backend", "vulkan", "--quiet", "--supersample", "1", "--output", "out"];
    run(&mut folder.tool(arguments)).succeeded();
    let lavapipe = (rows(&folder, "out/irradiance.npy"), folder.json("out/report.json"));
    let started = Instant::now();
    run(without_driver(&mut folder.tool(arguments), &folder.path("driver.json"))).succeeded();
    let seconds = started.elapsed().as_secs_f64();
    let device = |report: &serde_json::Value| report["device"]["name"].to_string();
    let report = folder.json("out/report.json");
    assert!(device(&report).contains("SwiftShader") && !device(&lavapipe.1).contains("SwiftShader"));
    let found = rows(&folder, "out/irradiance.npy");
    let square = |f: &dyn Fn(usize, usize) -> f32| -> f64 {
        (0..found.len()).flat_map(|i| (0..3).map(move |c| f64::from(f(i, c)).powi(2))).sum()
    };
    let off = (square(&|i, c| found[i][c] - lavapipe.0[i][c]) / square(&|i, c| lavapipe.0[i][c])).sqrt();
    println!("SwiftShader: {off:.1e} in {seconds:.1} s");
    assert!(off <= 1e-5, "{off}");
    assert!(seconds < 120.0, "{seconds} s");
}

#[test]
fn the_report_tells_everything_of_the_run() {
    for backend in ["cpu", "vulkan"] {
        let folder = Folder::with(&[]);
        clean_render(&folder, &format!("room.toml --refine=never --backend {backend}"));
        tells_everything(&folder.json("out/report.json"), backend);
    }
}

fn tells_everything(report: &serde_json::Value, backend: &str) {
    assert_eq!(report["backend"], backend);
    assert_eq!(report["device"]["vulkan"].is_string(), backend == "vulkan");
    assert!(report["device"]["driver"].as_str().is_some_and(|driver| !driver.is_empty()));
    assert!(report["threads"].as_u64() > Some(0));
    assert_eq!(report["scene"], "room.toml");
    assert_eq!(report["version"], env!("CARGO_PKG_VERSION"));
    assert!(report["device"]["name"].as_str().is_some_and(|name| !name.is_empty()));
    assert_eq!(report["warnings"], serde_json::json!([]));
    assert_eq!(report["plan"]["triangles"], 200);
    assert_eq!(report["plan"]["bins"], "none");
    let resolved = report["resolved"].as_array().expect("decisions");
    let visibility = resolved.iter().find(|of| of["setting"] == "visibility").expect("a decision");
    assert_eq!((&visibility["value"], visibility["why"].is_string()), (&"explicit".into(), true));
    assert_eq!(report["pictures"], serde_json::json!(["main.exr", "main.png", "side.exr", "side.png"]));

    let memory = &report["memory"];
    assert_eq!(memory["budget"], report["plan"]["memory_budget"]);
    let (peak, planned) = (memory["peak"].as_u64(), report["plan"]["memory_total"].as_u64());
    assert!(peak > Some(0) && peak <= planned, "{peak:?} of the planned {planned:?}");

    let solve = &report["solve"];
    let residuals = solve["residuals"].as_array().expect("residuals");
    assert_eq!(solve["passes"].as_u64(), Some(residuals.len() as u64));
    assert_eq!(solve["tolerance"], 1e-4);
    assert!(residuals.last().and_then(|r| r.as_f64()).is_some_and(|r| r <= 1e-4), "{residuals:?}");

    for channel in 0..3 {
        let watt = |what: &str| report["energy"][what][channel].as_f64().expect("watt");
        // 0.16 m² of radiance 10 W/(m² sr).
        assert!((watt("emitted") - 1.6 * std::f64::consts::PI).abs() < 1e-4);
        let gone = ["absorbed", "on_backs", "escaped", "unaccounted"].map(watt).iter().sum::<f64>();
        assert!((watt("emitted") - gone).abs() < 1e-9);
        assert!(watt("escaped").abs() < 0.05 * watt("emitted"), "the room is closed");
    }
    assert!(report["negative_irradiance"]["triangles"].is_u64());
    assert!(report["negative_irradiance"]["minimum"].as_f64().is_some_and(|minimum| minimum <= 0.0));
    for stage in ["load", "plan", "prepare", "solve", "pictures", "write"] {
        assert!(report["seconds"][stage].as_f64().is_some_and(|seconds| seconds >= 0.0), "{stage}");
    }
    let kernels = report["kernels"].as_array().expect("kernels");
    assert!(!kernels.is_empty());
    for kernel in kernels {
        assert!(kernel["kernel"].is_string() && kernel["shape"].is_string(), "{kernel}");
        assert!(kernel["count"].as_u64() > Some(0) && kernel["seconds"].is_f64(), "{kernel}");
    }
}

#[test]
fn twice_the_same_bytes() {
    let (first, second) = (Folder::with(&[]), Folder::with(&[]));
    for folder in [&first, &second] {
        folder.render("room.toml").succeeded();
    }
    for file in PLAIN.iter().filter(|file| **file != "report.json") {
        let name = format!("out/{file}");
        assert!(first.read(&name) == second.read(&name), "{file} differs");
    }
}

#[test]
fn one_camera_and_nothing_said() {
    let folder = Folder::with(&[]);
    let run = clean_render(&folder, "room.toml --camera side --refine=never --quiet");
    assert_eq!(run.stdout, "");
    assert_eq!(folder.results(), ["irradiance.npy", "radiosity.npy", "report.json", "side.exr", "side.png"]);
}

/// Nobody may read what is printed, as after the first line in `antirad plan room.toml | head -1`.
#[test]
fn a_closed_pipe_fails_nothing() {
    let folder = Folder::with(&[]);
    for arguments in
        ["devices", "plan room.toml", "check room.toml", "render room.toml --refine=never --output out"]
    {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let mut tool = folder.tool(arguments.split_whitespace());
        Run::from(tool.stdout(writer).output().expect("the tool runs")).succeeded();
    }
    assert_eq!(folder.results().len(), PLAIN.len());
}

/// The options for pictures change the file they are for and no other.
#[test]
fn options_for_pictures() {
    let folder = Folder::with(&[]);
    let pixels = |arguments: &str| {
        clean_render(&folder, &format!("room.toml --camera main --refine=never {arguments}"));
        (picture(&folder, "out/main.exr"), png(&folder, "out/main.png"))
    };
    let (gathered, auto) = pixels("");
    let (flat, _) = pixels("--shading face");
    assert_ne!(gathered, flat);
    let mean = |picture: &Picture| {
        let sum: f64 = picture.pixels.iter().map(|pixel| f64::from(pixel[0])).sum();
        sum / picture.pixels.len() as f64
    };
    assert!((mean(&gathered) / mean(&flat) - 1.0).abs() < 0.1, "{} {}", mean(&gathered), mean(&flat));

    let (same, stops) = pixels("--exposure 0 --linear-png");
    assert_eq!(gathered, same);
    assert_ne!(auto, stops);
    for (pixel, shown) in same.pixels.iter().zip(stops.pixels()) {
        for (value, shown) in pixel.iter().zip(shown.0) {
            // Either way where it is halfway between two.
            let off = 255.0 * value.min(1.0) - f32::from(shown);
            assert!(off.abs() <= 0.5001, "{pixel:?} is shown as {shown}");
        }
    }
    let (_, darker) = pixels("--exposure -3 --linear-png");
    assert!(darker.pixels().zip(stops.pixels()).all(|(d, s)| (0..3).all(|c| d[c] <= s[c])));
    assert_ne!(darker, stops);
    let (coarse, _) = pixels("--supersample 1");
    assert_ne!(flat, coarse);
}

/// Settings of the command line override those of the scene file.
#[test]
fn options_for_the_solve() {
    let scene = format!("{ROOM}[settings]\nbins = {{ equal_angle = [4, 6] }}\ntolerance = 1e-2\n");
    let folder = Folder::with(&[("room.toml", &scene)]);
    let report = |arguments: &str| {
        clean_render(&folder, &format!("room.toml --visibility implicit {arguments}"));
        folder.json("out/report.json")
    };
    let file = report("");
    assert_eq!((&file["plan"]["bins"], &file["solve"]["tolerance"]), (&"4x6".into(), &0.01.into()));
    let line = report("--bins concentric:6 --tolerance 1e-5 --solver fixed-point");
    assert_eq!(line["plan"]["bins"], "concentric:6");
    assert_eq!(line["plan"]["solver"], "fixed point");
    assert_eq!(line["solve"]["tolerance"], 1e-5);
    assert!(line["solve"]["passes"].as_u64() > file["solve"]["passes"].as_u64());
}

/// A target error, in the scene or on the command line: arrays keep the rows of the scene's own triangles.
#[test]
fn settings_for_a_target_error() {
    // A lamp that hangs lower: the gap above it asks for many triangles.
    let room = ROOM.replace("0.98", "0.9");
    let scene = format!("{room}[settings]\nerror = 0.5\n");
    let folder = Folder::with(&[("room.toml", &scene)]);
    let run = clean_render(&folder, "room.toml");
    says(
        &run.stdout,
        &["step 1", "estimated error", "of picture main", "of picture side", "50.00 % requested: kept"],
    );
    let report = folder.json("out/report.json");
    let (refinement, triangles) = (&report["refinement"], rows(&folder, "out/irradiance.npy").len());
    assert_eq!((&refinement["met"], &refinement["error"]), (&true.into(), &0.5.into()));
    assert_eq!(refinement["steps"][0]["triangles"], triangles);
    let rough = refinement["steps"][0]["estimate"]["total"].as_f64().expect("an estimate");

    clean_render(&folder, "room.toml --target-error 0.005");
    let refinement = &folder.json("out/report.json")["refinement"];
    let last = refinement["steps"].as_array().and_then(|steps| steps.last()).expect("a step").clone();
    println!("{last}");
    assert!(last["triangles"].as_u64() > Some(triangles as u64), "it cuts them");
    assert!(last["estimate"]["total"].as_f64().is_some_and(|fine| fine < rough));
    assert_eq!(rows(&folder, "out/irradiance.npy").len(), triangles);

    // Stated settings override the scene's target error.
    clean_render(&folder, "room.toml --bins 6x8 --visibility implicit");
    let report = folder.json("out/report.json");
    assert!(report["refinement"].is_null());
    assert_eq!(report["plan"]["bins"], "6x8");
}

/// The comparison solve of a level holds no memory when the level itself is solved: in the least
/// budget that suffices, the result is that of a large one.
#[test]
fn a_target_error_in_little_memory() {
    let scene = "[[mesh]]\nshape = { kind = \"quad\", cells = 12 }\nmaterial = \"grey\"\nscale = 4\ntranslate = [-2, 0, -2]\n\
                 [[mesh]]\nshape = { kind = \"statue\", triangles = 2000 }\nmaterial = \"grey\"\n\
                 [[mesh]]\nshape = { kind = \"quad\", cells = 2 }\nmaterial = \"lamp\"\nscale = [1.6, -1, 1.6]\n\
                 translate = [-0.2, 3.5, 1]\n[material.grey]\nalbedo = 0.5\n[material.lamp]\nemission = 10\n\
                 [camera.main]\nposition = [1.2, 1.6, 4.2]\ntarget = [0, 0.9, 0]\nfov_x_degrees = 30\nwidth = 24\nheight = 32\n";
    let folder = Folder::with(&[("statue.toml", scene)]);
    let render = "statue.toml --target-error 0.3 --max-triangles 3000";
    clean_render(&folder, render);
    let plenty = folder.json("out/report.json");
    let irradiance = rows(&folder, "out/irradiance.npy");
    assert_eq!(plenty["refinement"]["steps"].as_array().map(Vec::len), Some(1), "{plenty}");
    let refused = folder.render(&format!("{render} --memory-budget 1")).stderr;
    let least = refused.split("--memory-budget ").nth(1).and_then(|rest| rest.split(',').next());
    let budget: u64 = least.and_then(|n| n.parse().ok()).expect("a number of bytes");
    clean_render(&folder, &format!("{render} --memory-budget {budget}B"));
    let little = folder.json("out/report.json");
    assert!(little["memory"]["peak"].as_u64() <= Some(budget));
    assert_eq!(little["refinement"]["met"], plenty["refinement"]["met"]);
    // The solver may have a shorter basis.
    let other = rows(&folder, "out/irradiance.npy");
    let brightest = irradiance.iter().flatten().fold(0.0_f32, |most, &e| most.max(e));
    let same = irradiance
        .iter()
        .flatten()
        .zip(other.iter().flatten())
        .all(|(a, b)| (a - b).abs() <= 1e-3 * brightest);
    assert!(same && irradiance.len() == other.len());
}

/// A target error that no mesh keeps is told by the exit code, too.
#[test]
fn a_target_error_that_is_not_kept() {
    let folder = Folder::with(&[]);
    let run = folder.render("room.toml --target-error 1e-30 --max-triangles 200");
    assert_eq!(run.code, Some(3), "{run:?}");
    says(&run.stdout, &["NOT KEPT"]);
    assert_eq!(folder.json("out/report.json")["refinement"]["met"], false);
}

/// A bare mesh gets a camera, with a warning; without `--output` the results go to a folder of the scene's name.
#[test]
fn a_bare_mesh() {
    let folder = Folder::with(&[]);
    let run = folder.run("render m.obj").succeeded();
    assert_eq!(run.stderr.lines().count(), 1, "{run:?}");
    says(&run.stderr, &["WARN", "\"auto\""]);
    let expected = ["auto.exr", "auto.png", "irradiance.npy", "radiosity.npy", "report.json"];
    assert_eq!(crate::names(&folder.path("out/m")), expected);
    let quiet = folder.run("render m.obj --quiet").succeeded();
    assert_eq!((quiet.stdout.as_str(), quiet.stderr.as_str()), ("", ""));
}

#[test]
fn no_light_is_a_black_picture_and_a_warning() {
    let folder = Folder::with(&[("room.toml", &ROOM.replace("emission = 10", "emission = 0"))]);
    let run = folder.render("room.toml").succeeded();
    assert_eq!(run.stderr.lines().count(), 1, "{run:?}");
    says(&run.stderr, &["WARN", "no light", "black"]);
    says(&run.stdout, &["nothing emits"]);
    assert_eq!(folder.results(), PLAIN);
    assert!(picture(&folder, "out/main.exr").pixels.iter().all(|pixel| pixel[..3] == [0.0; 3]));
    assert!(png(&folder, "out/main.png").pixels().all(|pixel| pixel.0 == [0; 3]));
    assert!(rows(&folder, "out/irradiance.npy").iter().all(|rgb| *rgb == [0.0; 3]));
}

/// Whatever cameras are called, all that is written stays in the folder, and is told apart.
#[test]
fn names_of_cameras_do_not_leave_the_folder() {
    let camera = |name: &str| {
        format!(
            "[camera.\"{name}\"]\nposition = [1, 0.5, -2]\ntarget = [1, 0.5, 1]\nfov_x_degrees = 60\nwidth = 4\nheight = 4\n"
        )
    };
    let given = ["../../x", "/tmp/antirad_escaped", "a/b", "a_b", "A_b"];
    let cameras: String = given.iter().map(|name| camera(name)).collect();
    let scene = format!(
        "[material.lamp]\nemission = 10\n[[mesh]]\nmaterial = \"lamp\"\nshape = {{ kind = \"box\" }}\n{cameras}"
    );
    let folder = Folder::with(&[("s.toml", &scene)]);
    let before = names(&folder.path(""));
    folder.render("s.toml").succeeded();
    folder.run("trace s.toml --samples 2 --output out").succeeded();
    let files = folder.results();
    for name in ["_.._.._x", "_tmp_antirad_escaped", "a_b", "a_b_2", "A_b_3"] {
        for ending in ["exr", "png", "error.exr"] {
            assert!(files.contains(&format!("{name}.{ending}")), "{name}.{ending}: {files:?}");
        }
    }
    let mut after = names(&folder.path(""));
    after.retain(|name| name != "out");
    assert_eq!(after, before);
    assert!(!PathBuf::from("/tmp/antirad_escaped.exr").exists());
}
