use super::*;
use crate::{LoadOptions, Material, SceneBuilder, Shape, bounds};
use glam::DAffine3;
use std::path::PathBuf;

const DISTANCE: f64 = 0.01;
/// Standard deviation of noise, m.
const NOISE: f64 = 0.003;

/// Numbers of a fixed sequence, about normally distributed.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn vector(&mut self) -> DVec3 {
        let mut normal = || (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0;
        NOISE * DVec3::new(normal(), normal(), normal())
    }
}

fn placed(size: [f64; 3], at: [f64; 3]) -> DAffine3 {
    DAffine3::from_translation(at.into()) * DAffine3::from_scale(size.into())
}

fn grey() -> Material {
    Material { albedo: [0.5; 3], ..Material::named("grey") }
}

/// A room of 4 x 2.5 x 3 m with a box on the floor and what else is built; each face of a flat side has copies of vertices of its own.
fn room(things: impl FnOnce(&mut SceneBuilder)) -> Scene {
    let mut builder = SceneBuilder::new();
    builder.shape("room", Shape::Room { cells: 12 }, &grey(), placed([4.0, 2.5, 3.0], [0.0; 3]));
    builder.shape("box", Shape::Box { cells: 4 }, &grey(), placed([0.8, 0.5, 0.6], [1.1, 0.0, 1.3]));
    things(&mut builder);
    let scene = builder.finish("room").expect("a scene");
    with_sides_apart(&scene)
}

/// A scene in which triangles share vertices only with those of their plane.
fn with_sides_apart(scene: &Scene) -> Scene {
    let mut apart = scene.clone();
    let mut copies = std::collections::HashMap::new();
    apart.vertices.clear();
    for t in 0..scene.triangles.len() {
        let normal = scene.area_vector(t).normalize();
        let key = (normal * 1e3).round().as_ivec3();
        let mesh = scene.meshes.iter().position(|m| m.range.contains(&(t as u32)));
        for corner in &mut apart.triangles[t].vertices {
            let place = scene.vertices[*corner as usize];
            let bits = place.to_array().map(f64::to_bits);
            *corner = *copies.entry((bits, key, mesh)).or_insert_with(|| {
                apart.vertices.push(place);
                apart.vertices.len() as u32 - 1
            });
        }
    }
    apart
}

fn noisy(scene: &Scene) -> Scene {
    let mut noise = Noise(7);
    let mut noisy = scene.clone();
    noisy.vertices.iter_mut().for_each(|v| *v += noise.vector());
    noisy
}

/// The largest distance of corners of some triangles from the plane that fits them.
fn off_plane(scene: &Scene, triangles: &[usize]) -> f64 {
    let surface = Surface {
        distance: DISTANCE,
        points: scene.vertices.clone(),
        triangles: triangles.iter().map(|&t| scene.triangles[t].vertices).collect(),
        emitter: vec![None; triangles.len()],
    };
    let all: Vec<u32> = (0..triangles.len() as u32).collect();
    let plane = Plane::fitted(&surface, &all);
    surface.points_of_triangles().map(|p| plane.height(p).abs()).fold(0.0, f64::max)
}

impl Surface {
    fn points_of_triangles(&self) -> impl Iterator<Item = DVec3> {
        (0..self.triangles.len() as u32).flat_map(|t| self.corners(t))
    }
}

/// Of a scene, the triangles of each mesh and side.
fn flat_sides(scene: &Scene) -> Vec<Vec<usize>> {
    let mut sides = std::collections::BTreeMap::new();
    for t in 0..scene.triangles.len() {
        let key = (scene.area_vector(t).normalize() * 1e3).round().as_ivec3().to_array();
        let mesh = scene.meshes.iter().position(|m| m.range.contains(&(t as u32)));
        sides.entry((mesh, key)).or_insert_with(Vec::new).push(t);
    }
    sides.into_values().collect()
}

/// Walls and the sides of the box become planar, the borders of each end at the planes beside them, and no triangle turns over.
#[test]
fn a_noisy_room_is_flat_and_closed() {
    let clean = room(|_| ());
    let mut scene = noisy(&clean);
    let given = scene.clone();
    let report = snap(&mut scene, DISTANCE, |_| true);
    let sides = flat_sides(&clean);
    assert!(sides.len() == 12 && (11..=12).contains(&report.planes), "{report:?}");
    assert!(report.farthest <= FARTHEST * DISTANCE, "{report:?}");
    for side in &sides {
        let off = off_plane(&scene, side);
        assert!(off <= 1e-9, "{off}");
    }
    // What lay on several planes does so again.
    let planes: Vec<(Plane, usize)> = sides
        .iter()
        .map(|side| {
            let surface = Surface {
                distance: DISTANCE,
                points: scene.vertices.clone(),
                triangles: side.iter().map(|&t| scene.triangles[t].vertices).collect(),
                emitter: vec![None; side.len()],
            };
            let all: Vec<u32> = (0..side.len() as u32).collect();
            (Plane::fitted(&surface, &all), side[0])
        })
        .collect();
    for (v, place) in clean.vertices.iter().enumerate() {
        for (plane, first) in &planes {
            let [a, _, _] = clean.corners(*first);
            let within = |k: usize| {
                let (low, high) = bounds(
                    sides
                        .iter()
                        .find(|side| side[0] == *first)
                        .into_iter()
                        .flatten()
                        .flat_map(|&t| clean.corners(t)),
                );
                place[k] >= low[k] - 1e-9 && place[k] <= high[k] + 1e-9
            };
            let on = (*place - a).dot(clean.area_vector(*first).normalize()).abs() <= 1e-9;
            if on && (0..3).all(within) {
                let off = plane.height(scene.vertices[v]).abs();
                assert!(off <= 1e-9, "{place} is {off} off");
            }
        }
    }
    for t in 0..scene.triangles.len() {
        assert!(scene.area_vector(t).dot(clean.area_vector(t)) > 0.0);
        assert_eq!(scene.triangles[t], given.triangles[t]);
    }
}

/// A ball that is large against the noise, and one that is not, stay as they are.
#[test]
fn a_noisy_ball_stays_round() {
    for (radius, level) in [(0.5, 4), (0.12, 3)] {
        let mut builder = SceneBuilder::new();
        let ball = Shape::Icosphere { level, inward: false };
        builder.shape("ball", ball, &grey(), placed([radius; 3], [0.0; 3]));
        let clean = builder.finish("ball").expect("a scene");
        let mut scene = noisy(&clean);
        let given = scene.clone();
        let report = snap(&mut scene, DISTANCE, |_| true);
        assert_eq!((report.planes, report.moved), (0, 0), "{radius}");
        assert_eq!(scene.vertices, given.vertices);
    }
}

/// Exact scenes stay, with what stands on them, what is close to a wall, and what is curved.
#[test]
fn a_clean_scene_stays() {
    let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
    let mut scene = room(|builder| {
        let ball = Shape::Icosphere { level: 3, inward: false };
        builder.shape("ball", ball, &grey(), placed([0.2; 3], [3.0, 0.8, 1.0]));
        builder.shape("bulb", ball_of(1), &lamp, placed([0.04; 3], [2.0, 1.5, 1.0]));
        builder.shape("panel", Shape::Slab { cells: 2 }, &lamp, placed([0.8, 0.02, 0.8], [2.0, 2.45, 1.0]));
    });
    let given = scene.clone();
    let report = snap(&mut scene, DISTANCE, |_| true);
    assert!(report.farthest <= 1e-9, "{report:?}");
    for (now, before) in scene.vertices.iter().zip(&given.vertices) {
        assert!(now.distance(*before) <= 1e-9);
    }
}

fn ball_of(level: u32) -> Shape {
    Shape::Icosphere { level, inward: false }
}

/// A noisy lamp of a flat sheet has a convex border in a plane, and a noisy bulb is convex.
#[test]
fn noisy_lamps_are_convex() {
    let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
    let mut builder = SceneBuilder::new();
    builder.shape("sheet", Shape::Quad { cells: 4 }, &lamp, placed([0.8; 3], [0.0; 3]));
    builder.shape("bulb", ball_of(1), &lamp, placed([0.05; 3], [0.0, 1.0, 0.0]));
    let mut scene = noisy(&builder.finish("lamps").expect("a scene"));
    snap(&mut scene, DISTANCE, |_| true);
    let sheet: Vec<usize> = (0..32).collect();
    assert!(off_plane(&scene, &sheet) <= 1e-9);
    let bulb = scene.meshes[1].range.clone();
    let corners: Vec<DVec3> = bulb.clone().flat_map(|t| scene.corners(t as usize)).collect();
    for t in bulb {
        let ([a, _, _], normal) = (scene.corners(t as usize), scene.area_vector(t as usize).normalize());
        assert!(corners.iter().all(|c| (*c - a).dot(normal) <= 1e-9));
    }
}

/// A mesh of a file that ends with the test.
fn refused(snap: &str) -> String {
    let folder = tempdir();
    let file = folder.join("s.toml");
    let text = format!(
        "[[mesh]]\nshape = {{ kind = \"room\", cells = 2 }}\nmaterial = \"a\"\nsnap = {snap}\n[material.a]\nalbedo = 0.5"
    );
    std::fs::write(&file, text).expect("a file");
    let error = Scene::load(&file, &LoadOptions::default()).expect_err(snap).to_string();
    std::fs::remove_dir_all(folder).expect("a folder");
    error
}

fn tempdir() -> PathBuf {
    let folder = std::env::temp_dir().join(format!("antirad-snap-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

#[test]
fn bad_distances_are_refused() {
    for (snap, said) in [
        ("-0.01", "no distance"),
        ("0", "no distance"),
        ("nan", "no distance"),
        ("inf", "no distance"),
        ("0.2", "a tenth"),
    ] {
        let error = refused(snap);
        assert!(error.contains("s.toml:4") && error.contains(said), "{error}");
    }
}
