use super::super::{LoadOptions, Scene, Shape};
use super::*;
use std::fmt::Write;
use std::path::Path;

/// Cells along each side of a wall.
const CELLS: u32 = 65;
const SIZE: [f64; 3] = [4.0, 2.5, 3.0];
const MOST: u32 = 600;

/// A room whose walls are rough by 3 mm: the floor is an object of its own with texture coordinates, the lower half of the rest is red, and
/// there is a window in the ceiling.
fn rough_room() -> String {
    let (vertices, faces) = Shape::Room { cells: CELLS }.mesh();
    let size = DVec3::from(SIZE);
    let mut text = String::from("mtllib room.mtl\n");
    let mut state = 1u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        6e-3 * ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5)
    };
    for place in &vertices {
        // Along the normals of walls alone, so that texture coordinates stay true.
        let inner = |k: usize| place[k] > 1e-9 && place[k] < 1.0 - 1e-9;
        let walls = (0..3).filter(|&k| !inner(k)).count();
        let off = DVec3::from([0, 1, 2].map(|k| if !inner(k) && walls == 1 { noise() } else { 0.0 }));
        let [x, y, z] = (*place * size + off).to_array();
        writeln!(text, "v {x:?} {y:?} {z:?}\nvt {:?} {:?}", place.x, place.z).expect("a string");
    }
    let middle = |face: &[u32; 3]| face.iter().map(|&v| vertices[v as usize]).sum::<DVec3>() / 3.0;
    let is_window = |at: DVec3| at.y > 1.0 - 1e-9 && (at.x - 0.5).abs() < 0.2 && (at.z - 0.5).abs() < 0.2;
    let (floor, rest): (Vec<[u32; 3]>, Vec<[u32; 3]>) =
        faces.iter().copied().filter(|face| !is_window(middle(face))).partition(|face| middle(face).y < 1e-9);
    text += "o floor\nusemtl white\n";
    for [a, b, c] in floor.into_iter().map(|face| face.map(|v| v + 1)) {
        writeln!(text, "f {a}/{a} {b}/{b} {c}/{c}").expect("a string");
    }
    text += "o rest\n";
    for face in rest {
        let [a, b, c] = face.map(|v| v + 1);
        let material = if middle(&face).y < 0.5 { "red" } else { "white" };
        writeln!(text, "usemtl {material}\nf {a} {b} {c}").expect("a string");
    }
    text
}

fn load(folder: &Path, obj: &str, keys: &str) -> Result<Scene, String> {
    std::fs::write(folder.join("room.obj"), obj).expect("written");
    std::fs::write(folder.join("room.mtl"), "newmtl white\nKd .8 .8 .8\nnewmtl red\nKd .5 .1 .1\n")
        .expect("written");
    let toml = format!("[[mesh]]\npath = \"room.obj\"\nobjects = true\n{keys}\n");
    std::fs::write(folder.join("room.toml"), toml).expect("written");
    Scene::load(&folder.join("room.toml"), &LoadOptions::default()).map_err(|error| error.to_string())
}

fn area(scene: &Scene, of: impl Fn(usize) -> bool) -> f64 {
    (0..scene.triangles.len()).filter(|&t| of(t)).map(|t| scene.area_vector(t).length()).sum()
}

fn close(found: f64, expected: f64, share: f64) -> bool {
    let close = (found - expected).abs() <= share * expected.abs();
    if !close {
        eprintln!("{found} is not {expected} within {share}");
    }
    close
}

#[test]
fn a_rough_room_of_fifty_thousand_triangles_becomes_one_of_hundreds() {
    let folder = tempfile::tempdir().expect("a folder");
    let obj = rough_room();
    let keys = format!("snap = 0.01\nsimplify = {MOST}");
    let scene = load(folder.path(), &obj, &keys).expect("a scene");
    let count = scene.triangles.len();
    assert!((MOST as usize / 2..=MOST as usize).contains(&count), "{count} triangles: {:?}", scene.warnings);
    assert!(scene.warnings.iter().any(|note| note.contains("mm off")), "{:?}", scene.warnings);

    // Shape, borders and regions.
    let [x, y, z] = SIZE;
    let window = {
        let cells =
            (0..CELLS).filter(|&k| ((f64::from(k) + 0.5) / f64::from(CELLS) - 0.5).abs() < 0.2).count();
        (cells as f64 / f64::from(CELLS)).powi(2)
    };
    let (floor, walls) = (x * z, 2.0 * y * (x + z));
    let names: Vec<&str> = scene.meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    assert_eq!(names, ["floor", "rest"]);
    let on_floor = |t: usize| scene.meshes[0].range.contains(&(t as u32));
    let red = |t: usize| scene.material(t).name == "red";
    assert!(close(area(&scene, on_floor), floor, 5e-3));
    assert!(close(area(&scene, |_| true), floor * (2.0 - window) + walls, 5e-3));
    let volume: f64 = (0..count).map(|t| -scene.area_vector(t).dot(scene.corners(t)[0]) / 3.0).sum();
    let open = y * floor * window / 3.0;
    assert!(close(volume, x * y * z - open, 5e-3));
    // The border of red runs through the middle cells, in zigzag where they are cut.
    assert!(close(area(&scene, red), walls / 2.0, 0.03));
    let high = |t: usize| scene.corners(t).iter().map(|p| p.y).fold(0.0, f64::max);
    assert!((0..count).filter(|&t| red(t)).all(|t| high(t) < 0.53 * y));

    // Texture coordinates. Triangles stay regular: none is longer than a third of the room.
    for t in (0..count).filter(|&t| on_floor(t)) {
        let uvs = scene.patterns.uvs(t).expect("texture coordinates");
        for (uv, place) in uvs.iter().zip(scene.corners(t)) {
            assert!(uv.abs_diff_eq(DVec2::new(place.x / x, place.z / z), 1e-3), "{uv} at {place}");
        }
    }
    let longest = |t: usize| {
        let [a, b, c] = scene.corners(t);
        a.distance(b).max(b.distance(c)).max(c.distance(a))
    };
    let longest = (0..count).map(longest).fold(0.0, f64::max);
    assert!(longest < DVec3::from(SIZE).length() / 3.0, "{longest}");

    // The same input gives the same scene, and its values come back on the mesh of the file.
    let again = load(folder.path(), &obj, &keys).expect("a scene");
    assert_eq!((&scene.vertices, &scene.triangles), (&again.vertices, &again.triangles));
    let file = load(folder.path(), &obj, "").expect("a scene");
    let (given, rows) = scene.with_given_meshes().expect("simplified meshes");
    assert_eq!(given.meshes, file.meshes);
    let corners =
        |scene: &Scene| -> Vec<_> { (0..scene.triangles.len()).map(|t| scene.corners(t)).collect() };
    assert!(corners(&given) == corners(&file), "triangles of the file");
    let name = |scene: &Scene, t: usize| scene.material(t).name.clone();
    let wrong = area(&file, |t| {
        name(&file, t) != name(&given, t) || name(&given, t) != name(&scene, rows[t] as usize)
    });
    assert!(wrong < 0.01 * walls, "{wrong} m² with another material");
    for t in file.meshes[0].range.clone().map(|t| t as usize) {
        let [found, truth] = [&given, &file].map(|scene| scene.patterns.uvs(t).expect("texture coordinates"));
        let off = (0..3).map(|k| found[k].distance(truth[k])).fold(0.0, f64::max);
        assert!(off < 1e-3, "{off}");
    }
}

#[test]
fn only_files_with_too_many_triangles_are_simplified() {
    let folder = tempfile::tempdir().expect("a folder");
    let obj = rough_room();
    let all = load(folder.path(), &obj, "").expect("a scene").triangles.len();
    for (keys, expected) in [
        ("simplify = 0\nsnap = 0.01", all..=all),
        ("simplify = 100000", all..=all),
        // The default of scans.
        ("snap = 0.01", 9_000..=10_000),
    ] {
        let scene = load(folder.path(), &obj, keys).expect("a scene");
        assert!(expected.contains(&scene.triangles.len()), "{keys}: {} triangles", scene.triangles.len());
        assert_eq!(scene.given.is_some(), scene.triangles.len() < all, "{keys}");
    }
    let broken = obj.replacen("v 0.0", "v nan", 1);
    let refused = load(folder.path(), &broken, "simplify = 600").expect_err("a vertex nowhere");
    assert!(refused.contains("room.obj:2") && refused.contains("finite"), "{refused}");
}

#[test]
fn small_objects_do_not_vanish() {
    let folder = tempfile::tempdir().expect("a folder");
    let crumb = "o crumb\nusemtl red\nv 2 1 1\nv 2.001 1 1\nv 2 1.001 1\nv 2 1 1.001\nf -4 -2 -3\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n";
    let scene = load(folder.path(), &(rough_room() + crumb), "simplify = 600").expect("a scene");
    let last = scene.meshes.last().expect("meshes");
    assert!(last.name == "crumb" && !last.range.is_empty(), "{last:?}");
    let (given, rows) = scene.with_given_meshes().expect("simplified meshes");
    assert_eq!(given.meshes.last().map(|mesh| mesh.range.len()), Some(4));
    assert!(rows[rows.len() - 4..].iter().all(|row| last.range.contains(row)));
}

#[test]
fn seams_of_texture_coordinates_stay() {
    // A sheet of 40 x 40 cells, whose halves have charts of their own, and nothing that is no number.
    let n = 40;
    let at = |i: u32, j: u32| DVec3::new(f64::from(i), f64::from(j), 0.0) / f64::from(n);
    let corner = |place: DVec3, right: bool| Corner {
        place,
        uv: if right { DVec2::new(place.y, -place.x) } else { place.truncate() },
        colour: DVec3::ONE,
    };
    let cell = |i: u32, j: u32| {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [[a, b, c], [a, c, d]].map(|of| of.map(|place| corner(place, i >= n / 2)))
    };
    let triangles: Vec<[Corner; 3]> = (0..n).flat_map(|i| (0..n).flat_map(move |j| cell(i, j))).collect();
    let left = simplified(&triangles, &vec![0; triangles.len()], 64);
    assert!((16..=64).contains(&left.len()), "{} triangles", left.len());
    let mut areas = [0.0; 2];
    for face in left {
        let corners = face.map(|(t, k)| triangles[t as usize][k]);
        let [a, b, c] = corners.map(|corner| corner.place);
        let right = (a.x + b.x + c.x) / 3.0 > 0.5;
        areas[usize::from(right)] += (b - a).cross(c - a).z / 2.0;
        for own in corners {
            assert_eq!(own.uv, corner(own.place, right).uv);
        }
    }
    assert!(areas.iter().all(|&area| close(area, 0.5, 1e-9)), "{areas:?}");
}
