//! Subdivides chosen triangles of a scene.

use super::contacts::ON_SIDE;
use super::geometry::{quarters, subdivide};
use super::{Scene, bounds};
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::HashMap;
use std::sync::Arc;

/// A part of a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    /// Its corners among the vertices of the scene.
    pub vertices: [u32; 3],
    /// Its corners in barycentric coordinates of the triangle.
    pub corners: [DVec3; 3],
}

impl Part {
    /// Which of its sides lie on creases, by those of the triangle.
    fn creases(&self, of: [bool; 3]) -> [bool; 3] {
        let on = |corner: usize, side: usize| self.corners[corner][(side + 2) % 3].abs() <= ON_SIDE;
        [0, 1, 2].map(|k| (0..3).any(|side| of[side] && on(k, side) && on((k + 1) % 3, side)))
    }
}

impl Scene {
    /// Replaces each of the triangles (ascending, without repeats) in place by four, cut at the midpoints of its edges; the
    /// others keep their order. Chosen neighbours share the new vertices. Where only one side of an edge is cut, the new
    /// vertex is a T-junction on that edge (to rounding), so that no gap opens.
    ///
    /// Returns the parent of each new triangle.
    pub fn split(&mut self, chosen: &[u32]) -> Vec<u32> {
        let faces: Vec<[u32; 3]> = chosen.iter().map(|&t| self.triangles[t as usize].vertices).collect();
        let children = subdivide(&mut self.vertices, &faces);
        let corners = quarters(DVec3::AXES, DVec3::midpoint);
        let mut parts = vec![None; self.triangles.len()];
        for (&t, four) in chosen.iter().zip(children.chunks_exact(4)) {
            let part = |(&vertices, &corners)| Part { vertices, corners };
            parts[t as usize] = Some(four.iter().zip(&corners).map(part).collect());
        }
        self.replace(&parts)
    }

    /// Replaces triangles in place by their parts, where they have some; the others keep their order. Returns the parent of each new
    /// triangle.
    pub(super) fn replace(&mut self, parts: &[Option<Vec<Part>>]) -> Vec<u32> {
        let old = std::mem::take(&mut self.triangles);
        let creases = std::mem::take(&mut self.creases);
        let mut parents = Vec::new();
        let mut meshes = self.meshes.iter_mut().zip((0..).map(|k| self.origins.get(k).cloned()));
        let mut origins = Vec::new();
        for (mesh, origin) in &mut meshes {
            let first = self.triangles.len() as u32;
            let mut lines = Vec::new();
            for t in mesh.range.clone() {
                let triangle = old[t as usize];
                let whole = [Part { vertices: triangle.vertices, corners: DVec3::AXES }];
                let line =
                    origin.as_ref().and_then(|o| o.lines.get((t - mesh.range.start) as usize)).copied();
                for part in parts[t as usize].as_deref().unwrap_or(&whole) {
                    self.triangles.push(super::Triangle { vertices: part.vertices, ..triangle });
                    self.creases.extend(creases.get(t as usize).map(|of| part.creases(*of)));
                    parents.push(t);
                    lines.extend(line);
                }
            }
            mesh.range = first..self.triangles.len() as u32;
            origins.extend(origin.map(|o| super::Origin { lines, ..o }));
        }
        self.origins = origins;
        if !self.patterns.is_bare() {
            // In the order of triangles, as meshes are.
            let corners = |t: u32| match &parts[t as usize] {
                Some(parts) => parts.iter().map(|part| (t, part.corners)).collect(),
                None => vec![(t, DVec3::AXES)],
            };
            Arc::make_mut(&mut self.patterns).rearrange((0..old.len() as u32).flat_map(corners));
        }
        self.update_degenerate();
        parents
    }

    /// Cuts every triangle into four, `times` times. Returns the original triangle of each new one.
    pub fn split_all(&mut self, times: u32) -> Vec<u32> {
        let every = |scene: &Self| -> Vec<u32> { (0..scene.triangles.len() as u32).collect() };
        let mut parents = every(self);
        for _ in 0..times {
            let cut = self.split(&every(self));
            parents = cut.into_iter().map(|parent| parents[parent as usize]).collect();
        }
        parents
    }

    /// The diagonal of the box around all surfaces but those that emit and reflect nothing, such as a [sky](Self::add_sky), m.
    #[doc(hidden)]
    pub fn diagonal_of_what_reflects(&self) -> f64 {
        let reflects = |t: &usize| !self.material(*t).only_emits();
        let (low, high) = bounds((0..self.triangles.len()).filter(reflects).flat_map(|t| self.corners(t)));
        low.distance(high)
    }

    /// Cuts triangles with edges longer than a share of the scene's diagonal until there are none, or `max_triangles` would be exceeded.
    /// Surfaces that emit and reflect nothing, such as a [sky](Self::add_sky), do not count and stay. Returns the original triangle of
    /// each new one.
    #[doc(hidden)]
    pub fn split_wide(&mut self, share: f64, max_triangles: usize) -> Vec<u32> {
        let reflects = |scene: &Self, t: u32| !scene.material(t as usize).only_emits();
        let widest = share * self.diagonal_of_what_reflects();
        let mut parents: Vec<u32> = (0..self.triangles.len() as u32).collect();
        loop {
            let longest = |t: u32| self.longest_side(t as usize).1;
            let has_area = |t: u32| self.degenerate.binary_search(&t).is_err();
            let wide: Vec<u32> = (0..parents.len() as u32)
                .filter(|&t| longest(t) > widest && reflects(self, t) && has_area(t))
                .collect();
            if wide.is_empty() || parents.len() + 3 * wide.len() > max_triangles {
                return parents;
            }
            parents = self.split(&wide).into_iter().map(|parent| parents[parent as usize]).collect();
        }
    }

    /// Halves triangles across their longest side until none is longer than the limit of its triangle, m. Returns the original triangle of
    /// each new one.
    #[doc(hidden)]
    pub fn split_long(&mut self, limits: &[f64]) -> Vec<u32> {
        let mut parents: Vec<u32> = (0..self.triangles.len() as u32).collect();
        let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
        loop {
            let mut halves = |scene: &mut Self, t: usize| {
                let (k, length) = scene.longest_side(t);
                if length.partial_cmp(&limits[parents[t] as usize]) != Some(Ordering::Greater) {
                    return None;
                }
                let corners = [k, (k + 1) % 3, (k + 2) % 3];
                let [a, b, c] = corners.map(|k| scene.triangles[t].vertices[k]);
                let middle = *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                    scene.vertices.push(scene.vertices[a as usize].midpoint(scene.vertices[b as usize]));
                    scene.vertices.len() as u32 - 1
                });
                let [u, v, w] = corners.map(|k| DVec3::AXES[k]);
                let half = u.midpoint(v);
                Some(vec![
                    Part { vertices: [a, middle, c], corners: [u, half, w] },
                    Part { vertices: [middle, b, c], corners: [half, v, w] },
                ])
            };
            let parts: Vec<_> = (0..parents.len()).map(|t| halves(self, t)).collect();
            if parts.iter().all(Option::is_none) {
                return parents;
            }
            parents = self.replace(&parts).into_iter().map(|part| parents[part as usize]).collect();
        }
    }

    /// The longest side of a triangle, from corner k to the next, and its length, m. Of equally long ones the same for both sides of a sheet.
    #[doc(hidden)]
    pub fn longest_side(&self, triangle: usize) -> (usize, f64) {
        let corners = self.corners(triangle);
        let sides = [0, 1, 2].map(|k| {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let middle = a.midpoint(b);
            [a.distance(b), middle.x, middle.y, middle.z]
        });
        let order = |of: &usize, with: &usize| {
            let pairs = sides[*of].iter().zip(&sides[*with]);
            pairs.map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
        };
        let longest = (0..3).max_by(order).unwrap_or(0);
        (longest, sides[longest][0])
    }
}

#[cfg(test)]
mod tests {
    use crate::{Material, SceneBuilder, Shape, Sky, sides};
    use glam::{DAffine3, DVec3};
    use std::collections::HashSet;

    fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
        [a.min(b), a.max(b)]
    }

    #[test]
    fn a_sky_does_not_make_a_scene_larger() {
        let mut builder = SceneBuilder::new();
        builder.shape(
            "ground",
            Shape::Quad { cells: 2 },
            &Material::named("earth"),
            DAffine3::from_scale(DVec3::new(3.0, 1.0, 4.0)),
        );
        let mut scene = builder.finish("ground").expect("a scene");
        let diagonal = scene.diagonal_of_what_reflects();
        assert!((diagonal - 5.0).abs() < 1e-12, "{diagonal}");
        scene.add_sky(&Sky::uniform([1.0; 3]));
        assert_eq!(scene.diagonal_of_what_reflects(), diagonal);
    }

    #[test]
    fn chosen_triangles_become_four_in_their_place() {
        let (grey, white) = (Material::named("grey"), Material::named("white"));
        let mut builder = SceneBuilder::new();
        builder.shape("a", Shape::Quad { cells: 1 }, &grey, DAffine3::IDENTITY);
        builder.shape("b", Shape::Quad { cells: 2 }, &white, DAffine3::from_translation(DVec3::Y));
        let mut scene = builder.finish("s").expect("a scene");
        let before = scene.clone();
        let area = |scene: &crate::Scene, t: usize| {
            let [a, b, c] = scene.corners(t);
            (b - a).cross(c - a)
        };
        let parents = scene.split(&[1, 2, 3]);
        assert_eq!(parents, [0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 5, 6, 7, 8, 9]);
        assert_eq!(scene.meshes.iter().map(|m| m.range.clone()).collect::<Vec<_>>(), [0..5, 5..19]);
        for (t, &parent) in parents.iter().enumerate() {
            assert_eq!(scene.material(t).name, before.material(parent as usize).name);
            let times = parents.iter().filter(|&&p| p == parent).count() as f64;
            assert!((area(&scene, t) * times - area(&before, parent as usize)).length() <= 1e-15);
        }
        // Triangles 2 and 3 share an edge, and thus one of the new vertices.
        assert_eq!(scene.vertices.len(), before.vertices.len() + 3 + 5);
        assert!(scene.check(true).is_ok());
    }

    /// A strip of 4 x 1 m: halves of halves, which share their corners.
    #[test]
    fn long_triangles_are_halved_until_they_are_short() {
        let mut builder = SceneBuilder::new();
        let strip = DAffine3::from_scale(DVec3::new(4.0, 1.0, 1.0));
        builder.shape("strip", Shape::Quad { cells: 1 }, &Material::named("grey"), strip);
        let given = builder.finish("scene").expect("a scene");
        let mut scene = given.clone();
        assert_eq!(scene.split_long(&[f64::INFINITY, f64::NAN]), [0, 1]);
        assert_eq!(scene.triangles, given.triangles);
        let parents = scene.split_long(&[1.5, f64::INFINITY]);
        assert_eq!(parents.iter().filter(|&&parent| parent == 1).count(), 1);
        assert!(parents.len() > 4 && parents.len() < 12, "{parents:?}");
        let area = |t: usize| scene.area_vector(t).length();
        let cut = (0..parents.len()).filter(|&t| parents[t] == 0);
        assert!(cut.clone().all(|t| scene.longest_side(t).1 <= 1.5));
        assert!((cut.map(area).sum::<f64>() - 2.0).abs() <= 1e-12);
        // Both sides of the diagonal, cut alike, meet at the same vertices.
        let mut both = given.clone();
        let count = both.split_long(&[1.5; 2]).len();
        // By Euler's formula for a disc: no vertex lies on a side of another triangle.
        let edges: HashSet<[u32; 2]> =
            both.triangles.iter().flat_map(|t| sides(t.vertices)).map(sorted).collect();
        assert_eq!(both.vertices.len() + count, edges.len() + 1);
        assert!(both.check(true).is_ok());
    }

    #[test]
    fn wide_triangles_are_cut_and_others_stay() {
        let mut builder = SceneBuilder::new();
        builder.shape("room", Shape::Room { cells: 1 }, &Material::named("grey"), DAffine3::IDENTITY);
        let small = DAffine3::from_scale(DVec3::splat(0.1));
        builder.shape("box", Shape::Box { cells: 1 }, &Material::named("grey"), small);
        let given = builder.finish("scene").expect("a scene");

        let mut scene = given.clone();
        let parents = scene.split_wide(0.22, usize::MAX);
        // Edges of √2 become √2/4, within .22 √3.
        assert_eq!(scene.triangles.len(), 12 * 16 + 12);
        let pieces = |t: u32| parents.iter().filter(|&&parent| parent == t).count();
        assert!((0..12).all(|t| pieces(t) == 16) && (12..24).all(|t| pieces(t) == 1));

        let mut bounded = given.clone();
        assert_eq!(bounded.split_wide(0.22, 100).len(), 12 * 4 + 12);
    }
}
