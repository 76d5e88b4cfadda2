//! A procedural standing figure: a closed organic shape of any number of triangles, for scaling tests and pictures.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

/// Radius and height of the outline, m, from the centre of the base via robe, shoulders and neck to the crown.
const OUTLINE: [[f64; 2]; 17] = [
    [0.0, 0.0],
    [0.18, 0.0],
    [0.33, 0.0],
    [0.36, 0.04],
    [0.32, 0.25],
    [0.26, 0.55],
    [0.22, 0.9],
    [0.245, 1.15],
    [0.25, 1.3],
    [0.19, 1.41],
    [0.095, 1.46],
    [0.085, 1.52],
    [0.115, 1.61],
    [0.125, 1.68],
    [0.1, 1.76],
    [0.05, 1.792],
    [0.0, 1.8],
];
/// Samples along the outline and around a ring, for measuring lengths.
const ALONG: usize = 4096;
const AROUND: usize = 192;

/// Rings of vertices around the figure, spaced like the vertices within them and joined by strips of triangles.
///
/// A strip between rings of n and m vertices has n + m triangles, a cap over a ring of n has n: the number of triangles is
/// twice that of the rings' vertices, so that any even number is possible.
pub(super) fn mesh(triangles: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let target = f64::from(triangles);
    let lengths = outline_lengths();
    let total = lengths[ALONG];
    let at = |share: f64| outline_at(&lengths, share * total);

    // Equilateral triangles of edge e: rings e √3/2 apart, their vertices e.
    let samples = 512;
    let area: f64 = (0..samples)
        .map(|i| perimeter(at((f64::from(i) + 0.5) / f64::from(samples))) * total / f64::from(samples))
        .sum();
    let edge = (4.0 * area / (3f64.sqrt() * target)).sqrt();
    let rings = (total / (edge * 3f64.sqrt() / 2.0)).round().max(3.0) as usize - 1;
    let places: Vec<f64> = (1..=rings).map(|ring| at(ring as f64 / (rings + 1) as f64)).collect();
    let perimeters: Vec<f64> = places.iter().map(|&place| perimeter(place)).collect();
    let per_metre = target / 2.0 / perimeters.iter().sum::<f64>();

    let mut vertices = vec![point(0.0, 0.0)];
    let mut faces = Vec::with_capacity(triangles as usize + 8);
    let mut below = Ring { first: 0, count: 1, shift: 0.0 };
    // Rounds the running sums, not the counts, so that the total is right.
    let mut exact = 0.0;
    let mut placed = 0;
    for (index, (&place, &length)) in places.iter().zip(&perimeters).enumerate() {
        exact += length * per_metre;
        let count = (exact.round() as u32).saturating_sub(placed).max(4);
        placed += count;
        // Every other ring is offset by half an edge, for equilateral triangles rather than halves of squares.
        let shift = (index % 2) as f64 / 2.0;
        let ring = Ring { first: vertices.len() as u32, count, shift };
        vertices.extend(evenly_around(place, count, shift));
        join(&below, &ring, &mut faces);
        below = ring;
    }
    let crown = Ring { first: vertices.len() as u32, count: 1, shift: 0.0 };
    vertices.push(point((OUTLINE.len() - 1) as f64, 0.0));
    join(&below, &crown, &mut faces);
    (vertices, faces)
}

/// `count` vertices from `first`, the i-th at the fraction (i + shift) / count of the circumference; a single one is a pole.
struct Ring {
    first: u32,
    count: u32,
    shift: f64,
}

impl Ring {
    fn vertex(&self, at: u32) -> u32 {
        self.first + at % self.count
    }

    /// Edges of the ring; a pole has none.
    fn edges(&self) -> u32 {
        if self.count == 1 { 0 } else { self.count }
    }

    fn share(&self, at: u32) -> f64 {
        (f64::from(at) + self.shift) / f64::from(self.count)
    }
}

/// The strip between two rings, facing outwards; `above` is further along the outline.
fn join(below: &Ring, above: &Ring, faces: &mut Vec<[u32; 3]>) {
    let (mut i, mut j) = (0, 0);
    while i < below.edges() || j < above.edges() {
        let along_below =
            j == above.edges() || (i < below.edges() && below.share(i + 1) <= above.share(j + 1));
        let (b, a) = (below.vertex(i), above.vertex(j));
        if along_below {
            faces.push([b, a, below.vertex(i + 1)]);
            i += 1;
        } else {
            faces.push([b, a, above.vertex(j + 1)]);
            j += 1;
        }
    }
}

/// The surface: `place` along the outline in [0, 16], `angle` in radians about the axis from +x to +z.
fn point(place: f64, angle: f64) -> DVec3 {
    let outline =
        DVec2::new(monotone_spline(place, |i| OUTLINE[i][0]), monotone_spline(place, |i| OUTLINE[i][1]));
    let height = outline.y;
    let bump = |centre: f64, width: f64| (-((height - centre) / width).powi(2)).exp();
    let towards = |direction: f64, width: f64| {
        let off = (angle - direction + PI).rem_euclid(TAU) - PI;
        (-(off / width).powi(2)).exp()
    };
    // Folds of the robe, a nose, a knot of hair, broad flat shoulders, a head held a little forward.
    let folds = 0.07 * (PI * height).sin().powi(2) * f64::from(height < 1.0) * (9.0 * angle).cos();
    let nose = 0.16 * bump(1.655, 0.03) * towards(PI / 2.0, 0.22);
    let hair = 0.25 * bump(1.7, 0.06) * towards(-PI / 2.0, 0.6);
    let radius = outline.x * (1.0 + folds + nose + hair);
    let breadth = 1.0 + 0.3 * bump(1.3, 0.14);
    let depth = 1.0 - 0.25 * bump(1.25, 0.3);
    let forward = 0.025 * bump(1.66, 0.12);
    DVec3::new(radius * breadth * angle.cos(), height, radius * depth * angle.sin() + forward)
}

/// Monotone cubic interpolation of values at 0, 1, 2 … (Fritsch and Carlson 1980): without overshoot,
/// the base stays flat.
fn monotone_spline(place: f64, value: impl Fn(usize) -> f64) -> f64 {
    let last = OUTLINE.len() - 1;
    let i = (place.max(0.0) as usize).min(last - 1);
    let secant = |i: usize| value(i + 1) - value(i);
    let slope = |i: usize| match i {
        0 => secant(0),
        _ if i == last => secant(last - 1),
        _ => {
            let (before, after) = (secant(i - 1), secant(i));
            if before * after > 0.0 { 2.0 * before * after / (before + after) } else { 0.0 }
        }
    };
    let t = place - i as f64;
    let (t2, t3) = (t * t, t * t * t);
    value(i) * (2.0 * t3 - 3.0 * t2 + 1.0)
        + slope(i) * (t3 - 2.0 * t2 + t)
        + value(i + 1) * (3.0 * t2 - 2.0 * t3)
        + slope(i + 1) * (t3 - t2)
}

/// Length of the outline up to each of its samples, averaged over directions.
fn outline_lengths() -> Vec<f64> {
    const DIRECTIONS: usize = 16;
    let place = |i: usize| (OUTLINE.len() - 1) as f64 * i as f64 / ALONG as f64;
    let mut lengths = vec![0.0];
    let mut length = 0.0;
    for i in 0..ALONG {
        for direction in 0..DIRECTIONS {
            let angle = TAU * direction as f64 / DIRECTIONS as f64;
            length += point(place(i), angle).distance(point(place(i + 1), angle)) / DIRECTIONS as f64;
        }
        lengths.push(length);
    }
    lengths
}

/// The position along the outline at a length.
fn outline_at(lengths: &[f64], length: f64) -> f64 {
    (OUTLINE.len() - 1) as f64 * invert(lengths, length) / ALONG as f64
}

/// The fractional index at which an increasing table that starts at 0 reaches `value`.
fn invert(table: &[f64], value: f64) -> f64 {
    let after = table.partition_point(|&entry| entry <= value).clamp(1, table.len() - 1);
    let (low, high) = (table[after - 1], table[after]);
    let part = if high > low { (value - low) / (high - low) } else { 0.0 };
    (after - 1) as f64 + part.clamp(0.0, 1.0)
}

/// Lengths around a ring up to each of its samples.
fn ring_lengths(place: f64) -> Vec<f64> {
    let sample = |i: usize| point(place, TAU * i as f64 / AROUND as f64);
    let mut lengths = vec![0.0];
    let mut length = 0.0;
    for i in 0..AROUND {
        length += sample(i).distance(sample(i + 1));
        lengths.push(length);
    }
    lengths
}

fn perimeter(place: f64) -> f64 {
    ring_lengths(place)[AROUND]
}

/// Points at equal distances around a ring.
fn evenly_around(place: f64, count: u32, shift: f64) -> impl Iterator<Item = DVec3> {
    let lengths = ring_lengths(place);
    (0..count).map(move |at| {
        let length = (f64::from(at) + shift) / f64::from(count) * lengths[AROUND];
        point(place, TAU * invert(&lengths, length) / AROUND as f64)
    })
}
