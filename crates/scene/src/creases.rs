//! Finds creases: edges within a surface along which another one stands on it or passes through it. Light differs on either side of them.

use super::adjacency::Edge;
use super::contacts::{FINE, SMALL, SNAP};
use super::{Edges, Scene, Welded, bounds, sides};
use antirad_base::parallel;
use antirad_rays::Boxes;
use glam::DVec3;

/// Cosine of the largest angle between faces of one smooth surface, 30°; larger ones are sharp edges.
pub const SAME_SURFACE: f64 = 0.866_025_403_784_438_6;
/// Places along an edge, as shares of it, at which the other surface must be.
const PLACES: [f64; 2] = [0.25, 0.75];

impl Scene {
    /// Finds [`Self::creases`], but for small triangles. `sizes`: of each triangle the root of the area, that of the whole one for a part.
    pub(super) fn find_creases(&mut self, sizes: &[f64]) {
        let welded = Welded::exactly(self.vertices.iter().copied());
        let faces: Vec<[u32; 3]> = self.triangles.iter().map(|t| welded.positions(t.vertices)).collect();
        let edges = Edges::of(faces.iter().copied());
        let place = |position: u32| self.vertices[welded.first[position as usize] as usize];
        let surfaces = Surfaces::of(self, sizes);
        let shared: Vec<Edge> = edges.iter().filter(|edge| edge.len() > 1).collect();
        let is_crease = |edge: &Edge| surfaces.meet_along(edge, edge.ends().map(&place));
        let creases = parallel::filter(shared, is_crease);
        let mut marked = vec![[false; 3]; if creases.is_empty() { 0 } else { faces.len() }];
        for (t, ends) in creases.into_iter().flat_map(Edge::directed) {
            let sides = sides(faces[t as usize]);
            marked[t as usize].iter_mut().zip(sides).for_each(|(marked, side)| *marked |= side == ends);
        }
        self.creases = marked;
    }
}

/// The triangles of a scene, to look for what is near a place.
struct Surfaces<'a> {
    sizes: &'a [f64],
    corners: Vec<[DVec3; 3]>,
    normals: Vec<DVec3>,
    boxes: Boxes,
    /// Size of a triangle that is too small for creases.
    smallest: f64,
}

impl<'a> Surfaces<'a> {
    fn of(scene: &Scene, sizes: &'a [f64]) -> Self {
        let corners: Vec<[DVec3; 3]> = (0..scene.triangles.len()).map(|t| scene.corners(t)).collect();
        let normals = (0..corners.len()).map(|t| scene.area_vector(t).normalize_or_zero()).collect();
        let (low, high) = bounds(corners.iter().flatten().copied());
        let diagonal = low.distance(high).max(f64::MIN_POSITIVE);
        Self { sizes, boxes: Boxes::around(&corners), corners, normals, smallest: SMALL * diagonal }
    }

    /// Whether two triangles of one surface share an edge, with such ends, along which there is another surface.
    fn meet_along(&self, edge: &Edge, [from, to]: [DVec3; 2]) -> bool {
        let faces: Vec<usize> = edge.triangles().map(|t| t as usize).collect();
        let pairs = || faces.iter().enumerate().flat_map(|(k, &a)| faces[..k].iter().map(move |&b| [a, b]));
        let one_surface = |[a, b]: &[usize; 2]| self.normals[*a].dot(self.normals[*b]) >= SAME_SURFACE;
        pairs().filter(one_surface).any(|pair| {
            let size = pair.map(|t| self.sizes[t]).into_iter().fold(0.0, f64::max);
            size > self.smallest && PLACES.iter().all(|&s| self.is_met(pair, from.lerp(to, s), size))
        })
    }

    /// Whether a triangle of another surface than that of a pair, and not much smaller, is at a place.
    fn is_met(&self, pair: [usize; 2], place: DVec3, size: f64) -> bool {
        let reach = SNAP * size;
        let mut met = false;
        self.boxes.meet(&[place - reach, place + reach], |other| {
            let other = other as usize;
            let stands = |t: usize| self.normals[t].dot(self.normals[other]).abs() < SAME_SURFACE;
            met = self.sizes[other] > FINE * size
                && pair.iter().all(|&t| stands(t))
                && distance(self.corners[other], self.normals[other], place) <= reach;
            !met
        });
        met
    }
}

/// The distance of a point from a triangle.
fn distance(corners: [DVec3; 3], normal: DVec3, point: DVec3) -> f64 {
    let sides = [0, 1, 2].map(|k| [corners[k], corners[(k + 1) % 3]]);
    if sides.iter().all(|[a, b]| (*b - *a).cross(point - *a).dot(normal) >= 0.0) {
        return (point - corners[0]).dot(normal).abs();
    }
    let to_side = |[a, b]: [DVec3; 2]| {
        let along = b - a;
        let share = (point - a).dot(along) / along.length_squared();
        point.distance(a.lerp(b, share.clamp(0.0, 1.0)))
    };
    sides.map(to_side).into_iter().fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use crate::{Material, Scene, SceneBuilder, Shape};
    use glam::{DAffine3, DVec3};
    use std::collections::HashMap;

    /// A room with a floor of eight cells a side and a wall of one sheet across it, in pieces that end next to where it crosses edges of the
    /// floor.
    fn room_with_sheet(x: f64) -> Scene {
        let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
        let mut builder = SceneBuilder::new();
        builder.shape("room", Shape::Room { cells: 8 }, &grey, DAffine3::IDENTITY);
        let columns = [0.0, 0.299, 0.426, 0.451, 1.0];
        let corners = columns.iter().flat_map(|&z| [[x, 0.0, z], [x, 0.5, z]]).map(DVec3::from).collect();
        let faces = (0..columns.len() as u32 - 1)
            .map(|k| 2 * k)
            .flat_map(|k| [[k, k + 2, k + 3], [k, k + 3, k + 1], [k, k + 3, k + 2], [k, k + 1, k + 3]])
            .collect();
        builder.mesh("sheet", corners, faces, &grey, DAffine3::IDENTITY);
        builder.finish("room").expect("a scene")
    }

    /// Length of the creases of a room in its floor, and in all; they end nowhere but at walls and at the top of the sheet.
    fn lengths(scene: &Scene, x: f64) -> [f64; 2] {
        let (mut lengths, mut ends_at) = ([0.0; 2], HashMap::new());
        for (t, marked) in scene.creases.iter().enumerate().take(scene.meshes[0].range.end as usize) {
            let corners = scene.corners(t);
            for k in (0..3).filter(|&k| marked[k]) {
                let ends = [corners[k], corners[(k + 1) % 3]];
                assert!(ends.iter().all(|p| (p.x - x).abs() <= 5e-3), "{ends:?}");
                let on_floor = ends.iter().all(|p| p.y == 0.0);
                lengths[0] += if on_floor { 0.5 * ends[0].distance(ends[1]) } else { 0.0 };
                lengths[1] += 0.5 * ends[0].distance(ends[1]);
                for end in ends.iter().filter(|end| end.y < 0.5 && end.z > 0.0 && end.z < 1.0) {
                    *ends_at.entry(end.to_array().map(|x| (x + 0.0).to_bits())).or_insert(0) += 1;
                }
            }
        }
        // Two sides of each of two edges.
        assert!(ends_at.values().all(|count| *count == 4), "{ends_at:?}");
        lengths
    }

    /// Where a sheet stands on the floor and beside two walls, between vertices of these or on their edges, and nowhere else.
    #[test]
    fn there_are_creases_along_a_sheet() {
        for x in [0.3, 0.5] {
            let mut scene = room_with_sheet(x);
            scene.cut_along_contacts(10_000);
            let [floor, all] = lengths(&scene, x);
            assert!((floor - 1.0).abs() <= 1e-2 && (all - 2.0).abs() <= 2e-2, "{x}: {floor} {all}");
            // Their parts inherit them.
            scene.split_all(1);
            let [floor, all] = lengths(&scene, x);
            assert!((floor - 1.0).abs() <= 1e-2 && (all - 2.0).abs() <= 2e-2, "{x}: {floor} {all}");
        }
    }

    #[test]
    fn surfaces_without_contacts_have_none() {
        let grey = Material::named("grey");
        let mut builder = SceneBuilder::new();
        let place = DAffine3::from_translation(DVec3::splat(0.5)) * DAffine3::from_scale(DVec3::splat(0.2));
        builder.shape("room", Shape::Room { cells: 4 }, &grey, DAffine3::IDENTITY);
        builder.shape("ball", Shape::Icosphere { level: 1, inward: false }, &grey, place);
        let mut scene = builder.finish("room").expect("a scene");
        scene.cut_along_contacts(10_000);
        assert!(scene.creases.is_empty());
    }
}
