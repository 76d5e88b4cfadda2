//! Checks of every scene, from files and in memory.

use antirad::scene::{Camera, Material, Scene, Triangle};
use glam::DVec3;

use super::{Folder, MTL, OBJ, TOML, assert_refused, assert_says, good, load, with_mesh};

#[test]
fn a_scene_without_camera_gets_one_that_frames_it() {
    let scene = good("m.obj", &[]);
    assert_eq!((scene.cameras.len(), scene.cameras[0].name.as_str()), (1, "auto"));
    assert!(scene.warnings.iter().any(|w| w.contains("\"auto\"")), "{:?}", scene.warnings);
    let camera = &scene.cameras[0];
    let view = (camera.target - camera.position).normalize();
    for &vertex in &scene.vertices {
        let cos = (vertex - camera.position).normalize().dot(view);
        assert!(cos > (camera.fov_x_degrees / 2.0).to_radians().cos() - 1e-9);
    }
}

#[test]
fn bad_materials() {
    for (table, parts) in [
        ("[material.white]\nalbedo = [-0.1, 0, 0]", vec!["s.toml:9", "\"white\"", "albedo is -0.1"]),
        ("[material.white]\nspecular = -1", vec!["s.toml:9", "specular is -1"]),
        ("[material.white]\npower = inf", vec!["s.toml:9", "power is inf"]),
        ("[material.white]\npower = 2e5", vec!["s.toml:9", "power is 200000", "100000"]),
        ("[material.white]\nemission = -2", vec!["s.toml:9", "emission is -2"]),
        ("[material.white]\nemission = 1e308", vec!["s.toml:9", "emission is 1e308", "1e100", "larger unit"]),
        ("[material.white]\nalbedo = 1", vec!["s.toml:9", "\"white\"", "diffuse albedo is 1.000"]),
        (
            "[material.white]\nspecular = 0.2\npower = 50",
            vec![
                "s.toml:9",
                "\"white\"",
                "total albedo is 1.2",
                "specular by less than 0.6",
                "normalization = \"energy\"",
            ],
        ),
    ] {
        assert_refused("s.toml", &with_mesh(table), &parts);
    }
    // Without an override the error names the MTL. Remedies: the energy factor, or not using the material.
    let glossy = "newmtl lamp\nKd .5 .5 .5\nKe 1 1 1\nnewmtl white\nKd .5 .5 .5\nKs .2 .2 .2\nNs 50\n";
    let strict = Folder::with(&[("m.mtl", glossy)]).load("s.toml", true).expect_err("strict");
    assert_says(&strict.to_string(), &["m.mtl:4", "\"white\"", "total albedo is 1.2"]);
    let energy = with_mesh("[material.white]\nnormalization = \"energy\"");
    assert_eq!(good("s.toml", &[("m.mtl", glossy), ("s.toml", &energy)]).warnings, [""; 0]);
    let unused = good("s.toml", &[("m.mtl", glossy), ("m.obj", &OBJ.replace("usemtl white\n", ""))]);
    assert!(unused.warnings[0].contains("\"white\", which no triangle uses: the total albedo is 1.2"));
}

#[test]
fn materials_that_meshes_disagree_about() {
    let two = with_mesh("[[mesh]]\npath = \"n.obj\"\n");
    let n = OBJ.replace("m.mtl", "n.mtl");
    let same = good("s.toml", &[("s.toml", &two), ("n.obj", &n), ("n.mtl", MTL)]);
    assert_eq!((same.materials.len(), same.triangles.len(), same.vertices.len()), (2, 4, 8));
    let other = MTL.replace("Kd .5", "Kd .4");
    let error =
        load("s.toml", &[("s.toml", &two), ("n.obj", &n), ("n.mtl", &other)]).expect_err("two whites");
    assert_says(&error.to_string(), &["n.mtl:1", "\"white\" is defined otherwise", "m.mtl:1"]);
}

#[test]
fn a_material_table_that_nothing_uses_is_said() {
    let scene = good("s.toml", &[("s.toml", &with_mesh("[material.whit]\nalbedo = 0.3\n"))]);
    assert_says(&scene.warnings.join(""), &["s.toml:9", "[material.whit]", "did you mean \"white\"?"]);
}

#[test]
fn triangles_without_area_are_dropped_or_refused() {
    let obj =
        format!("{OBJ}f 1 1 2\nf 2 2 2\nv 2 0 0\nf 1 2 5\nv 1 1e-14 0\nf 1 2 6\nv .5 1e-4 0\nf 1 2 7\n");
    let folder = Folder::with(&[("m.obj", &obj)]);
    let scene = folder.load("s.toml", false).expect("flat triangles are no error");
    assert_eq!(scene.triangles.len(), 7);
    assert_eq!(scene.degenerate, [2, 3, 4, 5], "a needle of 1 : 10000 has an area");
    assert_says(&scene.warnings.join(""), &["4 triangle(s) have no area", "triangle 2 of mesh \"m\""]);
    let error = folder.load("s.toml", true).expect_err("strict");
    assert_says(&error.to_string(), &["m.obj", "4 triangle(s) without area", "triangle 2 of mesh \"m\""]);
}

#[test]
fn area_is_judged_at_every_scale() {
    let scaled = |scale| TOML.replace("path = \"m.obj\"", &format!("path = \"m.obj\"\nscale = {scale}"));
    for scale in ["1e-60", "1e-30", "1e-3", "1e4", "1e30", "1e60"] {
        let scene = good("s.toml", &[("s.toml", &scaled(scale))]);
        // The camera does not move with the mesh.
        let other = |warning: &&String| !warning.contains("Camera \"main\" sees nothing");
        assert!(
            scene.degenerate.is_empty() && !scene.warnings.iter().any(|w| other(&w)),
            "{scale}: {:?}",
            scene.warnings
        );
    }
    for scale in ["1e-150", "1e150", "1e300"] {
        let size = format!("measures {:.3e} m", scale.parse::<f64>().expect("a number"));
        assert_refused("s.toml", &scaled(scale), &[size.as_str(), "1e-60 to 1e60 m", "scale its meshes"]);
    }
}

/// Regression: with a vertex at 1e30, in a triangle with or without area, all other triangles counted as duplicates of
/// each other.
#[test]
fn a_vertex_far_off_is_named() {
    for (far, x) in [("1e30 0 0", "1e30"), ("1e9 -7 2", "1e9")] {
        let text = format!("{OBJ}f 2 4 3\nv {far}\nf 2 3 5\n");
        assert_refused(
            "m.obj",
            &text,
            &["m.obj", "triangle 3 of mesh \"m\"", "vertex 4 is at", x, "correct or remove it"],
        );
    }
    // Small triangles in a large scene are no error.
    let text = format!("{OBJ}v 1e9 0 0\nv 0 1e9 0\nv 0 0 1e9\nf 5 6 7\nf 1 6 5\nf 1 7 6\n");
    let scene = good("m.obj", &[("m.obj", &text)]);
    let warnings = scene.warnings.join("\n");
    assert!(
        warnings.contains("2 triangle(s) are smaller than 1e-6 of the scene, which measures 1.000e9 m"),
        "{warnings}"
    );
}

#[test]
fn nothing_to_see() {
    let empty = "v 0 0 0\n";
    assert_refused("m.obj", empty, &["m.obj", "no triangles"]);
    assert_refused("s.toml", "", &["s.toml", "no triangles"]);
    let dark = good("s.toml", &[("m.mtl", &MTL.replace("Ke 1 1 1", ""))]);
    assert_says(&dark.warnings.join(""), &["no light", "black"]);
}

#[test]
fn scenes_in_memory_are_checked_too() {
    let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let lamp = Material { emission: [1.0; 3], ..Material::named("lamp") };
    let triangle = Triangle { vertices: [0, 1, 2], material: 0 };
    let new = |vertices, triangle, material| Scene::new("memory", vertices, vec![triangle], vec![material]);

    let mut scene = new(vertices.clone(), triangle, lamp.clone()).expect("a good scene");
    assert_eq!((scene.warnings.len(), scene.cameras.len(), scene.meshes.len()), (0, 0, 1));
    let camera = Camera::framing(&scene.vertices);
    scene.set_camera(camera.clone()).expect("a good camera");
    scene.set_camera(camera.clone()).expect("the same again");
    assert_eq!(scene.cameras.len(), 1);
    let error = scene.set_camera(Camera { width: 0, ..camera }).expect_err("no width");
    assert_says(&error.to_string(), &["\"auto\"", "width is 0"]);

    let nan = vec![DVec3::ZERO, DVec3::X, DVec3::NAN];
    let off = Triangle { vertices: [0, 1, 3], material: 0 };
    let bare = Triangle { material: 1, ..triangle };
    let bright = Material { albedo: [1.5; 3], ..lamp.clone() };
    for (result, parts) in [
        (new(nan, triangle, lamp.clone()), ["triangle 0 of mesh \"memory\"", "vertex 2", "finite"]),
        (new(vertices.clone(), off, lamp.clone()), ["triangle 0", "vertex index 3", "there are 3"]),
        (new(vertices.clone(), bare, lamp.clone()), ["triangle 0", "material index 1", "there are 1"]),
        (new(vertices, triangle, bright), ["material \"lamp\"", "1.500", "below 1"]),
        (Scene::new("memory", vec![], vec![], vec![]), ["no triangles", "mesh", "face"]),
    ] {
        assert_says(&result.expect_err(parts[0]).to_string(), &parts);
    }
}

#[test]
fn a_second_check_says_nothing_new() {
    let mut scene = good("m.obj", &[]);
    let warnings = scene.warnings.clone();
    scene.check(true).expect("still good");
    assert_eq!(scene.warnings, warnings);
}
