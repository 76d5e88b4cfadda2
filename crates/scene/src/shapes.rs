//! Procedural shapes: `shape = { kind = "...", ... }` of a scene file.

use std::collections::HashMap;
use std::ops::RangeInclusive;

use glam::DVec3;
use serde::Deserialize;

use super::geometry::subdivide;
use super::statue;

const CELLS: RangeInclusive<u32> = 1..=1000;
const LEVELS: RangeInclusive<u32> = 0..=9;
const STATUE_TRIANGLES: RangeInclusive<u32> = 500..=10_000_000;

/// A shape of any resolution, in metres before a mesh's scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// The unit square, x and z in [0, 1], at y = 0, facing +y: `cells` x `cells` squares of two triangles.
    Quad {
        /// Squares along a side.
        #[serde(default = "one")]
        cells: u32,
    },
    /// The unit cube [0, 1]³ facing outwards, `cells` x `cells` squares per side.
    Box {
        /// Squares along a side.
        #[serde(default = "one")]
        cells: u32,
    },
    /// The unit cube [0, 1]³ facing outwards, for thin plates: `cells` x `cells` squares on the sides y = 0
    /// and y = 1, `cells` x 1 on the other four.
    Slab {
        /// Squares along a side.
        #[serde(default = "one")]
        cells: u32,
    },
    /// The unit cube [0, 1]³ facing inwards, `cells` x `cells` squares per side.
    Room {
        /// Squares along a side.
        #[serde(default = "one")]
        cells: u32,
    },
    /// The unit sphere about the origin: 20·4^`level` triangles, facing out, or in with `inward`.
    Icosphere {
        /// How many times each triangle is cut into four.
        level: u32,
        /// Whether the fronts face the centre.
        #[serde(default)]
        inward: bool,
    },
    /// A closed standing figure about 1.8 m high on y = 0, facing +z, of `triangles` triangles (to 1 %).
    Statue {
        /// Number of triangles, to 1 %.
        triangles: u32,
    },
}

fn one() -> u32 {
    1
}

impl Shape {
    /// The shape's `kind` in a scene file.
    #[doc(hidden)]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Quad { .. } => "quad",
            Self::Box { .. } => "box",
            Self::Slab { .. } => "slab",
            Self::Room { .. } => "room",
            Self::Icosphere { .. } => "icosphere",
            Self::Statue { .. } => "statue",
        }
    }

    /// Vertices in metres, and faces counter-clockwise seen from their front. Resolutions out of range are clamped.
    #[doc(hidden)]
    pub fn mesh(&self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let (_, number, range) = self.resolution();
        let number = number.clamp(*range.start(), *range.end());
        match *self {
            Self::Quad { .. } => quad(number),
            Self::Box { .. } => cube([number; 3], false),
            Self::Slab { .. } => cube([number, 1, number], false),
            Self::Room { .. } => cube([number; 3], true),
            Self::Icosphere { inward, .. } => icosphere(number, inward),
            Self::Statue { .. } => statue::mesh(number),
        }
    }

    /// An error if the resolution is out of range.
    pub(super) fn validate(&self) -> Result<(), String> {
        let (name, number, range) = self.resolution();
        if range.contains(&number) {
            return Ok(());
        }
        Err(format!(
            "{} with {name} = {number}; it must lie in {} to {}",
            self.kind(),
            range.start(),
            range.end()
        ))
    }

    /// The number that sets the shape's resolution: its name, value and range.
    fn resolution(&self) -> (&'static str, u32, RangeInclusive<u32>) {
        match *self {
            Self::Quad { cells } | Self::Box { cells } | Self::Slab { cells } | Self::Room { cells } => {
                ("cells", cells, CELLS)
            }
            Self::Icosphere { level, .. } => ("level", level, LEVELS),
            Self::Statue { triangles } => ("triangles", triangles, STATUE_TRIANGLES),
        }
    }
}

fn quad(cells: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut grid = Grid::default();
    grid.side([cells, cells], |i, j| [j, 0, i]);
    grid.finish(DVec3::splat(1.0 / f64::from(cells)))
}

/// The unit cube with the given numbers of cells along x, y and z.
fn cube([nx, ny, nz]: [u32; 3], inward: bool) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut grid = Grid::default();
    // (i, j) with i x j pointing out of the cube.
    grid.side([nx, nz], |i, j| [i, 0, j]);
    grid.side([nz, nx], |i, j| [j, ny, i]);
    grid.side([nz, ny], |i, j| [0, j, i]);
    grid.side([nz, ny], |i, j| [nx, j, nz - i]);
    grid.side([ny, nx], |i, j| [j, i, 0]);
    grid.side([nx, ny], |i, j| [i, j, nz]);
    let (vertices, mut faces) = grid.finish(1.0 / DVec3::new(nx.into(), ny.into(), nz.into()));
    if inward {
        turn_over(&mut faces);
    }
    (vertices, faces)
}

fn turn_over(faces: &mut [[u32; 3]]) {
    faces.iter_mut().for_each(|face| face.swap(1, 2));
}

/// Squares with integer corners; sides that meet share vertices.
#[derive(Default)]
struct Grid {
    indices: HashMap<[u32; 3], u32>,
    corners: Vec<[u32; 3]>,
    faces: Vec<[u32; 3]>,
}

impl Grid {
    fn index(&mut self, corner: [u32; 3]) -> u32 {
        *self.indices.entry(corner).or_insert_with(|| {
            self.corners.push(corner);
            self.corners.len() as u32 - 1
        })
    }

    fn side(&mut self, [rows, columns]: [u32; 2], corner: impl Fn(u32, u32) -> [u32; 3]) {
        for i in 0..rows {
            for j in 0..columns {
                let [a, b, c, d] =
                    [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(|[i, j]| self.index(corner(i, j)));
                self.faces.extend([[a, b, c], [a, c, d]]);
            }
        }
    }

    fn finish(self, step: DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let position = |corner: [u32; 3]| DVec3::from(corner.map(f64::from)) * step;
        (self.corners.into_iter().map(position).collect(), self.faces)
    }
}

/// Not from the crate `hexasphere`: its positions are f32, too inexact for `icospheres_are_closed_and_turned_right`, and
/// its triangles are ordered otherwise than in the reference data.
fn icosphere(level: u32, inward: bool) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let mut vertices = Vec::with_capacity(10 * 4usize.pow(level) + 2);
    for (a, b) in [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)] {
        vertices.extend([DVec3::new(a, b, 0.0), DVec3::new(0.0, a, b), DVec3::new(b, 0.0, a)]);
    }
    // Faces are the triples of mutual neighbours; the edges of this icosahedron have length 2.
    let near = |a: u32, b: u32| (vertices[a as usize] - vertices[b as usize]).length() < 2.1;
    let mut faces = Vec::with_capacity(20);
    for a in 0..12 {
        for b in (a + 1..12).filter(|&b| near(a, b)) {
            for c in (b + 1..12).filter(|&c| near(a, c) && near(b, c)) {
                let [p, q, r] = [a, b, c].map(|v: u32| vertices[v as usize]);
                faces.push(if p.dot(q.cross(r)) > 0.0 { [a, b, c] } else { [a, c, b] });
            }
        }
    }
    for _ in 0..level {
        faces = subdivide(&mut vertices, &faces);
        // Normalised at every level, not only the last, which keeps the triangles more uniform.
        vertices.iter_mut().for_each(|v| *v = v.normalize_or_zero());
    }
    vertices.iter_mut().for_each(|v| *v = v.normalize_or_zero());
    if inward {
        turn_over(&mut faces);
    }
    (vertices, faces)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    fn volume(vertices: &[DVec3], faces: &[[u32; 3]]) -> f64 {
        let signed = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            a.dot(b.cross(c)) / 6.0
        };
        faces.iter().map(signed).sum()
    }

    /// Every directed edge occurs once, and so does its opposite.
    fn assert_closed(faces: &[[u32; 3]]) {
        let mut edges = HashSet::new();
        for &[a, b, c] in faces {
            for edge in [[a, b], [b, c], [c, a]] {
                assert!(edge[0] != edge[1] && edges.insert(edge), "edge {edge:?} twice");
            }
        }
        assert!(edges.iter().all(|&[a, b]| edges.contains(&[b, a])), "an edge is open");
    }

    #[test]
    fn quad_faces_up() {
        let (vertices, faces) = Shape::Quad { cells: 3 }.mesh();
        assert_eq!((vertices.len(), faces.len()), (16, 18));
        for face in faces {
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            assert!((b - a).cross(c - a).abs_diff_eq(DVec3::Y / 9.0, 1e-12));
        }
    }

    #[test]
    fn cubes_are_closed_and_turned_right() {
        for (shape, expected, counts) in [
            (Shape::Box { cells: 4 }, 1.0, (98, 192)),
            (Shape::Slab { cells: 4 }, 1.0, (50, 96)),
            (Shape::Room { cells: 4 }, -1.0, (98, 192)),
        ] {
            let (vertices, faces) = shape.mesh();
            assert_eq!((vertices.len(), faces.len()), counts);
            assert_closed(&faces);
            assert!((volume(&vertices, &faces) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn icospheres_are_closed_and_turned_right() {
        for (inward, sign) in [(false, 1.0), (true, -1.0)] {
            let (vertices, faces) = Shape::Icosphere { level: 3, inward }.mesh();
            assert_eq!((vertices.len(), faces.len()), (642, 1280));
            assert_closed(&faces);
            assert!(vertices.iter().all(|v| (v.length() - 1.0).abs() < 1e-12));
            let ball = 4.0 / 3.0 * std::f64::consts::PI;
            assert!((sign * volume(&vertices, &faces) / ball - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn statues_have_the_requested_triangles_and_stand_on_the_floor() {
        for count in [500, 777, 1234, 10_000, 65_537, 500_000] {
            let (vertices, faces) = Shape::Statue { triangles: count }.mesh();
            let got = faces.len() as f64;
            assert!((got / f64::from(count) - 1.0).abs() < 0.01, "{got} for {count}");
            assert_closed(&faces);
            assert!(volume(&vertices, &faces) > 0.2, "{}", volume(&vertices, &faces));
            let (low, high) =
                vertices.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v.y), h.max(v.y)));
            assert!(low == 0.0 && (high - 1.8).abs() < 1e-9, "{low} to {high}");
        }
    }

    #[test]
    fn statue_triangles_are_even_and_well_shaped() {
        for count in [500, 10_000, 100_000] {
            let (vertices, faces) = Shape::Statue { triangles: count }.mesh();
            let corners = || faces.iter().map(|face| face.map(|v| vertices[v as usize]));
            let ratio = |[a, b, c]: [DVec3; 3]| {
                let lengths = [a.distance(b), b.distance(c), c.distance(a)];
                lengths.into_iter().fold(0.0, f64::max) / lengths.into_iter().fold(f64::MAX, f64::min)
            };
            let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length() / 2.0;
            let mean = corners().map(area).sum::<f64>() / faces.len() as f64;
            let slender = corners().filter(|&t| ratio(t) > 4.0).count() as f64 / faces.len() as f64;
            let uneven = corners().filter(|&t| !(0.25..4.0).contains(&(area(t) / mean))).count() as f64
                / faces.len() as f64;
            assert!(slender < 0.02 && uneven < 0.05, "{count}: {slender} slender, {uneven} uneven");
        }
    }
}
