//! OBJ and MTL files.

use glam::DVec3;

use super::{Folder, MTL, assert_refused, assert_says, good, with_mesh};

#[test]
fn broken_obj_lines() {
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    for (text, parts) in [
        ("v 0 0", vec!["m.obj:1", "fewer than 3", "v x y z"]),
        ("# a\n\nv 0 zero 0", vec!["m.obj:3", "`zero` is not a number"]),
        ("v 0 nan 0", vec!["m.obj:1", "`nan` is not finite"]),
        ("v 0 0 inf", vec!["m.obj:1", "`inf` is not finite"]),
        ("v 0 0 1e999", vec!["m.obj:1", "`1e999` is not finite"]),
        ("f 1 2 3", vec!["m.obj:1", "before any vertex"]),
        ("f 1 2 4", vec!["m.obj:4", "index 4 is out of range", "1 to 3"]),
        ("f 1 2 0", vec!["m.obj:4", "index 0 is out of range"]),
        ("f 1 2 -4", vec!["m.obj:4", "index -4 is out of range", "-3 to -1"]),
        ("f 1 2 99999999999999999999", vec!["m.obj:4", "not a vertex index"]),
        ("f 1 2 /3", vec!["m.obj:4", "`/3` is not a vertex index", "v/vt"]),
        ("f 1 2 1.5", vec!["m.obj:4", "`1.5` is not a vertex index"]),
        ("f 1 2", vec!["m.obj:4", "2 corner(s)", "at least 3"]),
        ("f", vec!["m.obj:4", "0 corner(s)"]),
        ("usemtl", vec!["m.obj:4", "usemtl NAME"]),
        ("mtllib", vec!["m.obj:4", "mtllib FILE.mtl"]),
    ] {
        let alone = parts[0] != "m.obj:4";
        let text = if alone { text.to_owned() } else { format!("{triangle}{text}") };
        assert_refused("m.obj", &text, &parts);
    }
}

#[test]
fn broken_mtl_lines() {
    for (text, parts) in [
        ("Kd 1 1 1", vec!["m.mtl:1", "before any material", "newmtl"]),
        ("newmtl", vec!["m.mtl:1", "newmtl NAME"]),
        ("newmtl a\nnewmtl a", vec!["m.mtl:2", "\"a\" is already defined at line 1"]),
        ("newmtl a\nKd 1 1", vec!["m.mtl:2", "2 numbers", "Kd r g b"]),
        ("newmtl a\nKe 1 x 1", vec!["m.mtl:2", "`x` is not a number"]),
        ("newmtl a\nNs nan", vec!["m.mtl:2", "`nan` is not finite"]),
        ("newmtl a\nNs 1 2", vec!["m.mtl:2", "2 numbers; expected one"]),
    ] {
        assert_refused("m.mtl", text, &parts);
    }
    let mtl = format!("{MTL}Ka 1 1 1\nillum 2\nKb 1 1 1\nmap_Kd wood.png\n");
    let warnings = good("s.toml", &[("m.mtl", &mtl)]).warnings.join("\n");
    for part in
        ["m.mtl:8: unknown key `Kb` is ignored; did you mean `K", "m.mtl:9: texture", "wood.png is missing"]
    {
        assert!(warnings.contains(part), "`{part}` is missing in: {warnings}");
    }
    assert_eq!(warnings.lines().count(), 2, "{warnings}");
}

#[test]
fn obj_forms() {
    let corners = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nv .2 1 0\nvt 0 0\nvn 0 0 1\n";
    for (faces, triangles) in [
        ("f 1 2 3 4", 2),
        ("f -5 -4 -3 -2", 2),
        ("f 1/1 2/1 3/1 4/1", 2),
        ("f 1//1 2//1 3//1 4//1", 2),
        ("f 1/1/1 2/1/1 3/1/1 4/1/1", 2),
        ("f 1 2 3 4 5", 3),
        ("f 1 2 \\\r\n 3 4\r", 2),
        ("o a\ng b\ns off\nl 1 2\np 1\nf 1 2 3 # one\nf 1 3 4", 2),
    ] {
        let scene = good("m.obj", &[("m.obj", &format!("{corners}{faces}\n"))]);
        assert_eq!(scene.triangles.len(), triangles, "{faces}");
        let area: DVec3 =
            (0..triangles).map(|t| scene.corners(t)).map(|[a, b, c]| (b - a).cross(c - a) / 2.0).sum();
        let expected = if triangles == 3 { 4.0 - 0.2 } else { 4.0 };
        assert!(area.abs_diff_eq(DVec3::Z * expected, 1e-12), "{faces}: {area}");
        assert!(scene.degenerate.is_empty(), "{faces}");
    }
}

/// As some editors of Windows save it.
#[test]
fn text_in_utf_16_is_read() {
    let text = "\u{feff}v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl Wände\nf 1 2 3\n";
    for order in [u16::to_le_bytes, u16::to_be_bytes] {
        let folder = Folder::with(&[]);
        let bytes: Vec<u8> = text.encode_utf16().flat_map(order).collect();
        std::fs::write(folder.0.path().join("m.obj"), bytes).expect("written");
        let scene = folder.load("m.obj", false).expect("a mesh");
        assert_eq!((scene.triangles.len(), scene.material(0).name.as_str()), (1, "Wände"));
    }
}

/// As MeshLab and Blender write them, in sRGB, where no material is stated; elsewhere they are named.
#[test]
fn colours_of_vertices_are_albedos() {
    let obj =
        "v 0 0 0 .5 0 0\nv 1 0 0 .5 0 0\nv 0 1 0 .5 .5 0\nv 0 0 1 1.0\nusemtl paint\nf 1 2 3\nf 1 2 4\n";
    let scene = good("m.obj", &[("m.obj", obj)]);
    let albedos: Vec<_> = (0..2).map(|t| scene.material(t).albedo).collect();
    let half = ((0.5_f64 + 0.055) / 1.055).powf(2.4);
    let expected = [[half, half / 3.0, 0.0], [(2.0 * half + 0.5) / 3.0, 0.5 / 3.0, 0.5 / 3.0]];
    for (found, expected) in albedos.iter().flatten().zip(expected.iter().flatten()) {
        assert!((found - expected).abs() < 1e-9, "{albedos:?}");
    }
    assert!(scene.warnings.iter().all(|said| !said.contains("grey")), "{:?}", scene.warnings);
    let stated = format!("mtllib m.mtl\n{}", obj.replace("paint", "white"));
    let files = [("m.obj", stated.as_str()), ("m.mtl", "newmtl white\nKd 0.75 0.75 0.75\n")];
    let scene = good("m.obj", &files);
    assert_eq!(scene.material(0).albedo, [0.75; 3]);
    assert_says(&scene.warnings[0], &["m.obj", "vertex 1", "ignored"]);
}

#[test]
fn faces_without_material_are_grey() {
    let no_mtl = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nusemtl wood\nf 1 3 2\n";
    let scene = good("m.obj", &[("m.obj", no_mtl)]);
    assert_eq!(scene.materials.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["default", "wood"]);
    assert!(scene.materials.iter().all(|m| m.albedo == [0.5; 3] && m.diffuse == 1.0));
    assert_says(&scene.warnings[0], &["m.obj:4", "before any usemtl", "grey"]);
    assert_says(&scene.warnings[1], &["m.obj:5", "\"wood\"", "grey"]);
    // The scene file may define it instead.
    let table = with_mesh("[material.wood]\nalbedo = 0.2\nemission = 1\n[material.default]\nalbedo = 0.3\n");
    let scene = good("s.toml", &[("m.obj", no_mtl), ("s.toml", &table)]);
    assert_eq!((scene.material(0).albedo, scene.material(1).albedo), ([0.3; 3], [0.2; 3]));
    assert_eq!(scene.warnings, [""; 0]);
}
