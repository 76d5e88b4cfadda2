//! Job files: their contents, and the errors for invalid ones.

use crate::{SCENE, says};
use antirad::backend::BackendChoice;
use antirad::fit::{JobFile, LossKind, Noise, OptimiserKind};
use antirad::image::{Exposure, Picture, ToneMap};
use antirad_scene::{linear_from_srgb, srgb_from_linear};
use std::fs;
use tempfile::TempDir;

const JOB: &str = r#"scene = "s.toml"

[[target]]
picture = "p.exr"
camera = "main"
weight = 2

[[fit]]
parameter = "albedo"
materials = ["wall", "red"]
initial = 0.5
upper = [0.9, 0.9, 0.95]

[[fit]]
parameter = "position"
meshes = ["box"]
motion = "rigid"
lower = [-0.5, 0, -0.5]
upper = [0.5, 0, 0.5]

[loss]
kind = "relative-l2"
epsilon = 0.02

[[regulariser]]
kind = "prior"
of = "albedo"
value = 0.5
weight = 1e-3

[optimiser]
kind = "quasi-newton"
memory = 7

[stop]
iterations = 40

[checkpoint]
every = 3

[solve]
tolerance = 1e-6
supersample = 2
backend = "vulkan"
"#;

fn picture(width: u32, height: u32) -> Picture {
    Picture { width, height, pixels: vec![[0.3, 0.2, 0.1, 1.0]; (width * height) as usize] }
}

/// A folder with a valid job `j.toml` and other files.
fn folder(files: &[(&str, &str)]) -> TempDir {
    let folder = TempDir::new().expect("a folder");
    picture(16, 12).write_exr(folder.path().join("p.exr")).expect("written");
    for (name, text) in [("j.toml", JOB), ("s.toml", SCENE)].iter().chain(files) {
        fs::write(folder.path().join(name), text).expect("written");
    }
    folder
}

fn load(folder: &TempDir) -> Result<JobFile, String> {
    JobFile::load(&folder.path().join("j.toml")).map_err(|error| error.to_string())
}

/// The valid job with one part replaced.
fn job(old: &str, new: &str) -> String {
    assert!(JOB.contains(old), "{old}");
    JOB.replacen(old, new, 1)
}

#[track_caller]
fn refused(text: &str, parts: &[&str]) {
    let message = load(&folder(&[("j.toml", text)])).err().expect(text);
    assert!(!message.contains('\n'), "{message}");
    says(&message, parts);
}

#[test]
fn a_job_says_everything() {
    let folder = folder(&[]);
    let file = load(&folder).expect("a job");
    assert_eq!((file.job.name.as_str(), file.stop.iterations, file.checkpoint_every), ("j", 40, 3));
    let settings = file.job.settings();
    assert_eq!((settings.loss, settings.epsilon), (LossKind::RelativeL2, Some(0.02)));
    assert_eq!((settings.optimiser, settings.quasi_newton.memory), (OptimiserKind::QuasiNewton, 7));
    assert_eq!((settings.tolerance, settings.supersample), (Some(1e-6), 2));
    assert_eq!(file.job.problem().parameters.base().settings.backend, BackendChoice::Vulkan);
    assert_eq!(file.job.problem().parameters.len(), 6 + 6);
    assert_eq!(file.job.problem().targets[0].weight, 2.0);
    assert_eq!(file.warnings, [""; 0]);
}

/// The example in the documentation of `JobFile::load` has every key and is a valid job.
#[test]
fn the_documented_keys_are_the_keys() {
    let source = include_str!("../../crates/fit/src/job_file.rs");
    let (_, rest) = source.split_once("/// ```toml\n").expect("an example");
    let (example, _) = rest.split_once("/// ```\n").expect("its end");
    let text: String = example
        .lines()
        .map(|line| line.trim().trim_start_matches("///").trim_start().to_owned() + "\n")
        .collect();
    let text = text.replace("room.toml", "s.toml").replace("photo.exr", "p.exr").replace("green", "gloss");
    let text = text.replace("\"walls\"", "\"room\", \"box\", \"table\"").replace("mask = \"mask.png\"", "");
    // Of integers alone, of files of several layers, and of other losses.
    let text = text.replace("response = ", "# ").replace("layer = ", "# ").replace("noise = ", "# ");
    let frame =
        "{\"file_path\": \"r_0.jpg\", \"transform_matrix\": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}";
    let set = format!("{{\"camera_angle_x\": 1, \"frames\": [{frame}]}}");
    let folder = folder(&[("j.toml", &text), ("transforms.json", &set)]);
    for inner in ["photos", "masks", "seg"] {
        fs::create_dir(folder.path().join(inner)).expect("a folder");
    }
    picture(16, 12).write_exr(folder.path().join("photos/r_0.exr")).expect("written");
    let mask = image::GrayImage::from_pixel(16, 12, image::Luma([255]));
    for inner in ["masks", "seg"] {
        mask.save(folder.path().join(inner).join("r_0.png")).expect("written");
    }
    let file = load(&folder).expect("a job");
    let sizes = file.job.problem().targets.iter().map(|target| (target.camera.width, target.camera.height));
    assert_eq!(sizes.collect::<Vec<_>>(), [(16, 12), (8, 6)]);
}

#[test]
fn unknown_keys_and_words() {
    refused(&job("initial", "intial"), &["j.toml:", "unknown key `intial`", "did you mean `initial`?"]);
    refused(&job("\"albedo\"", "\"albido\""), &["j.toml:9", "albido", "did you mean `albedo`?"]);
    refused(&job("relative-l2", "relative-l3"), &["did you mean `relative-l2`?"]);
    refused(&job("[solve]", "[solver]"), &["unknown key `solver`", "did you mean `solve`?"]);
    refused(&job("\"rigid\"", "\"rigit\""), &["j.toml:17", "did you mean `rigid`?"]);
    refused(&job("\"vulkan\"", "\"gpu\""), &["j.toml:44", "\"gpu\" is no backend", "auto, vulkan or cpu"]);
    refused("scene = ", &["j.toml:1"]);
    refused("", &["j.toml:1", "scene"]);
    refused("scene = \"s.toml\"\n", &["no [[target]]"]);
    refused("scene = \"s.toml\"\n[[target]]\npicture = \"p.exr\"\n", &["no [[fit]]"]);
}

#[test]
fn names_that_nothing_has() {
    refused(
        &job("\"wall\", \"red\"", "\"wal\""),
        &["j.toml:8", "material \"wal\"", "did you mean \"wall\"?"],
    );
    refused(&job("[\"box\"]", "[\"bax\"]"), &["j.toml:14", "mesh \"bax\"", "did you mean \"box\"?"]);
    refused(&job("\"main\"", "\"mian\""), &["j.toml:5", "camera \"mian\"", "did you mean \"main\"?"]);
    refused(&job("camera = \"main\"", "camera = \"top\""), &["it has: main"]);
}

#[test]
fn files_that_are_not_there_or_not_right() {
    refused(&job("s.toml", "t.toml"), &["j.toml:1", "t.toml", "cannot be read"]);
    refused(&job("p.exr", "q.exr"), &["j.toml:4", "q.exr", "cannot be read"]);
    refused(&job("p.exr", "s.toml"), &["j.toml:4", "none of EXR, PNG"]);
    let broken = folder(&[("p.exr", "not a picture")]);
    says(&load(&broken).err().expect("broken"), &["j.toml:4", "p.exr", "cannot be read"]);
    let broken = folder(&[("s.toml", "[[mesh]]\npath = \"none.obj\"\n")]);
    says(&load(&broken).err().expect("broken"), &["s.toml:2", "none.obj"]);

    let wrong = folder(&[]);
    picture(16, 13).write_exr(wrong.path().join("p.exr")).expect("written");
    says(&load(&wrong).err().expect("wrong"), &["j.toml:4", "p.exr", "16 x 13", "\"main\" takes 16 x 12"]);

    let mut nan = picture(16, 12);
    nan.pixels[16 * 2 + 5][1] = f32::NAN;
    let folder = folder(&[]);
    nan.write_exr(folder.path().join("p.exr")).expect("written");
    says(&load(&folder).err().expect("NaN"), &["j.toml:4", "NaN at column 5, row 2", "mask the pixel out"]);
    // Masked pixels may hold any value.
    let mut mask = image::GrayImage::from_pixel(16, 12, image::Luma([255]));
    mask.put_pixel(5, 2, image::Luma([0]));
    mask.save(folder.path().join("m.png")).expect("written");
    let masked = job("weight = 2", "mask = \"m.png\"");
    fs::write(folder.path().join("j.toml"), &masked).expect("written");
    load(&folder).expect("a job");
    image::GrayImage::new(16, 11).save(folder.path().join("m.png")).expect("written");
    says(&load(&folder).err().expect("size"), &["j.toml:6", "the mask is 16 x 11"]);
    image::GrayImage::new(16, 12).save(folder.path().join("m.png")).expect("written");
    says(&load(&folder).err().expect("black"), &["no pixel is left"]);
}

#[test]
fn png_targets_are_decoded_and_clipped_pixels_left_out() {
    let mut shown = picture(16, 12);
    shown.pixels[7] = [5.0, 0.2, 0.1, 1.0];
    let text = job("p.exr\"", "p.png\"\nwhite = 2");
    let folder = folder(&[("j.toml", &text)]);
    let tone = ToneMap::default().exposure(Exposure::Stops(0.0)).srgb(true);
    shown.write_png(folder.path().join("p.png"), &tone).expect("written");
    let file = load(&folder).expect("a job");
    let target = &file.job.problem().targets[0];
    assert!((target.pixels[0].x - 0.6).abs() < 0.01, "{}", target.pixels[0]);
    assert_eq!((target.mask_at(7), target.mask_at(8)), (0.0, 1.0));
    says(&file.warnings[0], &["1 clipped pixels", "clipped = \"use\""]);
    fs::write(folder.path().join("j.toml"), text.replace("white = 2", "clipped = \"use\"")).expect("written");
    assert_eq!(load(&folder).expect("a job").job.problem().targets[0].mask, None);
}

#[test]
fn responses_of_cameras() {
    let keys = |keys: &str| job("p.exr\"", &format!("p.png\"\n{keys}"));
    let folder = folder(&[]);
    let tone = ToneMap::default().exposure(Exposure::Stops(0.0)).srgb(false);
    picture(16, 12).write_png(folder.path().join("p.png"), &tone).expect("written");
    let target = |text: &str| {
        fs::write(folder.path().join("j.toml"), text).expect("written");
        load(&folder).map(|file| file.job.problem().targets[0].clone())
    };
    let number = srgb_from_linear(target(&keys("")).expect("a job").pixels[0].x);
    for (text, value) in [
        ("response = \"srgb\"", linear_from_srgb(number)),
        ("response = \"linear\"", number),
        ("response = \"gamma\"", number.powf(2.2)),
        ("response = \"gamma\"\ngamma = 1.8", number.powf(1.8)),
        ("response = \"fit\"", linear_from_srgb(number)),
    ] {
        let found = target(&keys(text)).expect("a job");
        assert!((found.pixels[0].x - value).abs() <= 1e-6, "{text}: {} {value}", found.pixels[0]);
        assert_eq!(found.response.is_some(), text.contains("fit"));
    }
    let response = target(&keys("white = 2\nresponse = \"fit\"")).expect("a job").response;
    assert_eq!(response.map(|response| response.white), Some(2.0));
    target(&job("weight = 2", "response = \"linear\"")).expect("floats are linear");
    refused(&job("weight = 2", "response = \"fit\""), &["j.toml:4", "p.exr", "`response` is for PNG"]);
    refused(&job("weight = 2", "response = \"gama\""), &["j.toml:6", "gamma"]);
    refused(&job("weight = 2", "gamma = 2"), &["j.toml:6", "response = \"gamma\""]);
    refused(&job("weight = 2", "response = \"gamma\"\ngamma = 0"), &["j.toml:7", "gamma = 0"]);
    refused(&job("weight = 2", "response = \"gamma\"\ngamma = nan"), &["j.toml:7", "gamma = NaN"]);
    let text = keys("response = \"fit\"").replace("relative-l2", "l1");
    let error = target(&text).expect_err("no smooth loss");
    says(&error.to_string(), &["responses", "huber"]);
}

#[test]
fn noise_of_pictures() {
    let noise = |keys: &str| job("weight = 2", &format!("noise = {keys}"));
    let file =
        load(&folder(&[("j.toml", &noise("{ shot = 1e-3, read = 0.02 }\nwhite = 5"))])).expect("a job");
    // Floats have no white.
    let of_floats = Noise { shot: 1e-3, read: 0.02 };
    assert_eq!(file.job.problem().targets[0].noise, Some(of_floats));
    let small = noise("{ read = 0.02 }").replace("p.exr", "large.exr");
    let folder = folder(&[("j.toml", &small)]);
    picture(64, 48).write_exr(folder.path().join("large.exr")).expect("written");
    let file = load(&folder).expect("a job");
    // A mean over 4 x 4 pixels.
    assert_eq!(file.job.problem().targets[0].noise, Some(Noise { shot: 0.0, read: 0.005 }));
    for keys in ["{ shot = -1 }", "{ read = nan }", "{}", "{ shot = 0, read = inf }"] {
        refused(&noise(keys), &["j.toml:6", "`shot` and `read`"]);
    }
    refused(&noise("{ reed = 1 }"), &["j.toml:6", "did you mean `read`?"]);
    refused(&noise("{ read = 1 }").replace("relative-l2", "l1"), &["j.toml:6", "huber and relative-l2"]);
}

#[test]
fn a_view_of_its_own() {
    let view =
        "view = { position = [1, 1, 0.1], target = [1, 1, 2], fov_x_degrees = 60, width = 16, height = 12 }";
    let file = load(&folder(&[("j.toml", &job("camera = \"main\"", view))])).expect("a job");
    assert_eq!(file.job.problem().targets[0].camera.name, "p");
    refused(&job("weight", &format!("{view}\nweight")), &["j.toml:3", "either `camera` or `view`"]);
    refused(&job("camera = \"main\"", &view.replace("60", "600")), &["fov_x_degrees is 600"]);
    // With a single camera in the scene, the name is optional.
    load(&folder(&[("j.toml", &job("camera = \"main\"\n", ""))])).expect("a job");
}

#[test]
fn numbers_and_combinations_that_mean_nothing() {
    refused(&job("epsilon = 0.02", "epsilon = 0"), &["j.toml:21", "epsilon = 0"]);
    refused(&job("memory = 7", "memory = 0"), &["memory = 0"]);
    refused(&job("every = 3", "every = 0"), &["every = 0"]);
    refused(&job("tolerance = 1e-6", "tolerance = 2"), &["tolerance = 2"]);
    refused(&job("supersample = 2", "supersample = 3"), &["supersample = 3", "power of two"]);
    refused(&job("weight = 2", "weight = -1"), &["j.toml:4", "the weight is -1"]);
    refused(&job("iterations = 40", "iterations = 0"), &["iterations = 0"]);
    refused(&job("iterations = 40", "relative_decrease = -1"), &["relative_decrease = -1"]);
    refused(&job("initial = 0.5", "motion = \"rigid\""), &["j.toml:8", "`motion` is for parameter"]);
    refused(&job("motion = \"rigid\"\n", ""), &["j.toml:14", "how may positions change"]);
    refused(
        &job("motion = \"rigid\"", "motion = \"rigid\"\nper = \"mesh\""),
        &["use `motion` for positions"],
    );
    let camera = |keys: &str| {
        job(
            "parameter = \"albedo\"\nmaterials = [\"wall\", \"red\"]\ninitial = 0.5\nupper = [0.9, 0.9, 0.95]",
            &format!("parameter = \"camera\"\n{keys}"),
        )
    };
    let with_prior = |text: String| text.replace("of = \"albedo\"\nvalue = 0.5", "of = \"camera\"");
    let file =
        load(&folder(&[("j.toml", &with_prior(camera("cameras = [\"main\"]\nmax_rotation_degrees = 1")))]));
    assert_eq!(file.expect("a job").job.problem().parameters.len(), 6 + 6);
    refused(&camera("cameras = [\"mian\"]"), &["j.toml:8", "did you mean \"main\"?"]);
    refused(&camera("materials = [\"wall\"]"), &["j.toml:8", "use `cameras` instead of `materials`"]);
    refused(&camera("per = \"mesh\""), &["`per` is for materials"]);
    refused(&camera("motion = \"rigid\""), &["`motion` is for parameter = \"position\""]);
    refused(&camera("max_scale = 2"), &["j.toml:8", "`max_scale` is for", "together = true"]);
    refused(&camera("together = true\nmotion = \"vertices\""), &["j.toml:8", "motion = \"similarity\""]);
    refused(&camera("together = true\nmax_scale = 0.5"), &["j.toml:8", "max_scale is 0.5"]);
    for (keys, unknowns) in [("", 7), ("motion = \"rigid\"", 6), ("max_scale = 1.1\nmotion = \"scale\"", 1)] {
        let text = with_prior(camera(&format!("together = true\n{keys}")));
        let file = load(&folder(&[("j.toml", &text)])).expect("a job");
        assert_eq!(file.job.problem().parameters.len(), unknowns + 6, "{keys}");
    }
    refused(&camera("initial = 0"), &["leave `initial` out"]);
    refused(&camera("max_rotation_degrees = 0"), &["max_rotation_degrees is 0"]);
    refused(&job("initial = 0.5", "cameras = [\"main\"]"), &["`cameras` is for parameter = \"camera\""]);
    refused(&job("of = \"albedo\"\n", ""), &["which parameter?"]);
    refused(
        &job("kind = \"prior\"\nof = \"albedo\"\nvalue = 0.5", "kind = \"sparsity\""),
        &["j.toml:25", "emission is not fitted"],
    );
    refused(&job("kind = \"quasi-newton\"", "kind = \"least-squares\""), &["j.toml:31", "emission alone"]);
    refused(&job("upper = [0.9, 0.9, 0.95]", "lower = 0.99\nupper = 0.5"), &["j.toml:8", "0.99 to 0.5"]);
    refused(&job("upper = [0.9, 0.9, 0.95]", "upper = [0.9, 0.9]"), &["j.toml:12"]);
}
