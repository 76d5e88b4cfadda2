//! PLY files.

use antirad::scene::Scene;
use glam::DVec3;

use super::{Folder, assert_says};

fn load(bytes: &[u8]) -> Result<Scene, String> {
    let folder = Folder::with(&[]);
    std::fs::write(folder.0.path().join("m.ply"), bytes).expect("written");
    folder.load("m.ply", false).map_err(|error| error.to_string())
}

const HEADER: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty double z\nproperty uchar red\nproperty uchar \
                      green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];

/// A square with a colour at each corner, in each encoding.
fn square(encoding: &str) -> Vec<u8> {
    let mut bytes = format!("ply\nformat {encoding} 1.0\ncomment a square\n{HEADER}").into_bytes();
    let big = encoding == "binary_big_endian";
    for (k, [x, y]) in CORNERS.into_iter().enumerate() {
        let red = if k == 0 { 255u8 } else { 0 };
        if encoding == "ascii" {
            bytes.extend(format!("{x} {y} 0.5 {red} 255 0\n").bytes());
            continue;
        }
        for float in [x as f32, y as f32] {
            bytes.extend(if big { float.to_be_bytes() } else { float.to_le_bytes() });
        }
        bytes.extend(if big { 0.5f64.to_be_bytes() } else { 0.5f64.to_le_bytes() });
        bytes.extend([red, 255, 0]);
    }
    if encoding == "ascii" {
        bytes.extend(b"4 0 1 2 3\n");
    } else {
        bytes.push(4);
        bytes
            .extend([0i32, 1, 2, 3].iter().flat_map(|k| if big { k.to_be_bytes() } else { k.to_le_bytes() }));
    }
    bytes
}

#[test]
fn all_encodings_say_the_same() {
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let scene = load(&square(encoding)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((scene.vertices.len(), scene.triangles.len()), (4, 2), "{encoding}");
        let area: DVec3 = (0..2).map(|t| scene.area_vector(t)).sum();
        assert!(area.abs_diff_eq(4.0 * DVec3::Z, 1e-12) && scene.vertices[1].z == 0.5);
        // Both triangles have the first corner, whose red is a third of the mean. Green is limited to 90 %.
        for triangle in 0..2 {
            let [r, g, b] = scene.material(triangle).albedo;
            assert!((r / g - 1.0 / 3.0).abs() < 1e-9 && (g - 0.9).abs() < 1e-9 && b == 0.0, "{r} {g} {b}");
        }
    }
}

#[test]
fn faces_may_have_colours_and_meshes_none() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
                property list uchar uint vertex_index\nproperty float red\nproperty float green\nproperty float blue\nend_header\n\
                0 0 0\n1 0 0\n0 1 0\n3 0 1 2 0.25 0.5 0.75\n3 0 2 1 0.1 0.2 0.3\n";
    let scene = load(text.as_bytes()).expect("a scene");
    let albedo = |t: usize| DVec3::from(scene.material(t).albedo);
    assert!(albedo(0).abs_diff_eq(DVec3::new(0.25, 0.5, 0.75), 1e-6));
    assert!(albedo(1).abs_diff_eq(DVec3::new(0.1, 0.2, 0.3), 1e-6));
    let bare = text.replace("property float red\nproperty float green\nproperty float blue\n", "");
    let bare =
        load(bare.replace(" 0.25 0.5 0.75", "").replace(" 0.1 0.2 0.3", "").as_bytes()).expect("a scene");
    assert_eq!(bare.material(1).albedo, [0.5; 3]);
    assert!(bare.warnings.iter().any(|w| w.contains("no colours")), "{:?}", bare.warnings);
}

#[test]
fn what_is_wrong_is_said() {
    let ascii = String::from_utf8(square("ascii")).expect("text");
    for (text, parts) in [
        (String::new(), vec!["m.ply"]),
        (ascii.replace("ply\n", "plz\n"), vec!["m.ply", "line 1"]),
        (ascii.replace("4 0 1 2 3", "4 0 1 2 4"), vec!["m.ply", "face 0 has vertex 4", "4 vertices"]),
        (ascii.replace("4 0 1 2 3", "4 0 1 2 -1"), vec!["face 0 has vertex -1"]),
        (ascii.replace("4 0 1 2 3", "2 0 1"), vec!["face 0 has 2 corner(s)"]),
        (ascii.replace("4 0 1 2 3", "4 0 1 2"), vec!["m.ply", "line 18"]),
        (ascii.replace("element vertex 4", "element vertex 4000000000"), vec!["m.ply", "line"]),
        (ascii.replace("double z", "double w"), vec!["vertex 0 has no x, y and z"]),
        (ascii.replace("0 0 0.5", "0 nan 0.5"), vec!["m.ply"]),
        (ascii.replace("element face 1", "element face 0"), vec!["m.ply", "no triangles"]),
    ] {
        assert_says(&load(text.as_bytes()).expect_err(parts[0]), &parts);
    }
    for encoding in ["binary_little_endian", "binary_big_endian"] {
        let bytes = square(encoding);
        for cut in [1, 100, bytes.len() - 1] {
            assert_says(&load(&bytes[..cut]).expect_err("cut short"), &["m.ply"]);
        }
    }
}
