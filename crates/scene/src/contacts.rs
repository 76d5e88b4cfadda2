//! Cuts triangles along the lines on which others stand on them or pass through them, and leaves out what is covered.
//!
//! Light is even over a triangle. What a box covers of a triangle of the floor receives none, and would darken the rest of it: at the
//! foot of the box, by as much as it covers.

use super::adjacency::Edge;
use super::refine::Part;
use super::{Edges, Scene, Welded, bounds, sides};
use antirad_base::parallel;
use antirad_rays::Boxes;
use glam::{DVec2, DVec3};
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};
use std::cmp::Reverse;
use std::collections::HashMap;

/// Lengths below this share of the scene's diagonal are rounding.
pub(super) const TOLERANCE: f64 = 1e-6;
/// Lines shorter than this share of the root of a triangle's area, all together, enclose less than a thousandth of it.
const SHORT: f64 = 0.1;
/// Triangles the root of whose area is below this share of the diagonal stay whole: what is covered of them shows nowhere, and cuts of a
/// fine mesh would add to the outlines by which it blocks lamps.
pub(super) const SMALL: f64 = 5e-3;
/// Places closer to each other than this share of the root of a triangle's area become one, so that its parts are no slivers.
pub(super) const SNAP: f64 = 0.02;
/// Barycentric coordinates below this are those of a place on a side.
pub(super) const ON_SIDE: f64 = 1e-9;
/// Triangles smaller than this share of another cut nothing of it: a fine mesh that stands on it would make many parts.
pub(super) const FINE: f64 = 0.15;
/// A triangle that has more lines than this stays whole.
const MOST_LINES: usize = 256;
/// Nor with more places where lines end or cross.
const MOST_PLACES: usize = 1024;
/// Cosine between normals of one plane.
const FLAT: f64 = 1.0 - 1e-9;

impl Scene {
    /// Cuts all but small triangles along the lines on which others of their size stand on them or pass through them, the largest first,
    /// until `max_triangles` would be exceeded; parts inside of others, which no light reaches, are left out, and with them what they see.
    /// Surfaces that emit and reflect nothing stay. Finds the [creases](Self::creases) of what is left.
    ///
    /// Returns the original triangle of each new one.
    #[doc(hidden)]
    pub fn cut_along_contacts(&mut self, max_triangles: usize) -> Vec<u32> {
        self.cut_at_contacts(max_triangles, true)
    }

    /// [`Self::cut_along_contacts`], but parts inside of others stay: they may come to light where vertices move.
    #[doc(hidden)]
    pub fn cut_along_all_contacts(&mut self, max_triangles: usize) -> Vec<u32> {
        self.cut_at_contacts(max_triangles, false)
    }

    fn cut_at_contacts(&mut self, max_triangles: usize, leaves_out: bool) -> Vec<u32> {
        let count = self.triangles.len() as u32;
        let mut cuts = Contacts::of(self).cuts();
        cuts.sort_by_key(|(triangle, _)| {
            (Reverse(self.area_vector(*triangle as usize).length().to_bits()), *triangle)
        });
        let mut parts: Vec<Option<Vec<Part>>> = vec![None; count as usize];
        let mut room = max_triangles.saturating_sub(count as usize);
        let mut vertices = Grid::new(TOLERANCE * self.diagonal());
        for (triangle, corners) in cuts {
            if corners.len() > room + 1 {
                break;
            }
            room -= corners.len() - 1;
            let own = self.triangles[triangle as usize].vertices;
            let place = self.corners(triangle as usize);
            let mut vertex = |b: DVec3| match (0..3).find(|&k| b[k] == 1.0) {
                Some(k) => own[k],
                None => vertices.vertex(&mut self.vertices, place[0] * b.x + place[1] * b.y + place[2] * b.z),
            };
            let part = |corners: [DVec3; 3]| Part { vertices: corners.map(&mut vertex), corners };
            parts[triangle as usize] = Some(corners.into_iter().map(part).collect());
        }
        let sizes: Vec<f64> = (0..count as usize).map(|t| self.area_vector(t).length().sqrt()).collect();
        if parts.iter().all(Option::is_none) {
            self.find_creases(&sizes);
            return (0..count).collect();
        }
        let parents = self.replace(&parts);
        let is_part = |t: &u32| leaves_out && parts[parents[*t as usize] as usize].is_some();
        let covered = self.covered((0..parents.len() as u32).filter(is_part).collect());
        let left: Vec<Option<Vec<Part>>> = covered.iter().map(|covered| covered.then(Vec::new)).collect();
        let parents: Vec<u32> = self.replace(&left).into_iter().map(|part| parents[part as usize]).collect();
        let sizes: Vec<f64> = parents.iter().map(|&parent| sizes[parent as usize]).collect();
        self.find_creases(&sizes);
        parents
    }

    pub(super) fn diagonal(&self) -> f64 {
        let (low, high) = bounds((0..self.triangles.len()).flat_map(|t| self.corners(t)));
        low.distance(high)
    }
}

/// New vertices, one for those that differ by rounding.
struct Grid {
    cell: f64,
    known: HashMap<[i64; 3], u32>,
}

impl Grid {
    fn new(cell: f64) -> Self {
        Self { cell: cell.max(f64::MIN_POSITIVE), known: HashMap::new() }
    }

    fn vertex(&mut self, vertices: &mut Vec<DVec3>, place: DVec3) -> u32 {
        let cell = (place / self.cell).round().to_array().map(|x| x as i64);
        *self.known.entry(cell).or_insert_with(|| {
            vertices.push(place);
            vertices.len() as u32 - 1
        })
    }
}

/// Finds the lines on which triangles touch or meet others.
struct Contacts<'a> {
    scene: &'a Scene,
    corners: Vec<[DVec3; 3]>,
    normals: Vec<DVec3>,
    /// Of each triangle, which of its sides continue in another of its plane.
    flat: Vec<[bool; 3]>,
    boxes: Boxes,
    tolerance: f64,
    /// Root of the area of a triangle that is too small to be cut.
    smallest: f64,
}

impl<'a> Contacts<'a> {
    fn of(scene: &'a Scene) -> Self {
        let corners: Vec<[DVec3; 3]> = (0..scene.triangles.len()).map(|t| scene.corners(t)).collect();
        let normals: Vec<DVec3> =
            (0..corners.len()).map(|t| scene.area_vector(t).normalize_or_zero()).collect();
        let (low, high) = bounds(corners.iter().flatten().copied());
        let diagonal = low.distance(high).max(f64::MIN_POSITIVE);
        let boxes = Boxes::around(&corners);
        let flat = flat_sides(scene, &normals);
        let (tolerance, smallest) = (TOLERANCE * diagonal, SMALL * diagonal);
        Self { scene, corners, normals, flat, boxes, tolerance, smallest }
    }

    /// The triangles that are to be cut, each with the corners of its parts in barycentric coordinates.
    fn cuts(&self) -> Vec<(u32, Vec<[DVec3; 3]>)> {
        let cut = |t: u32| {
            let size = self.size(t as usize);
            if self.scene.material(t as usize).only_emits() || size <= self.smallest {
                return None;
            }
            let lines = self.lines(t as usize);
            let length: f64 = lines
                .iter()
                .map(|[from, to]| self.at(t as usize, *from).distance(self.at(t as usize, *to)))
                .sum();
            if lines.len() > MOST_LINES || length < SHORT * size {
                return None;
            }
            let parts = triangulated(self.corners[t as usize], &lines, self.tolerance.max(SNAP * size))?;
            (parts.len() > 1).then_some((t, parts))
        };
        parallel::flat_map(0..self.corners.len() as u32, cut)
    }

    /// The root of the area of a triangle.
    fn size(&self, triangle: usize) -> f64 {
        self.scene.area_vector(triangle).length().sqrt()
    }

    fn at(&self, triangle: usize, b: DVec3) -> DVec3 {
        let [x, y, z] = self.corners[triangle];
        x * b.x + y * b.y + z * b.z
    }

    /// The lines within a triangle, in its barycentric coordinates.
    fn lines(&self, triangle: usize) -> Vec<[DVec3; 2]> {
        let mut lines = Vec::new();
        let smallest = FINE * self.size(triangle);
        self.boxes.meet(&self.corners[triangle], |other| {
            if other as usize != triangle && self.size(other as usize) > smallest {
                self.between(triangle, other as usize, &mut lines);
            }
            true
        });
        // In an order that does not depend on the boxes.
        let key = |[a, b]: &[DVec3; 2]| [a.x, a.y, b.x, b.y].map(f64::to_bits);
        lines.sort_by_key(key);
        lines
    }

    /// Adds the lines on which another triangle touches or crosses one.
    fn between(&self, triangle: usize, other: usize, lines: &mut Vec<[DVec3; 2]>) {
        let (normal, origin) = (self.normals[triangle], self.corners[triangle][0]);
        let corners = self.corners[other];
        let height = corners.map(|corner| {
            let height = (corner - origin).dot(normal);
            if height.abs() <= self.tolerance { 0.0 } else { height }
        });
        if height.iter().all(|h| *h > 0.0) || height.iter().all(|h| *h < 0.0) {
            return;
        }
        let mut ends = Vec::with_capacity(2);
        for k in 0..3 {
            let next = (k + 1) % 3;
            match (height[k], height[next]) {
                // A side in the plane.
                (0.0, 0.0) if !self.flat[other][k] => self.add(triangle, [corners[k], corners[next]], lines),
                (a, b) if a * b < 0.0 => ends.push(corners[k].lerp(corners[next], a / (a - b))),
                _ => {}
            }
        }
        // The plane is crossed at two sides, or at one and the opposite corner.
        if ends.len() == 1 {
            ends.extend((0..3).find(|&k| height[k] == 0.0).map(|k| corners[k]));
        }
        if let [from, to] = ends[..] {
            self.add(triangle, [from, to], lines);
        }
    }

    /// Adds what lies of a line in the plane of a triangle within it, unless that is along its sides.
    fn add(&self, triangle: usize, ends: [DVec3; 2], lines: &mut Vec<[DVec3; 2]>) {
        let corners = self.corners[triangle];
        let [from, to] = ends.map(|end| barycentric(corners, self.normals[triangle], end));
        let (mut begin, mut end) = (0.0_f64, 1.0_f64);
        for k in 0..3 {
            let (a, b) = (from[k], to[k]);
            match (a >= 0.0, b >= 0.0) {
                (false, false) => return,
                (true, false) => end = end.min(a / (a - b)),
                (false, true) => begin = begin.max(a / (a - b)),
                (true, true) => {}
            }
        }
        if begin >= end {
            return;
        }
        let line = [begin, end].map(|s| from.lerp(to, s));
        let middle = line[0].lerp(line[1], 0.5);
        let twice_area = 2.0 * self.scene.area_vector(triangle).length();
        let apart = (0..3).map(|k| {
            let side = corners[(k + 1) % 3].distance(corners[(k + 2) % 3]);
            middle[k] * twice_area / side
        });
        let length = self.at(triangle, line[0]).distance(self.at(triangle, line[1]));
        if length > self.tolerance && apart.fold(f64::INFINITY, f64::min) > self.tolerance {
            lines.push(line);
        }
    }
}

/// Barycentric coordinates of a point's projection onto a triangle's plane; `normal` of any length.
pub(super) fn barycentric([a, b, c]: [DVec3; 3], normal: DVec3, point: DVec3) -> DVec3 {
    let twice = (b - a).cross(c - a).dot(normal);
    let of = |p: DVec3, q: DVec3| (p - point).cross(q - point).dot(normal) / twice;
    let (x, y) = (of(b, c), of(c, a));
    DVec3::new(x, y, 1.0 - x - y)
}

/// Of each triangle, which of its sides one other triangle of its plane shares.
fn flat_sides(scene: &Scene, normals: &[DVec3]) -> Vec<[bool; 3]> {
    let welded = Welded::exactly(scene.vertices.iter().copied());
    let faces: Vec<[u32; 3]> = scene.triangles.iter().map(|t| welded.positions(t.vertices)).collect();
    let mut flat = vec![[false; 3]; faces.len()];
    let in_plane = |[one, other]: [u32; 2]| normals[one as usize].dot(normals[other as usize]) >= FLAT;
    let edges = Edges::of(faces.iter().copied());
    for (t, ends) in edges.iter().filter(|edge| edge.pair().is_some_and(in_plane)).flat_map(Edge::directed) {
        let sides = sides(faces[t as usize]);
        flat[t as usize].iter_mut().zip(sides).for_each(|(flat, side)| *flat |= side == ends);
    }
    flat
}

/// Triangulates a triangle along lines within it, all in barycentric coordinates. `None` where rounding prevents that.
fn triangulated(corners: [DVec3; 3], lines: &[[DVec3; 2]], tolerance: f64) -> Option<Vec<[DVec3; 3]>> {
    let [a, b, c] = corners;
    let along = (b - a).normalize();
    let across = ((c - a) - along * (c - a).dot(along)).normalize();
    let flat = corners.map(|p| DVec2::new((p - a).dot(along), (p - a).dot(across)));
    let twice_area = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]);
    let mut places = Places { all: flat.to_vec(), tolerance };
    let mut place = |b: DVec3| places.index(flat[0] * b.x + flat[1] * b.y + flat[2] * b.z);
    // Those on sides first: neighbours are cut there at the same places.
    let on_sides = lines.iter().flatten().filter(|b| b.min_element() <= ON_SIDE);
    on_sides.for_each(|&b| _ = place(b));
    let lines: Vec<[usize; 2]> = lines.iter().map(|line| line.map(&mut place)).collect();
    places.add_crossings(&lines);
    if places.all.len() > MOST_PLACES {
        return None;
    }
    let mut triangulation = ConstrainedDelaunayTriangulation::<Point2<f64>>::new();
    let mut handles = Vec::with_capacity(places.all.len());
    for place in &places.all {
        handles.push(triangulation.insert(Point2::new(place.x, place.y)).ok()?);
    }
    for line in lines {
        // What rounding lets cross another line is left out.
        places.stops(line).windows(2).for_each(|ends| {
            triangulation.try_add_constraint(handles[ends[0]], handles[ends[1]]);
        });
    }
    let mut area = 0.0;
    let mut parts = Vec::new();
    for face in triangulation.inner_faces() {
        let corners = face.positions().map(|p| DVec2::new(p.x, p.y));
        let [p, q, r] = corners;
        let twice = (q - p).perp_dot(r - p);
        let longest = p.distance(q).max(q.distance(r)).max(r.distance(p));
        area += twice;
        if twice > 1e-6 * longest * longest {
            parts.push(corners.map(|p| exact(flat, p)));
        }
    }
    ((area / twice_area - 1.0).abs() <= 1e-6).then_some(parts)
}

/// Places in a plane, one for those that differ by rounding.
struct Places {
    all: Vec<DVec2>,
    tolerance: f64,
}

impl Places {
    fn index(&mut self, place: DVec2) -> usize {
        let known = self.all.iter().position(|p| p.distance(place) <= self.tolerance);
        known.unwrap_or_else(|| {
            self.all.push(place);
            self.all.len() - 1
        })
    }

    /// Adds the places where lines cross.
    fn add_crossings(&mut self, lines: &[[usize; 2]]) {
        for (k, line) in lines.iter().enumerate() {
            for other in &lines[..k] {
                let [[a, b], [c, d]] = [line, other].map(|line| line.map(|end| self.all[end]));
                let (along, across) = (b - a, d - c);
                let slope = along.perp_dot(across);
                let (s, t) = ((c - a).perp_dot(across) / slope, (c - a).perp_dot(along) / slope);
                // Parallel lines have none, and neither comparison is true for them.
                if s > 0.0 && s < 1.0 && t > 0.0 && t < 1.0 && self.all.len() <= MOST_PLACES {
                    self.index(a + s * along);
                }
            }
        }
    }

    /// The places on a line, from one end to the other.
    fn stops(&self, [from, to]: [usize; 2]) -> Vec<usize> {
        let (start, along) = (self.all[from], self.all[to] - self.all[from]);
        let share = |place: DVec2| (place - start).dot(along) / along.length_squared();
        let within = |&k: &usize| {
            let s = share(self.all[k]);
            k == from
                || k == to
                || s > 0.0 && s < 1.0 && self.all[k].distance(start + s * along) <= self.tolerance
        };
        let mut stops: Vec<usize> = (0..self.all.len()).filter(within).collect();
        stops.sort_by(|&a, &b| share(self.all[a]).total_cmp(&share(self.all[b])));
        stops
    }
}

/// The barycentric coordinates of a place, exactly those of a corner that it is.
fn exact(flat: [DVec2; 3], place: DVec2) -> DVec3 {
    match (0..3).find(|&k| flat[k] == place) {
        Some(k) => DVec3::AXES[k],
        None => barycentric(flat.map(|p| p.extend(0.0)), DVec3::Z, place.extend(0.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Material, SceneBuilder, Shape};
    use glam::DAffine3;

    /// A room with a floor of so many cells along each side, and things in it.
    fn room(cells: u32, things: impl FnOnce(&mut SceneBuilder, &Material)) -> Scene {
        let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
        let mut builder = SceneBuilder::new();
        builder.shape("room", Shape::Room { cells }, &grey, DAffine3::IDENTITY);
        things(&mut builder, &grey);
        builder.finish("room").expect("a scene")
    }

    fn placed(size: [f64; 3], at: [f64; 3]) -> DAffine3 {
        DAffine3::from_translation(at.into()) * DAffine3::from_scale(size.into())
    }

    fn area(scene: &Scene, of: impl Fn(usize) -> bool) -> f64 {
        (0..scene.triangles.len()).filter(|&t| of(t)).map(|t| scene.area_vector(t).length()).sum()
    }

    /// A box on the floor: what it covers is gone, but for what is small beside a triangle, whether it has a bottom, hovers by rounding, or is sunk.
    #[test]
    fn a_box_covers_what_it_stands_on() {
        for (height, sunk) in [(0.0, false), (3e-8, false), (-0.05, true)] {
            let place = placed([0.16, 0.4, 0.15], [0.42, height, 0.44]);
            let given = room(3, |builder, grey| {
                builder.shape("box", Shape::Box { cells: 1 }, grey, place);
            });
            let mut scene = given.clone();
            let parents = scene.cut_along_contacts(10_000);
            assert_eq!(parents.len(), scene.triangles.len());
            let floor = |scene: &Scene| {
                area(scene, |t| {
                    scene.meshes[0].range.contains(&(t as u32)) && scene.corners(t).iter().all(|c| c.y < 1e-9)
                })
            };
            let covered = floor(&given) - floor(&scene);
            assert!((covered - 0.16 * 0.15).abs() <= 3e-4, "{height}: {covered}");
            // The sides below the floor see its back and nothing else.
            let sides = |scene: &Scene| area(scene, |t| scene.meshes[1].range.contains(&(t as u32)));
            let hidden = if sunk { 2.0 * (0.16 + 0.15) * 0.05 } else { 0.0 };
            let gone = sides(&given) - sides(&scene);
            assert!((gone - hidden).abs() <= 1e-9, "{height}: {gone}");
            for (t, &parent) in parents.iter().enumerate() {
                let [part, whole] =
                    [scene.area_vector(t), given.area_vector(parent as usize)].map(DVec3::normalize);
                assert!(part.dot(whole) > 1.0 - 1e-9);
            }
            assert!(scene.check(true).is_ok());
        }
    }

    /// A wall of one sheet has light on both sides: nothing is left out, and the floor ends at it.
    #[test]
    fn a_sheet_cuts_and_covers_nothing() {
        let given = room(1, |builder, grey| {
            let (corners, faces) = (
                [[0.3, 0.0, 0.2], [0.3, 0.0, 0.8], [0.3, 0.5, 0.8], [0.3, 0.5, 0.2]]
                    .map(DVec3::from)
                    .to_vec(),
                vec![[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]],
            );
            builder.mesh("sheet", corners, faces, grey, DAffine3::IDENTITY);
        });
        let mut scene = given.clone();
        let parents = scene.cut_along_contacts(10_000);
        assert!(parents.len() > given.triangles.len());
        assert!((area(&scene, |_| true) - area(&given, |_| true)).abs() <= 1e-12);
        for t in 0..scene.triangles.len() {
            let corners = scene.corners(t);
            let within = |p: DVec3| p.y < 1e-9 && p.z > 0.2 + 1e-6 && p.z < 0.8 - 1e-6;
            let sides: Vec<f64> = corners.iter().filter(|p| within(**p)).map(|p| p.x - 0.3).collect();
            assert!(sides.iter().all(|x| *x >= -1e-9) || sides.iter().all(|x| *x <= 1e-9), "{corners:?}");
        }
    }

    /// Without contacts a scene stays as it is: neighbours, corners that touch, two-sided walls all around; and where there is no room.
    #[test]
    fn others_stay() {
        let alone = room(4, |_, _| ());
        let mut apart = room(4, |builder, grey| {
            builder.shape(
                "ball",
                Shape::Icosphere { level: 2, inward: false },
                grey,
                placed([0.1; 3], [0.5; 3]),
            );
        });
        apart.warnings.clear();
        let on_floor = room(2, |builder, grey| {
            builder.shape("box", Shape::Box { cells: 1 }, grey, placed([0.4; 3], [0.3, 0.0, 0.3]));
        });
        for (given, most) in [(alone, 10_000), (apart, 10_000), (on_floor.clone(), on_floor.triangles.len())]
        {
            let mut scene = given.clone();
            let parents = scene.cut_along_contacts(most);
            assert_eq!(parents, (0..given.triangles.len() as u32).collect::<Vec<_>>());
            assert_eq!(scene.vertices, given.vertices);
        }
    }
}
