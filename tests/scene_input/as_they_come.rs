//! Scenes as other programs write them: what is mended, and what is said.

use antirad::path_tracer::PathTracer;
use antirad::scene::{LoadOptions, Orient, Scene};
use glam::DVec3;

use super::obj::{block, lamp};
use super::{Folder, MTL, assert_says};

fn load(obj: &str, options: &LoadOptions) -> Scene {
    let folder = Folder::with(&[("m.obj", &format!("mtllib m.mtl\nusemtl white\n{obj}"))]);
    Scene::load(&folder.0.path().join("m.obj"), options).unwrap_or_else(|error| panic!("{error}"))
}

fn auto(obj: &str) -> Scene {
    load(obj, &LoadOptions::default())
}

const UNIT: [[f64; 3]; 2] = [[0.0; 3], [1.0; 3]];

/// Sum over a mesh of volumes below its triangles: positive if its fronts are outside.
fn volume(scene: &Scene, triangles: std::ops::Range<usize>) -> f64 {
    triangles.map(|t| scene.corners(t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

fn irradiance(scene: &Scene, triangle: usize) -> f64 {
    PathTracer::new(scene).irradiance_of(triangle, 1024).mean.x
}

#[test]
fn materials_are_limited_with_one_warning() {
    let obj = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl lamp\nf 1 2 3\nusemtl white\nf 1 3 4\nusemtl blender\nf 1 4 3\n";
    let mtl = "newmtl white\nKd 1 1 1\nnewmtl lamp\nKd 0 0 0\nKe 1 1 1\nnewmtl blender\nKd .8 .4 .8\nKs .5 .5 .5\nNs 250\n\
               newmtl spare\nKd 2 2 2\n";
    let folder = Folder::with(&[("m.obj", obj), ("m.mtl", mtl)]);
    let scene = folder.load("m.obj", false).expect("a scene");
    let limited: Vec<&String> = scene.warnings.iter().filter(|w| w.contains("limited")).collect();
    assert_eq!(limited.len(), 1, "{:?}", scene.warnings);
    assert_says(limited[0], &["2 material(s)", "\"white\" (1.00 to 0.90)", "\"blender\"", "--strict"]);
    assert!(scene.materials.iter().filter(|m| m.name != "spare").all(|m| m.total_albedo() <= 0.91));
    let blender = scene.material(2);
    assert_eq!((blender.albedo, blender.power), ([0.8, 0.4, 0.8], 250.0), "diffuse colours have precedence");
    assert!(blender.specular[0] >= 0.05 && blender.specular[0] <= 0.12, "{:?}", blender.specular);
    folder.load("m.obj", true).expect_err("strict");
}

#[test]
fn missing_materials_are_grey_with_one_warning() {
    let obj = "mtllib lost.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 2\n";
    let folder = Folder::with(&[("m.obj", obj)]);
    let scene = folder.load("m.obj", false).expect("grey");
    assert!(scene.materials.iter().all(|m| m.albedo == [0.5; 3]));
    let said: Vec<&String> = scene.warnings.iter().filter(|w| w.contains("lost.mtl")).collect();
    assert_eq!(said.len(), 1, "{:?}", scene.warnings);
    assert_says(said[0], &["m.obj:5", "is missing", "\"a\", \"b\"", "grey"]);
}

#[test]
fn what_is_ignored_is_listed_once() {
    let mtl = format!("{MTL}d 0.5\nTr 0\nmap_bump a.png\nnewmtl c\nd 0.2\nTf 1 1 1\nNi 1.5\nd 1\n");
    let warnings = super::good("s.toml", &[("m.mtl", &mtl)]).warnings;
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert_says(&warnings[0], &["m.mtl:6", "ignored", "`d` (2 times), `map_bump`"]);
}

#[test]
fn single_faces_of_a_closed_shell_are_turned() {
    // A box before a lamp, two of whose quads are turned.
    let good = format!("{}{}", block(0, [0.0; 3], [1.0; 3], false, &[]), lamp(8, 3.0, 1.0, true));
    let mut lines: Vec<String> = good.lines().map(str::to_owned).collect();
    let faces: Vec<usize> = (0..lines.len()).filter(|&k| lines[k].starts_with('f')).collect();
    for &k in &faces[1..3] {
        let mut words: Vec<&str> = lines[k].split_whitespace().collect();
        words[1..].reverse();
        lines[k] = words.join(" ");
    }
    let bad = lines.join("\n");
    let (truth, mended) = (auto(&good), auto(&bad));
    assert!(truth.warnings.iter().all(|w| !w.contains("turned")), "{:?}", truth.warnings);
    assert!((volume(&mended, 0..12) - 1.0).abs() < 1e-12);
    let note = mended.warnings.iter().find(|w| w.contains("turned")).expect("a note");
    assert_says(note, &["4 of mesh \"m\"", "--orient keep"]);
    let kept = load(&bad, &LoadOptions::default().orient(Orient::Keep));
    assert!((volume(&kept, 0..12) - 1.0).abs() > 0.1);
}

#[test]
fn shells_that_are_inside_out_are_turned_towards_the_light() {
    let [low, high] = UNIT;
    // A room with a lamp in it, and one without its front wall; a block under a lamp; a bulb over a block.
    for (open, name) in [(&[][..], "closed room"), (&[5][..], "open room")] {
        let wrong = auto(&format!("{}{}", block(0, low, high, false, open), lamp(8, 0.99, 0.3, true)));
        let walls = wrong.triangles.len() - 2;
        assert!(volume(&wrong, 0..walls) < -0.3, "{name}: {:?}", wrong.warnings);
        let right = auto(&format!("{}{}", block(0, low, high, true, open), lamp(8, 0.99, 0.3, true)));
        assert!(right.warnings.iter().all(|w| !w.contains("turned")), "{name}: {:?}", right.warnings);
        assert!(irradiance(&wrong, 4) > 0.01, "{name}");
    }
    let under = auto(&format!("{}{}", block(0, low, high, true, &[]), lamp(8, 2.0, 0.5, true)));
    assert!(volume(&under, 0..12) > 0.99);
    let bulb = |inwards| {
        let bulb = block(8, [0.4, 2.0, 0.4], [0.6, 2.2, 0.6], inwards, &[]);
        auto(&format!("{}usemtl lamp\n{bulb}", block(0, low, high, false, &[])))
    };
    for scene in [bulb(true), bulb(false)] {
        assert!(volume(&scene, 0..12) > 0.99 && volume(&scene, 12..24) > 0.007);
    }
    // A luminous sphere from inside and from outside may both be meant.
    for inwards in [false, true] {
        let alone = auto(&format!("usemtl lamp\n{}", block(0, low, high, inwards, &[])));
        assert_eq!(volume(&alone, 0..12) < 0.0, inwards);
    }
}

#[test]
fn sheets_have_two_sides_where_that_is_said() {
    // A sheet between a floor and a lamp; a closed block needs no second side.
    let sheet = "v 0 1 0\nv 1 1 0\nv 1 1 1\nv 0 1 1\nf 1 2 3 4\n";
    let text = format!(
        "{sheet}{}{}",
        block(4, [2.0, 0.0, 0.0], [3.0, 1.0, 1.0], false, &[]),
        lamp(12, 2.0, 0.8, true)
    );
    let one = auto(&text);
    let two = load(&text, &LoadOptions::default().two_sided(true));
    assert_eq!((one.triangles.len(), two.triangles.len()), (16, 16 + 2 + 2));
    assert_eq!(two.triangles[..16], one.triangles[..]);
    for (second, first) in [(16, 0), (17, 1), (18, 14), (19, 15)] {
        assert_eq!(two.area_vector(second), -two.area_vector(first));
        assert_eq!(two.material(second), two.material(first));
    }
    // The sheet faces down, away from the lamp: its second side receives what its back did.
    let tracer = PathTracer::new(&one);
    let (before, after) = (tracer.irradiance_of_back(0, 4096), PathTracer::new(&two).irradiance_of(16, 4096));
    assert!(
        (before.mean - after.mean).abs().max_element() <= 5.0 * (before.error + after.error).max_element()
    );
    assert!(after.mean.x > 0.1 && irradiance(&two, 0) < 0.1 * after.mean.x, "{after:?}");

    let toml = |keys: &str| {
        format!(
            "[[mesh]]\npath = \"m.obj\"\n{keys}\n[camera.main]\nposition = [0, 0, 5]\ntarget = [0, 0, 0]\nfov_x_degrees = 40\nwidth = 4\nheight = 4\n"
        )
    };
    let obj = format!("mtllib m.mtl\nusemtl white\n{text}");
    let count = |keys: &str, more: &str| {
        let folder = Folder::with(&[("m.obj", &obj), ("s.toml", &format!("{}{more}", toml(keys)))]);
        folder.load("s.toml", false).expect("a scene").triangles.len()
    };
    assert_eq!(count("two_sided = true", ""), 20);
    assert_eq!(count("", "[material.white]\ntwo_sided = true\n"), 18);
    assert_eq!(count("two_sided = false", "[material.white]\ntwo_sided = true\n"), 16);
    // A saved scene has its second sides already.
    let folder = Folder::with(&[]);
    let path = folder.0.path().join("saved.toml");
    two.save(&path).expect("written");
    let again = Scene::load(&path, &LoadOptions::default().two_sided(true)).expect("a scene");
    assert_eq!(again.triangles, two.triangles);
}

#[test]
fn the_automatic_camera_sees_fronts() {
    let [low, high] = UNIT;
    let sees = |scene: &Scene| {
        let picture = PathTracer::new(scene).picture(&scene.cameras[0], 4, 0);
        let lit = picture.pixels.iter().filter(|p| p.radiance.mean.x > 0.0).count();
        lit as f64 / picture.pixels.len() as f64
    };
    let closed = auto(&format!("{}{}", block(0, low, high, true, &[]), lamp(8, 0.99, 0.3, true)));
    let at = closed.cameras[0].position;
    assert!(at.cmpgt(DVec3::ZERO).all() && at.cmplt(DVec3::ONE).all(), "{at}");
    assert!(sees(&closed) > 0.9, "{}", sees(&closed));
    // A room open to any side is seen from there.
    for open in [0, 1, 4, 5] {
        let room = auto(&format!("{}{}", block(0, low, high, true, &[open]), lamp(8, 0.99, 0.3, true)));
        assert!(sees(&room) > 0.2, "{open}: {}", sees(&room));
    }
}

#[test]
fn black_pictures_say_why() {
    let said = |scene: &Scene, parts: &[&str]| {
        let all = scene.warnings.join("\n");
        assert!(parts.iter().all(|part| all.contains(part)), "{parts:?} is missing in: {all}");
    };
    let floor = "v 0 0 0\nv 0 0 1\nv 1 0 1\nv 1 0 0\nf 1 2 3 4\n";
    said(&auto(floor), &["no light", "black"]);
    said(
        &auto(&format!("{floor}{}", lamp(4, 1.0, 0.5, false))),
        &["lamps of mesh \"m\" face nothing", "two_sided"],
    );
    let right = auto(&format!("{floor}{}", lamp(4, 1.0, 0.5, true)));
    assert!(right.warnings.iter().all(|w| w.contains("No camera")), "{:?}", right.warnings);
    // A lamp just under a ceiling that shines upwards.
    let [low, high] = UNIT;
    let up = auto(&format!("{}{}", block(0, low, high, true, &[]), lamp(8, 0.995, 0.3, false)));
    said(&up, &["face a surface", "m away"]);
    let camera = |position: &str, target: &str| {
        let toml = format!(
            "[[mesh]]\npath = \"m.obj\"\n[camera.main]\nposition = {position}\ntarget = {target}\nfov_x_degrees = 40\nwidth = 4\nheight = 4\n"
        );
        let obj = format!(
            "mtllib m.mtl\nusemtl white\n{}{}",
            block(0, low, high, true, &[]),
            lamp(8, 0.99, 0.3, true)
        );
        Folder::with(&[("s.toml", &toml), ("m.obj", &obj)]).load("s.toml", false).expect("a scene")
    };
    said(&camera("[0.5, 0.5, 3]", "[0.5, 0.5, 9]"), &["Camera \"main\" sees nothing"]);
    said(&camera("[0.5, 0.5, 3]", "[0.5, 0.5, 0]"), &["Camera \"main\"", "backs of triangles"]);
    assert_eq!(camera("[0.5, 0.5, 0.9]", "[0.5, 0.5, 0]").warnings, [""; 0]);
}

/// Light is the same in metres and in millimetres.
#[test]
fn units_do_not_matter() {
    let room = |scale: f64| {
        let [low, high] = UNIT.map(|corner| corner.map(|x| x * scale));
        let block = block(0, low, high, true, &[5]);
        let lamp = lamp(8, 0.9, 0.3, true);
        let lamp = lamp.lines().map(|line| match line.strip_prefix("v ") {
            Some(numbers) => {
                let scaled =
                    numbers.split(' ').map(|x| (x.parse::<f64>().expect("a number") * scale).to_string());
                format!("v {}\n", scaled.collect::<Vec<_>>().join(" "))
            }
            None => format!("{line}\n"),
        });
        auto(&format!("{block}{}", lamp.collect::<String>()))
    };
    let (metres, millimetres) = (room(1.0), room(1000.0));
    for t in 0..metres.triangles.len() {
        let [a, b] = [&metres, &millimetres].map(|scene| irradiance(scene, t));
        assert!((a - b).abs() <= 1e-6 * (1.0 + a), "{a} {b}");
    }
    assert!((1000.0 * metres.cameras[0].position).abs_diff_eq(millimetres.cameras[0].position, 1e-6));
}
