//! Millions of rays a second of one core, by the time that the processor spends on them, the best of several runs: diffuse rays that leave all over
//! fronts and look for what they meet, and shadow rays from fronts to lamps.
//!
//! `cargo bench --bench rays -- MESH.obj...` takes OBJ files, by default `scenes/cornell_boxes.obj`; lamps are what the MTL file beside lets emit,
//! else a hundredth of the triangles. `-- leaks` counts rays that escape from a closed box, of ten million each.
//!
//! The harness is its own, since a rate of many rays is asked for, not the time of one.

use antirad_rays::Rays;
use glam::{DMat3, DVec3};
use std::collections::{HashMap, HashSet};
use std::f64::consts::TAU;
use std::path::Path;
use std::time::{Duration, Instant};

/// Rays of each kind, about, and of a triangle.
const RAYS: usize = 400_000;
const DIFFUSE: usize = 256;
const SHADOW: usize = 64;
/// The fastest counts, since other programs may use the machine.
const REPEATS: usize = 7;
/// Rays of each kind in the closed box.
const IN_BOX: usize = 10_000_000;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if arguments.iter().any(|argument| argument == "leaks") {
        return leaks();
    }
    let default = format!("{}/../../scenes/cornell_boxes.obj", env!("CARGO_MANIFEST_DIR"));
    let meshes = if arguments.is_empty() { vec![default] } else { arguments };
    println!(
        "{:>40} {:>9} {:>8} {:>10} {:>8} {:>8}",
        "million rays a second", "triangles", "build ms", "kB", "diffuse", "shadow"
    );
    meshes.iter().for_each(|path| measure(path));
}

fn measure(path: &str) {
    let (corners, lamps) = read(path).unwrap_or_else(|error| panic!("{path}: {error}"));
    let (diffuse, shadow) = (diffuse(&corners), shadow(&corners, &lamps));
    let build = || Rays::among(corners.clone(), |_| true);
    let (building, _) = fastest(build);
    for (how, rays) in [("", build()), ("portable", build().portable())] {
        let nearest = |ray: &Ray| rays.nearest(ray.from, ray.direction, Some(ray.triangle));
        let blocked = |ray: &Ray| rays.blocked(ray.from, ray.to, |t| t == ray.triangle || t == ray.lamp);
        let (to_nearest, found) =
            fastest(|| diffuse.iter().filter_map(nearest).map(|hit| hit.1).sum::<f64>());
        let (to_lamps, dark) = fastest(|| shadow.iter().filter(|ray| blocked(ray)).count());
        let rate = |rays: usize, time: Duration| rays as f64 / time.as_secs_f64() / 1e6;
        let name = format!("{} {how}", Path::new(path).file_name().unwrap_or_default().display());
        let (kilobytes, milliseconds) = (rays.bytes() / 1000, building.as_secs_f64() * 1e3);
        let rates = [rate(diffuse.len(), to_nearest), rate(shadow.len(), to_lamps)];
        println!(
            "{name:>40} {:>9} {milliseconds:>8.2} {kilobytes:>10} {:>8.2} {:>8.2}   (sum of distances {found:.6}, {dark} dark)",
            corners.len(),
            rates[0],
            rates[1],
        );
    }
}

/// The least time of some runs, and what they returned.
fn fastest<R>(work: impl Fn() -> R) -> (Duration, R) {
    let run = || {
        let start = now();
        let result = std::hint::black_box(work());
        (now() - start, result)
    };
    (1..REPEATS).fold(run(), |best, _| {
        let next = run();
        if next.0 < best.0 { next } else { best }
    })
}

/// The time that this thread ran, where the system says so, else the time of day.
fn now() -> Duration {
    let spent = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = spent.and_then(|text| text.split_whitespace().next()?.parse().ok());
    static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    nanoseconds.map_or_else(|| START.elapsed(), Duration::from_nanos)
}

/// A ray from a triangle, to a place on a lamp if it is a shadow ray.
struct Ray {
    from: DVec3,
    direction: DVec3,
    triangle: usize,
    to: DVec3,
    lamp: usize,
}

/// Cosine-distributed rays from fronts.
fn diffuse(corners: &[[DVec3; 3]]) -> Vec<Ray> {
    let mut random = Random(1);
    let mut rays = Vec::new();
    for triangle in some(corners, DIFFUSE) {
        let normal = normal(corners[triangle]);
        let (x, y) = normal.any_orthonormal_pair();
        for _ in 0..DIFFUSE {
            let (u, (sin, cos)) = (random.next(), (TAU * random.next()).sin_cos());
            let direction = u.sqrt() * (cos * x + sin * y) + (1.0 - u).sqrt() * normal;
            let from = random.on(corners[triangle]);
            rays.push(Ray { from, direction: direction.normalize(), triangle, to: from, lamp: triangle });
        }
    }
    rays
}

/// Rays from fronts to fronts of lamps.
fn shadow(corners: &[[DVec3; 3]], lamps: &[usize]) -> Vec<Ray> {
    let mut random = Random(2);
    let mut rays = Vec::new();
    for triangle in some(corners, SHADOW) {
        for _ in 0..SHADOW {
            let lamp = lamps[(random.next() * lamps.len() as f64) as usize];
            let (from, to) = (random.on(corners[triangle]), random.on(corners[lamp]));
            let direction = (to - from).normalize_or_zero();
            if direction.dot(normal(corners[triangle])) > 1e-9 && direction.dot(normal(corners[lamp])) < -1e-9
            {
                rays.push(Ray { from, direction, triangle, to, lamp });
            }
        }
    }
    rays
}

/// As many triangles, all over the mesh, as make up [`RAYS`] with so many of each.
fn some(corners: &[[DVec3; 3]], each: usize) -> impl Iterator<Item = usize> {
    let has_area = |&t: &usize| normal(corners[t]) != DVec3::ZERO;
    (0..corners.len()).step_by((corners.len() * each).div_ceil(RAYS).max(1)).filter(has_area)
}

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize_or_zero()
}

/// Triangles, and which of them emit.
type Mesh = (Vec<[DVec3; 3]>, Vec<usize>);

/// The mesh of an OBJ file.
fn read(path: &str) -> Result<Mesh, Box<dyn std::error::Error>> {
    let (mut vertices, mut corners, mut lamps) = (Vec::new(), Vec::new(), Vec::new());
    let (emitting, mut emits) = (emitting(path), false);
    for line in std::fs::read_to_string(path)?.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["v", x, y, z, ..] => vertices.push(DVec3::new(x.parse()?, y.parse()?, z.parse()?)),
            ["usemtl", name] => emits = emitting.contains(*name),
            ["f", of @ ..] => {
                let index = |word: &&str| word.split('/').next().unwrap_or_default().parse::<usize>();
                let of = of.iter().map(index).collect::<Result<Vec<_>, _>>()?;
                for k in 2..of.len() {
                    lamps.extend(emits.then_some(corners.len()));
                    corners.push([of[0], of[k - 1], of[k]].map(|index| vertices[index - 1]));
                }
            }
            _ => {}
        }
    }
    if lamps.is_empty() {
        lamps.extend((0..corners.len()).step_by(100));
    }
    Ok((corners, lamps))
}

/// The materials that emit, by the MTL file of the same name.
fn emitting(path: &str) -> HashSet<String> {
    let text = std::fs::read_to_string(Path::new(path).with_extension("mtl")).unwrap_or_default();
    let (mut found, mut name) = (HashSet::new(), "");
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["newmtl", new] => name = new,
            ["Ke", emission @ ..] if emission.iter().any(|x| x.parse().is_ok_and(|x: f64| x > 0.0)) => {
                found.insert(name.to_owned());
            }
            _ => {}
        }
    }
    found
}

/// Rays within a closed, turned box of uneven triangles: how many meet nothing, of those that aim anywhere, at edges and at corners.
fn leaks() {
    let corners = uneven_box(40);
    let rays = Rays::among(corners.clone(), |_| true);
    let middle = corners.iter().flatten().sum::<DVec3>() / (3.0 * corners.len() as f64);
    println!("closed box of {} triangles; of {IN_BOX} rays each, escaped:", corners.len());
    for aim in ["anywhere", "edges", "corners"] {
        let mut random = Random(3);
        let escaped = (0..IN_BOX).filter(|_| {
            let from = middle + DVec3::from([(); 3].map(|()| 3.0 * random.next() - 1.5));
            let triangle = corners[(random.next() * corners.len() as f64) as usize];
            let to = match aim {
                "anywhere" => random.on(triangle),
                "edges" => triangle[0].lerp(triangle[1], random.next()),
                _ => triangle[0],
            };
            rays.nearest(from, (to - from).normalize(), None).is_none()
        });
        println!("{aim:>10} {}", escaped.count());
    }
}

/// A turned box of `cells` a side, 5 m, with vertices that are moved at random.
fn uneven_box(cells: i32) -> Vec<[DVec3; 3]> {
    let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.3, 0.7, 1.1);
    let mut random = Random(7);
    let mut places = HashMap::new();
    let mut place = |cell: [i32; 3]| {
        *places.entry(cell).or_insert_with(|| {
            let moved = DVec3::from(cell.map(|x| f64::from(x) + 0.3 * random.next()));
            turn * (moved * 5.0 / f64::from(cells)) + DVec3::new(3.0, -2.0, 11.0)
        })
    };
    let mut corners = Vec::new();
    for (axis, side, i, j) in (0..3).flat_map(|axis| {
        [0, cells]
            .into_iter()
            .flat_map(move |side| (0..cells * cells).map(move |k| (axis, side, k / cells, k % cells)))
    }) {
        let mut at = |i: i32, j: i32| {
            let mut cell = [side; 3];
            (cell[(axis + 1) % 3], cell[(axis + 2) % 3]) = (i, j);
            place(cell)
        };
        let [p, q, r, s] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        corners.extend([[p, q, r], [p, r, s]]);
    }
    corners
}

/// Numbers from 0 to 1 (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A place on a triangle.
    fn on(&mut self, [a, b, c]: [DVec3; 3]) -> DVec3 {
        let (s, t) = (self.next().sqrt(), self.next());
        a + s * (b - a) + s * t * (c - b)
    }
}
