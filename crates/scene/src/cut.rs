//! A mesh whose triangles are cut into parts, and what belongs to the given triangles.

use super::{Painting, Scene, Triangle};
use glam::DVec3;
use std::sync::Arc;

/// A part of a triangle.
#[derive(Clone, Debug)]
struct Part {
    /// The given triangle.
    triangle: u32,
    /// Its corners among the vertices of the scene of parts.
    vertices: [u32; 3],
    /// The same in barycentric coordinates of the triangle.
    corners: [DVec3; 3],
    /// Its share of the triangle's area.
    share: f64,
}

/// A vertex that cutting has added, within a given triangle.
#[derive(Clone, Copy, Debug)]
struct Inserted {
    corners: [u32; 3],
    barycentric: DVec3,
}

/// How the triangles of a scene are cut into parts: a linear map from the vertices given to those of the parts, and from values of parts to
/// means over the given triangles. It holds wherever the vertices move.
#[derive(Clone, Debug)]
pub struct Cut {
    given_triangles: usize,
    given_vertices: usize,
    /// In the order of the given triangles.
    parts: Vec<Part>,
    inserted: Vec<Inserted>,
    creases: Vec<[bool; 3]>,
}

impl Cut {
    /// The cut that turns a scene into another, `finer` one, in which the given vertices come first, with the given triangle of each of its
    /// triangles in ascending order.
    pub fn between(given: &Scene, finer: &Scene, parents: &[u32]) -> Self {
        let given_vertices = given.vertices.len();
        let mut inserted: Vec<Option<Inserted>> = vec![None; finer.vertices.len() - given_vertices];
        let parts = parents.iter().zip(&finer.triangles).map(|(&triangle, &Triangle { vertices, .. })| {
            let corners = given.triangles[triangle as usize].vertices;
            let own = given.corners(triangle as usize);
            let at = vertices.map(|v| match corners.iter().position(|&corner| corner == v) {
                Some(k) => DVec3::AXES[k],
                None => barycentric(own, finer.vertices[v as usize]),
            });
            for (v, barycentric) in vertices.into_iter().zip(at) {
                if let Some(k) = (v as usize).checked_sub(given_vertices) {
                    inserted[k].get_or_insert(Inserted { corners, barycentric });
                }
            }
            let [a, b, c] = at;
            // The area in barycentric coordinates, of which the whole triangle has √3/2.
            let share = (b - a).cross(c - a).length() / 3.0_f64.sqrt();
            Part { triangle, vertices, corners: at, share }
        });
        let parts = parts.collect();
        // One that no part has lies nowhere.
        let unused = Inserted { corners: [0; 3], barycentric: DVec3::X };
        Self {
            given_triangles: given.triangles.len(),
            given_vertices,
            parts,
            inserted: inserted.into_iter().map(|vertex| vertex.unwrap_or(unused)).collect(),
            creases: finer.creases.clone(),
        }
    }

    /// That of a scene whose triangles stay whole.
    pub fn none(scene: &Scene) -> Self {
        let parents: Vec<u32> = (0..scene.triangles.len() as u32).collect();
        Self::between(scene, scene, &parents)
    }

    /// Number of the given triangles.
    pub fn given(&self) -> usize {
        self.given_triangles
    }

    /// The given triangle of each part, ascending.
    pub fn parents(&self) -> impl ExactSizeIterator<Item = u32> {
        self.parts.iter().map(|part| part.triangle)
    }

    /// The scene of the parts of a scene, which has the triangles that were cut, wherever its vertices are, and with whatever materials.
    pub fn apply(&self, given: &Scene) -> Scene {
        let mut scene = Scene { triangles: Vec::with_capacity(self.parts.len()), ..given.clone() };
        scene.vertices.extend(self.inserted.iter().map(|&Inserted { corners, barycentric }| {
            let [a, b, c] = corners.map(|v| given.vertices[v as usize]);
            a * barycentric.x + b * barycentric.y + c * barycentric.z
        }));
        let first_of = |triangle: u32| self.parts.partition_point(|part| part.triangle < triangle);
        for (mesh, k) in scene.meshes.iter_mut().zip(0..) {
            let (given_range, parts) =
                (mesh.range.clone(), first_of(mesh.range.start)..first_of(mesh.range.end));
            let parts = &self.parts[parts];
            if let Some(origin) = scene.origins.get_mut(k) {
                let lines = std::mem::take(&mut origin.lines);
                let line = |part: &Part| lines.get((part.triangle - given_range.start) as usize).copied();
                origin.lines = parts.iter().filter_map(line).collect();
            }
            let first = scene.triangles.len() as u32;
            scene.triangles.extend(
                parts.iter().map(|part| Triangle {
                    vertices: part.vertices,
                    ..given.triangles[part.triangle as usize]
                }),
            );
            mesh.range = first..scene.triangles.len() as u32;
        }
        if !scene.patterns.is_bare() {
            let rows = self.parts.iter().map(|part| (part.triangle, part.corners));
            Arc::make_mut(&mut scene.patterns).rearrange(rows);
        }
        scene.creases.clone_from(&self.creases);
        scene.update_degenerate();
        scene
    }

    /// Means over the given triangles, by area, of values of the parts.
    pub fn on_given(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut means = vec![DVec3::ZERO; self.given_triangles];
        for (part, &value) in self.parts.iter().zip(values) {
            means[part.triangle as usize] += part.share * DVec3::from(value);
        }
        means.into_iter().map(|mean| mean.to_array()).collect()
    }

    /// Derivatives by the values of parts of what depends on their means over the given triangles: the transpose of [`Self::on_given`].
    pub fn on_parts(&self, by_means: &[DVec3]) -> Vec<DVec3> {
        self.parts.iter().map(|part| part.share * by_means[part.triangle as usize]).collect()
    }

    /// Sums over the parts of each given triangle: derivatives by what all its parts share, such as their albedo.
    pub fn sums<T: Copy + Default + std::ops::AddAssign>(&self, by_parts: &[T]) -> Vec<T> {
        let mut sums = vec![T::default(); self.given_triangles];
        self.parts.iter().zip(by_parts).for_each(|(part, by)| sums[part.triangle as usize] += *by);
        sums
    }

    /// Derivatives by the given vertices, from those by the vertices of the parts.
    pub fn by_given_vertices(&self, by_vertices: &[DVec3]) -> Vec<DVec3> {
        let (own, inserted) = by_vertices.split_at(self.given_vertices);
        let mut sums = own.to_vec();
        for (&Inserted { corners, barycentric }, by) in self.inserted.iter().zip(inserted) {
            for (corner, weight) in corners.into_iter().zip(barycentric.to_array()) {
                sums[corner as usize] += weight * *by;
            }
        }
        sums
    }

    /// The vertices of the parts that move with some given vertices, ascending.
    pub fn moved_by(&self, vertices: &[u32]) -> Vec<u32> {
        let mut moves = vec![false; self.given_vertices];
        vertices.iter().for_each(|&v| moves[v as usize] = true);
        let inserted = self.inserted.iter().map(|Inserted { corners, barycentric }| {
            let weights = barycentric.to_array();
            corners.iter().zip(weights).any(|(&corner, weight)| weight != 0.0 && moves[corner as usize])
        });
        let inserted: Vec<bool> = inserted.collect();
        (0..).zip(moves.into_iter().chain(inserted)).filter_map(|(v, moves)| moves.then_some(v)).collect()
    }

    /// A painting over the parts of its triangles.
    pub fn paint(&self, painting: &Painting) -> Painting {
        painting.over(self.parents())
    }
}

/// The barycentric coordinates of a point of a triangle.
fn barycentric([a, b, c]: [DVec3; 3], point: DVec3) -> DVec3 {
    let normal = (b - a).cross(c - a);
    let share =
        |from: DVec3, to: DVec3| (to - from).cross(point - from).dot(normal) / normal.length_squared();
    let (y, z) = (share(c, a), share(a, b));
    DVec3::new(1.0 - y - z, y, z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Material, SceneBuilder, Shape};
    use glam::DAffine3;

    /// A cut scene is what cutting made, stays so where vertices move, and values come back as means and sums.
    #[test]
    fn parts_follow_the_triangles_that_they_are_cut_from() {
        let mut builder = SceneBuilder::new();
        let far = DAffine3::from_translation(DVec3::new(3.0, 0.5, -2.0));
        builder.shape("floor", Shape::Quad { cells: 1 }, &Material::named("grey"), far);
        let on = far
            * DAffine3::from_scale_rotation_translation(
                DVec3::splat(0.3),
                glam::DQuat::from_rotation_y(0.4),
                DVec3::new(0.4, 0.0, 0.4),
            );
        builder.shape("box", Shape::Box { cells: 1 }, &Material::named("white"), on);
        let given = builder.finish("scene").expect("a scene");
        let mut finer = given.clone();
        let parents = finer.cut_along_contacts(10_000);
        assert!(finer.triangles.len() > given.triangles.len());
        let cut = Cut::between(&given, &finer, &parents);
        let again = cut.apply(&given);
        assert_eq!((&again.triangles, &again.meshes), (&finer.triangles, &finer.meshes));
        assert_eq!((&again.creases, &again.degenerate), (&finer.creases, &finer.degenerate));
        let far = again.vertices.iter().zip(&finer.vertices).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(far <= 1e-12, "{far}");
        for (k, part) in cut.parts.iter().enumerate() {
            let share = again.area_vector(k).length() / given.area_vector(part.triangle as usize).length();
            assert!((share - part.share).abs() <= 1e-12);
        }

        // An affine map of the given scene is the same map of its parts.
        let map = DAffine3::from_rotation_z(0.3) * DAffine3::from_scale(DVec3::new(1.0, 2.0, 0.7));
        let mut moved = given.clone();
        moved.vertices.iter_mut().for_each(|v| *v = map.transform_point3(*v));
        let far = cut.apply(&moved).vertices.into_iter().zip(&finer.vertices);
        let far = far.map(|(a, b)| a.distance(map.transform_point3(*b))).fold(0.0, f64::max);
        assert!(far <= 1e-12, "{far}");

        // ⟨by, M dx⟩ = ⟨Mᵀ by, dx⟩ for the map of vertices, and for that of values.
        let number = |k: usize| DVec3::new((1.3 * k as f64).sin(), (2.1 * k as f64).cos(), 0.3);
        let by: Vec<DVec3> = (0..again.vertices.len()).map(number).collect();
        let back = cut.by_given_vertices(&by);
        let origin = cut.apply(&Scene { vertices: vec![DVec3::ZERO; given.vertices.len()], ..given.clone() });
        let change =
            Scene { vertices: (0..given.vertices.len()).map(|k| number(k + 7)).collect(), ..given.clone() };
        let forward = cut.apply(&change);
        let dot = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
        let (a, b) = (dot(&by, &forward.vertices) - dot(&by, &origin.vertices), dot(&back, &change.vertices));
        assert!((a - b).abs() <= 1e-12 * a.abs().max(1.0), "{a} {b}");
        let values: Vec<[f64; 3]> = (0..again.triangles.len()).map(|k| number(k).to_array()).collect();
        let by: Vec<DVec3> = (0..given.triangles.len()).map(number).collect();
        let rows = |of: &[[f64; 3]]| of.iter().copied().map(DVec3::from).collect::<Vec<_>>();
        let (a, b) = (dot(&by, &rows(&cut.on_given(&values))), dot(&cut.on_parts(&by), &rows(&values)));
        assert!((a - b).abs() <= 1e-12, "{a} {b}");
    }
}
