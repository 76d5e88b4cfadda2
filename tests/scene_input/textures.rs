//! Textures of MTL files.

use super::{Folder, assert_says};
use antirad::scene::Scene;

/// A square of four quadrants: white at the lower left, black elsewhere.
fn folder(mtl: &str) -> Folder {
    let obj = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl wood\nf 1/1 2/2 4/4\nf 2/2 3/3 4/4\n";
    let folder = Folder::with(&[("m.obj", obj), ("m.mtl", mtl)]);
    let white = |x: u32, y: u32| if x < 32 && y >= 32 { 255 } else { 0 };
    let picture = image::RgbImage::from_fn(64, 64, |x, y| image::Rgb([white(x, y); 3]));
    picture.save(folder.0.path().join("a wood.png")).expect("written");
    folder
}

fn albedos(scene: &Scene) -> [f64; 2] {
    [0, 1].map(|t| scene.material(t).albedo[0])
}

#[test]
fn colours_are_means_over_triangles() {
    let scene =
        folder("newmtl wood\nKd .8 .4 .2\nmap_Kd a wood.png\n").load("m.obj", false).expect("a scene");
    // Half of the lower left triangle is white, and nothing of the other.
    let [first, second] = albedos(&scene);
    assert!((first - 0.4).abs() < 0.01 && second == 0.0, "{first} {second}");
    assert!((scene.material(0).albedo[2] - 0.1).abs() < 0.003);
    // Twice as often, the four quadrants are in every corner.
    let twice = folder("newmtl wood\nKd .8 .8 .8\nmap_Kd -clamp off -s 2 2 1 -o 0 0 a wood.png\n");
    let [first, second] = albedos(&twice.load("m.obj", false).expect("a scene"));
    assert!((first - 0.8 * 0.375).abs() < 0.01 && (second - 0.8 * 0.125).abs() < 0.01, "{first} {second}");
    // Black with a texture means the texture; it may shine.
    let bright = folder("newmtl wood\nKd 0 0 0\nmap_Ke a wood.png\nKe 6 6 6\nmap_Kd a wood.png\n");
    let scene = bright.load("m.obj", false).expect("a scene");
    assert!((scene.material(0).emission[0] - 3.0).abs() < 0.1, "{:?}", scene.material(0));
    assert!((albedos(&scene)[0] - 0.5).abs() < 0.02);
    assert_eq!(scene.material(1).emission, [0.0; 3]);
}

/// The mean of a mesh is that of the picture, however fine it is.
#[test]
fn subdivision_keeps_the_mean() {
    let toml = "[[mesh]]\npath = \"m.obj\"\nsubdivide = 3\n[camera.main]\nposition = [0, 0, 5]\ntarget = [0, 0, 0]\nfov_x_degrees = 40\nwidth = 4\nheight = 4\n";
    let folder = folder("newmtl wood\nKd .8 .8 .8\nmap_Kd a wood.png\n");
    std::fs::write(folder.0.path().join("s.toml"), toml).expect("written");
    let scene = folder.load("s.toml", false).expect("a scene");
    assert_eq!(scene.triangles.len(), 128);
    let mean: f64 = (0..128).map(|t| scene.material(t).albedo[0]).sum::<f64>() / 128.0;
    assert!((mean - 0.2).abs() < 1e-3, "{mean}");
    // Nearly all triangles are white or black.
    assert!(scene.materials.len() < 30);
    // A table of the scene file takes precedence.
    std::fs::write(folder.0.path().join("s.toml"), format!("{toml}[material.wood]\nalbedo = 0.3\n"))
        .expect("written");
    let plain = folder.load("s.toml", false).expect("a scene");
    assert!((0..128).all(|t| plain.material(t).albedo == [0.3; 3]));
}

/// Where a texture varies, triangles are cut until their parts are even, or no more may be; the mean stays.
#[test]
fn triangles_are_cut_where_a_texture_varies() {
    let folder = folder("newmtl wood\nKd .8 .4 .2\nmap_Kd -o .1 0 a wood.png\n");
    let given = folder.load("m.obj", false).expect("a scene");
    let mean = |scene: &Scene| -> f64 {
        (0..scene.triangles.len()).map(|t| scene.area_vector(t).length() * scene.material(t).albedo[0]).sum()
    };
    let before = mean(&given);
    // White from 0 to .4 and from .9 to 1, below .5.
    let mut fine = given.clone();
    let refined = fine.refine_textures(0.1, 10_000, 3);
    assert_eq!(refined.rounds, 3);
    assert!(!refined.full);
    assert!([0, 1].iter().all(|t| refined.parents.iter().filter(|&parent| parent == t).count() > 4));
    assert!((mean(&fine) - before).abs() < 2e-3, "{} {before}", mean(&fine));
    let even = |t: usize| {
        let albedo = fine.material(t).albedo;
        assert!((albedo[1] - albedo[0] / 2.0).abs() < 1e-12 && fine.material(t).name.starts_with("wood"));
        albedo[0] == 0.0 || (albedo[0] - 0.8).abs() < 1e-9
    };
    let area = |t: usize| fine.area_vector(t).length();
    let uneven: f64 = (0..fine.triangles.len()).filter(|&t| !even(t)).map(area).sum();
    // The upright borders are 1 m long together, and a part 1/8 m wide; cuts follow the other one.
    assert!(uneven <= 1.0 / 8.0 + 1e-9, "{uneven}");
    assert!(fine.check(true).is_ok());
    // Within a budget, the most uneven first.
    let mut bounded = given.clone();
    let refined = bounded.refine_textures(0.1, 12, 3);
    assert!(refined.full && bounded.triangles.len() <= 12 && bounded.triangles.len() > 9);
    // Nothing to do.
    assert_eq!(given.clone().refine_textures(0.9, 10_000, 3).rounds, 0);
}

/// Colours of corners vary linearly: cutting stops at the tolerance.
#[test]
fn triangles_are_cut_where_colours_of_corners_vary() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float \
               red\nproperty float green\nproperty float blue\nelement face 1\nproperty list uchar int \
               vertex_indices\nend_header\n0 0 0 0 0.1 0.3\n1 0 0 0.8 0.1 0.3\n0 1 0 0 0.1 0.3\n3 0 1 2\n";
    let mut scene = Folder::with(&[("c.ply", ply)]).load("c.ply", false).expect("a scene");
    let refined = scene.refine_textures(0.09, 10_000, 6);
    assert!(refined.rounds == 3 && scene.triangles.len() == 64, "{refined:?}");
    for t in 0..scene.triangles.len() {
        let [a, b, c] = scene.corners(t);
        let red = 0.8 * (a.x + b.x + c.x) / 3.0;
        let factor = scene.material(t).albedo[1] / 0.1;
        assert!((scene.material(t).albedo[0] - factor * red).abs() < 1e-6, "{t}");
    }
}

#[test]
fn textures_that_cannot_be_used_are_named() {
    for (name, part) in [("lost.png", "is missing"), ("m.obj", "neither PNG nor JPEG")] {
        let folder = folder(&format!("newmtl wood\nKd .3 .3 .3\nmap_Kd {name}\n"));
        let scene = folder.load("m.obj", false).expect("a scene");
        assert_eq!(albedos(&scene), [0.3; 2]);
        let said: Vec<&String> = scene.warnings.iter().filter(|w| w.contains("texture")).collect();
        assert_eq!(said.len(), 1);
        assert_says(said[0], &["m.mtl:3", name, part]);
    }
    let broken = folder("newmtl wood\nmap_Kd b.png\n");
    std::fs::write(broken.0.path().join("b.png"), b"\x89PNG\r\n\x1a\n").expect("written");
    assert_says(
        &broken.load("m.obj", false).expect_err("broken").to_string(),
        &["m.mtl:2", "b.png", "no readable picture"],
    );
    // 2 GB of zeros, which take no room on disk.
    let file = std::fs::File::create(broken.0.path().join("b.png")).expect("a file");
    file.set_len(2 << 30).expect("a long file");
    let error = broken.load("m.obj", false).expect_err("too long").to_string();
    assert_says(&error, &["m.mtl:2", "b.png", "2147483648 bytes"]);
}

/// As programs on Windows write them: names with blanks, backslashes, CRLF, options before the file, and indices from the end.
#[test]
fn names_options_and_indices_as_they_come() {
    let folder = folder("");
    let path = folder.0.path();
    std::fs::create_dir(path.join("maps")).expect("a folder");
    std::fs::rename(path.join("a wood.png"), path.join("maps/Wood Tile.png")).expect("moved");
    let obj = "mtllib my scene.mtl\r\no the floor\r\nv 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nv 0 1 0\r\nvt 0 0\r\nvt 1 0\r\nvt 1 1\r\nvt 0 1\r\n\
               usemtl floor mat \r\nf -4/-4 -3/-3 -1/-1\r\nf -3/-3 -2/-2 -1/-1\r\n";
    let mtl = "newmtl floor mat\r\nKd .8 .8 .8\r\nmap_Kd -s 2 2 1 -o .25 0 0 -clamp off -bm 1 maps\\Wood Tile.png\r\n";
    std::fs::write(path.join("n.obj"), obj).expect("written");
    std::fs::write(path.join("my scene.mtl"), mtl).expect("written");
    let scene = folder.load("n.obj", false).expect("a scene");
    assert_eq!(
        scene.warnings.iter().filter(|w| !w.contains("light") && !w.contains("camera")).count(),
        0,
        "{:?}",
        scene.warnings
    );
    assert!(scene.material(0).name.starts_with("floor mat"), "{}", scene.material(0).name);
    // Twice as often and moved by a quarter: a quarter of the square is white as before.
    let sum: f64 = albedos(&scene).iter().sum();
    assert!((sum / 2.0 - 0.2).abs() < 0.01, "{sum}");
    assert!((albedos(&scene)[0] - albedos(&scene)[1]).abs() > 0.01);
}

/// As surveys have it: coordinates in which single precision has steps of half a metre.
#[test]
fn meshes_far_from_the_origin_keep_their_shape() {
    let near = "v 0 0 0\nv 1.25 0 0\nv 0 1.5 0\nf 1 2 3\n";
    let far =
        "v 4500000.125 5400000.5 100\nv 4500001.375 5400000.5 100\nv 4500000.125 5400002 100\nf 1 2 3\n";
    let load = |obj: &str| {
        let folder = Folder::with(&[("m.obj", obj)]);
        folder.load("m.obj", false).expect("a scene")
    };
    assert_eq!(load(far).area_vector(0), load(near).area_vector(0));
}
