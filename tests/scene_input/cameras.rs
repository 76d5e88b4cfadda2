//! Sets of cameras: `transforms.json` and the files of COLMAP.

use antirad::scene::{CameraSet, Focal, Frame};
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::path::Path;
use tempfile::TempDir;

use super::assert_says;

fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let folder = TempDir::new().expect("a temporary folder");
    for (name, bytes) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        std::fs::write(path, bytes).expect("written");
    }
    folder
}

fn read(path: &Path) -> CameraSet {
    CameraSet::read(path).unwrap_or_else(|error| panic!("{error}"))
}

#[track_caller]
fn refused(folder: &TempDir, name: &str, parts: &[&str]) {
    let error = CameraSet::read(&folder.path().join(name)).expect_err("it is wrong").to_string();
    assert_says(&error, parts);
}

fn json(text: &str) -> TempDir {
    folder(&[("t.json", text.as_bytes())])
}

const ROWS: &str = "[[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]";

fn frame(keys: &str) -> String {
    format!("{{{keys}, \"transform_matrix\": {ROWS}}}")
}

fn one(lens: &str) -> TempDir {
    json(&format!("{{{lens}, \"frames\": [{}]}}", frame("\"file_path\": \"images/a.jpg\"")))
}

#[test]
fn both_forms_of_a_set_have_the_same_cameras() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/photographs");
    let [ours, theirs] = [read(&data.join("transforms.json")), read(&data)];
    assert_eq!((ours.frames.len(), theirs.frames.len()), (12, 12));
    for (a, b) in ours.frames.iter().zip(&theirs.frames) {
        assert_eq!((&a.name, &a.picture, a.intrinsics.size()), (&b.name, &b.picture, b.intrinsics.size()));
        let [x, y] = [a, b].map(|frame| frame.intrinsics.lens([1, 1]).expect("a lens"));
        assert!(x.focal.abs_diff_eq(y.focal, 1e-6) && x.centre.abs_diff_eq(y.centre, 1e-6));
        for (a, b) in [(a.position, b.position), (a.forward, b.forward), (a.up, b.up)] {
            assert!(a.abs_diff_eq(b, 1e-6), "{a} {b}");
        }
        let lens = a.intrinsics.lens([1, 1]).expect("a lens");
        assert!(lens.is_centred_pinhole());
        let camera = a.camera(&lens, lens.width, lens.height);
        assert!((camera.fov_x_degrees - 70.0).abs() < 1e-9 && camera.check().is_ok());
    }
    // Of the matrix in the file.
    let first = &ours.frames[0];
    assert_eq!(first.position, DVec3::new(0.4, 1.6, 3.7));
    assert!(
        first.forward.abs_diff_eq(DVec3::new(0.678_363, -0.208_727, -0.704_454), 1e-5),
        "{}",
        first.forward
    );
    assert!(first.up.abs_diff_eq(DVec3::new(0.144_782, 0.977_974, -0.150_350), 1e-5), "{}", first.up);
}

#[test]
fn lenses_of_transforms() {
    let half = 2.0 * 0.5_f64.atan();
    let set = one(&format!("\"camera_angle_x\": {half}"));
    let set = read(&set.path().join("t.json"));
    let Frame { intrinsics, picture, name, .. } = &set.frames[0];
    assert_eq!((picture.as_path(), name.as_str()), (Path::new("images/a.jpg"), "a"));
    assert_eq!((intrinsics.size(), intrinsics.focal), (None, Focal::AngleX(half)));
    assert!((intrinsics.lens([40, 30]).expect("a lens").focal - DVec2::splat(40.0)).length() < 1e-9);

    let frames = [
        frame("\"file_path\": \"a.png\""),
        frame("\"file_path\": \"b\", \"fl_x\": 50, \"cx\": 30, \"k1\": 0.5, \"w\": 64.0"),
        frame("\"file_path\": \".\\\\left\\\\c.exr\", \"camera_angle_x\": 1"),
    ];
    let shared = "\"fl_x\": 100, \"fl_y\": 90, \"cx\": 31, \"cy\": 20, \"w\": 60, \"h\": 40, \"k1\": 0.01, \"k2\": 0.02, \
                  \"p1\": 0.03, \"p2\": 0.04, \"camera_model\": \"OPENCV\", \"aabb_scale\": 16";
    let set = json(&format!("{{{shared}, \"frames\": [{}]}}", frames.join(",")));
    let set = read(&set.path().join("t.json"));
    let [a, b, c] = [0, 1, 2].map(|k| &set.frames[k].intrinsics);
    assert_eq!((a.focal, a.size()), (Focal::Pixels(DVec2::new(100.0, 90.0)), Some([60, 40])));
    let d = a.distortion;
    assert_eq!([d.k1, d.k2, d.k3, d.p1, d.p2], [0.01, 0.02, 0.0, 0.03, 0.04]);
    assert_eq!(
        (b.focal, b.size(), b.centre_x),
        (Focal::Pixels(DVec2::new(50.0, 90.0)), Some([64, 40]), Some(30.0))
    );
    assert_eq!((b.distortion.k1, b.distortion.k2), (0.5, 0.02));
    assert_eq!((c.focal, set.frames[2].name.as_str()), (Focal::AngleX(1.0), "c"));
}

#[test]
fn frames_of_the_same_name_are_told_apart() {
    let of = |path: &str| frame(&format!("\"file_path\": \"{path}\""));
    let paths = ["./left/0.png", "./right/0.png", "1.png", "right/0.jpg", "v1.5"];
    let frames: Vec<String> = paths.iter().map(|path| of(path)).collect();
    let set = json(&format!("{{\"camera_angle_x\": 1, \"frames\": [{}]}}", frames.join(",")));
    let set = read(&set.path().join("t.json"));
    let names: Vec<&str> = set.frames.iter().map(|frame| frame.name.as_str()).collect();
    assert_eq!(names, ["left_0", "right_0", "1", "right_0_2", "v1.5"]);
    assert!(set.frame("right_0_2").is_some() && set.frame("0").is_none());
}

#[test]
fn pictures_are_found() {
    let picture = b"";
    let folder = folder(&[
        (
            "t.json",
            format!(
                "{{\"camera_angle_x\": 1, \"frames\": [{}, {}]}}",
                frame("\"file_path\": \"./train/r_0\""),
                frame("\"file_path\": \"./train/r_1.JPG\"")
            )
            .as_bytes(),
        ),
        ("train/r_0.PNG", picture),
        ("train/r_0.exr", picture),
        ("train/R_1.jpg", picture),
        ("small/r_0.Jpg", picture),
        ("small/r_1.exr", picture),
    ]);
    let set = read(&folder.path().join("t.json"));
    let found = |frame: usize, images: Option<&str>, suffix: Option<&str>| {
        let images = images.map(|images| folder.path().join(images));
        let found =
            set.picture(&set.frames[frame], images.as_deref(), suffix).map_err(|error| error.to_string())?;
        Ok::<_, String>(
            found.strip_prefix(folder.path()).expect("in the folder").to_string_lossy().replace("./", ""),
        )
    };
    assert_eq!(found(0, None, None).as_deref(), Ok("train/r_0.PNG"));
    assert_eq!(found(0, None, Some("exr")).as_deref(), Ok("train/r_0.exr"));
    assert_eq!(found(1, None, None).as_deref(), Ok("train/R_1.jpg"));
    assert_eq!(found(0, Some("small"), None).as_deref(), Ok("small/r_0.Jpg"));
    assert_eq!(found(1, Some("small"), Some(".exr")).as_deref(), Ok("small/r_1.exr"));
    assert_says(
        &found(1, None, Some(".exr")).expect_err("none"),
        &["t.json", "frame \"r_1\"", "r_1.exr", "there is"],
    );
    assert_says(
        &found(0, Some("none"), None).expect_err("none"),
        &["frame \"r_0\"", "none", "png, jpg, jpeg, exr", "`images`"],
    );
}

#[test]
fn what_is_wrong_with_transforms() {
    let good = "\"fl_x\": 100, \"w\": 60, \"h\": 40";
    let with_rows = |rows: &str| {
        json(&format!("{{{good}, \"frames\": [{{\"file_path\": \"a\", \"transform_matrix\": {rows}}}]}}"))
    };
    read(&with_rows(ROWS).path().join("t.json"));
    read(&with_rows("[[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]]").path().join("t.json"));
    let rigid = "frame 0 (\"a\")";
    for (rows, parts) in [
        ("[[2, 0, 0, 1], [0, 2, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]]", ["t.json", rigid, "not rigid"]),
        ("[[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]", ["t.json", rigid, "mirrors"]),
        ("[[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [1, 0, 0, 1]]", ["t.json", rigid, "last row"]),
        ("[[1, 0, 0, 1], [0, 1, 0, 2]]", ["t.json", rigid, "2 rows"]),
        ("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", ["t.json", rigid, "up to 3 numbers"]),
        ("[[1, 0, 0, \"x\"], [0, 1, 0, 2], [0, 0, 1, 3]]", ["t.json", rigid, "string"]),
        ("[[1, 0, 0, NaN], [0, 1, 0, 2], [0, 0, 1, 3]]", ["t.json:1", "NaN", "correct"]),
        ("[[1, 0, 0, 1e999], [0, 1, 0, 2], [0, 0, 1, 3]]", ["t.json:1", "out of range", "no JSON"]),
    ] {
        refused(&with_rows(rows), "t.json", &parts);
    }
    for (lens, parts) in [
        ("\"w\": 60", ["frame 0 (\"images/a.jpg\")", "no focal length", "camera_angle_x"]),
        ("\"fl_x\": -100, \"w\": 60, \"h\": 40", ["frame 0", "focal length", "above 0"]),
        ("\"fl_x\": 100, \"w\": 60.5, \"h\": 40", ["frame 0", "w is 60.5", "whole number"]),
        ("\"fl_x\": 100, \"w\": 60, \"h\": 4e9", ["frame 0", "h is 4000000000", "65536"]),
        ("\"fl_x\": 100, \"w\": 60, \"h\": 40, \"cx\": 400", ["frame 0", "principal point", "outside"]),
        (
            "\"fl_x\": 100, \"w\": 60, \"h\": 40, \"camera_model\": \"OPENCV_FISHEYE\"",
            ["frame 0", "OPENCV_FISHEYE", "undistort"],
        ),
        ("\"fl_x\": 100, \"w\": 60, \"h\": 40, \"is_fisheye\": true", ["frame 0", "fisheye", "undistort"]),
        ("\"fl_x\": \"100\"", ["t.json", "string", "expected"]),
        (
            "\"camera_angle_x\": 4, \"w\": 60, \"h\": 40",
            ["frame 0", "camera_angle_x is 4", "between 0 and π"],
        ),
    ] {
        refused(&one(lens), "t.json", &parts);
    }
    refused(&json("{\"fl_x\": 1}"), "t.json", &["no `frames`", "transform_matrix"]);
    refused(&json("{\"fl_x\": 1, \"frames\": 3}"), "t.json", &["`frames` are no list"]);
    refused(&json("{\"fl_x\": 1, \"frames\": []}"), "t.json", &["no frames"]);
    refused(
        &json("{\"fl_x\": 1, \"frames\": [{\"file_path\": \"a\"}]}"),
        "t.json",
        &["frame 0 (\"a\")", "`transform_matrix`"],
    );
    refused(&json("{\"fl_x\": 1, \"frames\": [7]}"), "t.json", &["frame 0", "`file_path`"]);
    refused(
        &json(&format!("{{\"fl_x\": 1, \"frames\": [{}]}}", frame("\"file_path\": \"\""))),
        "t.json",
        &["frame 0", "names no file"],
    );
    refused(&json("{\"frames\": ["), "t.json", &["t.json:1", "no JSON"]);
    refused(&json(""), "t.json", &["t.json:1", "no JSON"]);
    refused(&json("{}"), "none.json", &["none.json", "cannot be read"]);
    refused(&folder(&[("a.csv", b"")]), "a.csv", &["a.csv", "transforms.json"]);
    refused(&folder(&[]), "", &["no set of cameras", "sparse"]);
}

const CAMERAS: &str = "# comment\n1 OPENCV 60 40 50 51 30 20 .1 .01 .001 .002\n\n2 SIMPLE_RADIAL 60 40 50 30 20 -.1\n\
                       3 RADIAL 60 40 50 30 20 -.1 .01\n4 SIMPLE_PINHOLE 60 40 50 30 20\n5 PINHOLE 60 40 50 51 30 20\n";
const IMAGES: &str =
    "# comment\n\n7 1 0 0 0 1 2 3 1 some folder/a b.jpg\n10.5 11.5 -1 1 2 3\n8 .6 0 .8 0 1 2 3 5 b.jpg\n\n";

fn colmap(cameras: &str, images: &str) -> TempDir {
    folder(&[("m/cameras.txt", cameras.as_bytes()), ("m/images.txt", images.as_bytes())])
}

#[test]
fn colmap_in_text() {
    let folder = colmap(CAMERAS, IMAGES);
    let set = read(&folder.path().join("m"));
    assert_eq!(set.frames.len(), 2);
    let [a, b] = [&set.frames[0], &set.frames[1]];
    assert_eq!((a.name.as_str(), a.picture.as_path()), ("a b", Path::new("some folder/a b.jpg")));
    assert_eq!((a.position, a.forward, a.up), (DVec3::new(-1.0, -2.0, -3.0), DVec3::Z, DVec3::NEG_Y));
    let d = a.intrinsics.distortion;
    assert_eq!([d.k1, d.k2, d.p1, d.p2], [0.1, 0.01, 0.001, 0.002]);
    assert_eq!(b.intrinsics.focal, Focal::Pixels(DVec2::new(50.0, 51.0)));
    // x = R X + t, so that the centre is where x is 0, and the axis where x is (0, 0, 1).
    let rotation = DMat3::from_quat(DQuat::from_xyzw(0.0, 0.8, 0.0, 0.6));
    let seen = |point: DVec3| rotation * point + DVec3::new(1.0, 2.0, 3.0);
    assert!(seen(b.position).length() < 1e-12);
    assert!(seen(b.position + b.forward).abs_diff_eq(DVec3::Z, 1e-12));
    assert!(seen(b.position + b.up).abs_diff_eq(DVec3::NEG_Y, 1e-12));
    // Pictures are beside the folder, files in the folders that COLMAP makes, and one of them names all.
    assert!(set.pictures.ends_with("images"));
    let folder = self::folder(&[
        ("sparse/0/cameras.txt", CAMERAS.as_bytes()),
        ("sparse/0/images.txt", IMAGES.as_bytes()),
        ("images/b.jpg", b""),
    ]);
    for inner in ["", "sparse", "sparse/0", "sparse/0/images.txt"] {
        let set = read(&folder.path().join(inner));
        let found = set.picture(&set.frames[1], None, None).expect("the picture");
        assert_eq!(
            found.canonicalize().expect("it exists"),
            folder.path().join("images/b.jpg").canonicalize().expect("it exists")
        );
    }
}

#[test]
fn what_is_wrong_with_text_of_colmap() {
    for (cameras, images, parts) in [
        ("1 FULL_OPENCV 60 40 1 2 3", IMAGES, ["cameras.txt:1", "FULL_OPENCV", "image_undistorter"]),
        ("1 PINHOLE 60 40 1 2 3", IMAGES, ["cameras.txt:1", "camera 1", "4 parameters"]),
        ("1 PINHOLE 60", IMAGES, ["cameras.txt:1", "ends before", "height"]),
        ("1 PINHOLE 60 40 50 x 30 20", IMAGES, ["cameras.txt:1", "camera 1", "\"x\""]),
        ("1 PINHOLE 60 40 50 nan 30 20", IMAGES, ["cameras.txt:1", "camera 1", "focal length"]),
        ("1 PINHOLE 60 18446744073709551615 50 50 30 20", IMAGES, ["cameras.txt:1", "camera 1", "height"]),
        (
            "1 PINHOLE 60 40 50 50 30 20\n1 PINHOLE 60 40 50 50 30 20",
            IMAGES,
            ["cameras.txt:2", "twice", "camera 1"],
        ),
        ("", IMAGES, ["images.txt", "image \"some folder/a b.jpg\"", "camera 1"]),
        (CAMERAS, "1 1 0 0 0 1 2 3 9 a.jpg\n\n", ["images.txt", "image \"a.jpg\"", "camera 9"]),
        (CAMERAS, "1 0 0 0 0 1 2 3 1 a.jpg\n\n", ["images.txt", "image \"a.jpg\"", "quaternion"]),
        (CAMERAS, "1 nan 0 0 0 1 2 3 1 a.jpg\n\n", ["images.txt", "image \"a.jpg\"", "quaternion"]),
        (CAMERAS, "1 1 0 0 0 inf 2 3 1 a.jpg\n\n", ["images.txt", "image \"a.jpg\"", "not finite"]),
        (CAMERAS, "1 1 0 0 0 1 2 3 1\n\n", ["images.txt:1", "ends before", "name"]),
        (CAMERAS, "1 1 0 0 0 1 2\n\n", ["images.txt:1", "ends before", "TZ"]),
        (
            CAMERAS,
            "1 1 0 0 0 1 2 3 1 a.jpg\n2 1 0 0 0 1 2 3 1 b.jpg\n",
            ["images.txt:2", "\"a.jpg\"", "do not leave it out"],
        ),
        (CAMERAS, "", ["images.txt", "no frames", "picture"]),
    ] {
        refused(&colmap(cameras, images), "m", &parts);
    }
    refused(&folder(&[("m/cameras.txt", b"")]), "m", &["no set of cameras", "images.txt"]);
    refused(
        &folder(&[("m/cameras.txt", b""), ("m/images.txt", b"\xff\xfe\n")]),
        "m",
        &["images.txt", "cannot be read"],
    );
}

/// The same set as [`CAMERAS`] and [`IMAGES`].
fn binary() -> [Vec<u8>; 2] {
    let cameras: [(u32, u32, &[f64]); 5] = [
        (1, 4, &[50.0, 51.0, 30.0, 20.0, 0.1, 0.01, 0.001, 0.002]),
        (2, 2, &[50.0, 30.0, 20.0, -0.1]),
        (3, 3, &[50.0, 30.0, 20.0, -0.1, 0.01]),
        (4, 0, &[50.0, 30.0, 20.0]),
        (5, 1, &[50.0, 51.0, 30.0, 20.0]),
    ];
    let mut first = 5u64.to_le_bytes().to_vec();
    for (id, model, parameters) in cameras {
        first.extend([id.to_le_bytes(), model.to_le_bytes()].concat());
        first.extend([60u64.to_le_bytes(), 40u64.to_le_bytes()].concat());
        first.extend(parameters.iter().flat_map(|value| value.to_le_bytes()));
    }
    let images: [(u32, [f64; 7], u32, &str, u64); 2] = [
        (7, [1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0], 1, "some folder/a b.jpg", 2),
        (8, [0.6, 0.0, 0.8, 0.0, 1.0, 2.0, 3.0], 5, "b.jpg", 0),
    ];
    let mut second = 2u64.to_le_bytes().to_vec();
    for (id, pose, camera, name, points) in images {
        second.extend(id.to_le_bytes());
        second.extend(pose.iter().flat_map(|value| value.to_le_bytes()));
        second.extend(camera.to_le_bytes());
        second.extend(name.bytes().chain([0]));
        second.extend(points.to_le_bytes());
        second.extend(vec![1; 24 * points as usize]);
    }
    [first, second]
}

fn colmap_binary(cameras: &[u8], images: &[u8]) -> TempDir {
    folder(&[("m/cameras.bin", cameras), ("m/images.bin", images)])
}

#[test]
fn colmap_in_binary() {
    let [cameras, images] = binary();
    let (folder, text) = (colmap_binary(&cameras, &images), colmap(CAMERAS, IMAGES));
    assert_eq!(read(&folder.path().join("m")).frames, read(&text.path().join("m")).frames);
    // Cut off anywhere, it is refused.
    for end in 0..cameras.len() {
        refused(&colmap_binary(&cameras[..end], &images), "m", &["cameras.bin", "cut off"]);
    }
    for end in 0..images.len() {
        refused(&colmap_binary(&cameras, &images[..end]), "m", &["images.bin", "cut off"]);
    }
    // What a header claims allocates nothing.
    let claim = |bytes: &[u8], at: usize| {
        let mut bytes = bytes.to_vec();
        bytes[at..at + 8].copy_from_slice(&u64::MAX.to_le_bytes());
        bytes
    };
    refused(
        &colmap_binary(&claim(&cameras, 0), &images),
        "m",
        &["camera 6 of 18446744073709551615", "cut off"],
    );
    refused(
        &colmap_binary(&cameras, &claim(&images, 0)),
        "m",
        &["image 3 of 18446744073709551615", "cut off"],
    );
    let points = 8 + 4 + 56 + 4 + "some folder/a b.jpg".len() + 1;
    refused(
        &colmap_binary(&cameras, &claim(&images, points)),
        "m",
        &["image 1 of 2 (\"some folder/a b.jpg\")", "cut off"],
    );
    let model = |number: u32| {
        let mut cameras = cameras.clone();
        cameras[12..16].copy_from_slice(&number.to_le_bytes());
        colmap_binary(&cameras, &images)
    };
    refused(&model(5), "m", &["camera 1 of 5", "OPENCV_FISHEYE", "image_undistorter"]);
    refused(&model(99), "m", &["camera 1 of 5", "number 99"]);
    refused(&colmap_binary(&claim(&cameras, 16), &images), "m", &["camera 1 of 5", "width"]);
}
