//! Convex closed emitters of uniform radiance, such as bulbs: what a point sees of one is its silhouette, however many triangles it has.
//!
//! By Lambert's formula the light of all faces that are seen is that of their common boundary. Silhouettes are nearly plane: what stands
//! before their plane blocks, what stands behind does not. So only emitters count whose silhouettes are, seen from anywhere.

use super::polygon::{Polygon, connected, farthest, mean};
use crate::model::{Facet, orthonormal_basis};
use antirad_scene::{Welded, bounds, sides};
use glam::DVec3;
use std::collections::HashMap;

/// Faces from which an emitter is worth treating as one.
const LEAST: usize = 12;
/// Largest extent of a silhouette across its plane that may be left out of account, as a share f of its diameter: .14 of a ball of 320
/// triangles, .37 of a box. What stands within 2 f² of the radius before a limb may count as behind it.
const FLAT: f64 = 0.35;
/// The same where faces would be more than so many lamps, and cost more than that is worth: bulbs as scans give them.
const NEARLY_FLAT: f64 = 0.45;
const MANY: usize = 32;
/// Directions from which silhouettes are tried, in each of two dimensions.
const TRIED: u32 = 6;

/// The surface of a convex closed emitter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Solid {
    /// Its triangles, ascending.
    triangles: Vec<u32>,
    /// Its vertices, each as a triangle and a corner of it.
    vertices: Vec<[u32; 2]>,
    /// Each edge: its ends, in the order of its first triangle, and the places of both triangles.
    edges: Vec<([u32; 2], [u32; 2])>,
}

impl Solid {
    /// The convex closed surfaces among triangles that emit alike: groups of these, with their surfaces.
    pub fn among(
        facets: &[Facet],
        emitters: &[u32],
        tolerance: f64,
        alike: impl Fn(u32, u32) -> bool,
    ) -> Vec<Self> {
        let groups = connected(facets, emitters, 0.0, alike);
        groups.into_iter().filter_map(|group| Self::new(facets, group, tolerance)).collect()
    }

    /// A surface, if it is closed and convex.
    fn new(facets: &[Facet], triangles: Vec<u32>, tolerance: f64) -> Option<Self> {
        if triangles.len() < LEAST {
            return None;
        }
        let corners = triangles.iter().flat_map(|&i| facets[i as usize].corners);
        let welded = Welded::exactly(corners);
        let vertices: Vec<[u32; 2]> =
            welded.first.iter().map(|&corner| [triangles[corner as usize / 3], corner % 3]).collect();
        let mut open: HashMap<[u32; 2], u32> = HashMap::new();
        let mut edges = Vec::with_capacity(triangles.len() * 3 / 2);
        for at in 0..triangles.len() as u32 {
            for [a, b] in sides(welded.positions([3 * at, 3 * at + 1, 3 * at + 2])) {
                match open.remove(&[b, a]) {
                    Some(first) => edges.push(([b, a], [first, at])),
                    None if open.insert([a, b], at).is_some() => return None,
                    None => {}
                }
            }
        }
        // Of the surfaces with Euler's characteristic 2, those without a dent are convex.
        let sphere = vertices.len() + triangles.len() == edges.len() + 2;
        let solid = Self { triangles, vertices, edges };
        let place = |vertex: u32| solid.place(facets, vertex);
        let convex = |([a, b], [one, two]): &([u32; 2], [u32; 2])| {
            let plane = &facets[solid.triangles[*one as usize] as usize];
            let other = facets[solid.triangles[*two as usize] as usize].corners;
            let [a, b] = [place(*a), place(*b)];
            other.iter().filter(|c| **c != a && **c != b).all(|c| (*c - a).dot(plane.normal) <= tolerance)
        };
        (open.is_empty() && sphere && solid.edges.iter().all(convex)).then_some(solid)
    }

    fn place(&self, facets: &[Facet], vertex: u32) -> DVec3 {
        let [triangle, corner] = self.vertices[vertex as usize];
        facets[triangle as usize].corners[corner as usize]
    }

    /// Whether silhouettes are nearly plane, seen from far away all around. `faces`: how many planar lamps it would be otherwise.
    pub fn is_flat(&self, facets: &[Facet], faces: usize) -> bool {
        let limit = if faces > MANY { NEARLY_FLAT } else { FLAT };
        let all: Vec<DVec3> = (0..self.vertices.len() as u32).map(|v| self.place(facets, v)).collect();
        let centre = mean(&all);
        let far = 100.0 * all.iter().map(|v| v.distance(centre)).fold(0.0, f64::max);
        let plane = |[k, l]: [u32; 2]| {
            let [u, v] = [k, l].map(|k| (f64::from(k) + 0.37) / f64::from(TRIED));
            let (z, angle) = (2.0 * u - 1.0, std::f64::consts::TAU * v);
            let around = (1.0 - z * z).sqrt();
            let direction = DVec3::new(around * angle.cos(), around * angle.sin(), z);
            let Some(seen) = self.silhouette(facets, centre + far * direction) else { return false };
            let corners: Vec<DVec3> = seen.iter().map(|&v| self.place(facets, v)).collect();
            let to_plane = orthonormal_basis(normal(&corners)).transpose();
            let (low, high) = bounds(corners.iter().map(|c| to_plane * *c));
            let size = high - low;
            size.z <= limit * size.x.max(size.y)
        };
        (0..TRIED * TRIED).all(|k| plane([k / TRIED, k % TRIED]))
    }

    /// The vertices between faces that are seen from a point and others, counter-clockwise; `None` from within.
    fn silhouette(&self, facets: &[Facet], point: DVec3) -> Option<Vec<u32>> {
        let seen: Vec<bool> = self.heights(facets, point).map(|height| height > 0.0).collect();
        let mut next = vec![u32::MAX; self.vertices.len()];
        let (mut start, mut count) = (None, 0);
        for &([a, b], [one, two]) in &self.edges {
            let [from, to] = match [seen[one as usize], seen[two as usize]] {
                [true, false] => [a, b],
                [false, true] => [b, a],
                _ => continue,
            };
            next[from as usize] = to;
            count += 1;
            start = Some(start.map_or(from, |start: u32| start.min(from)));
        }
        let start = start?;
        let mut around = vec![start];
        let mut at = next[start as usize];
        while at != start && around.len() < count {
            around.push(at);
            at = next[at as usize];
        }
        (around.len() >= 3).then_some(around)
    }

    /// What a point sees of it: a polygon, and the normal of its plane, which points to the side of the point. Its first corner has the
    /// plane before which others block. `None` from within.
    pub fn seen_from(&self, facets: &[Facet], point: DVec3) -> Option<(Polygon, DVec3)> {
        let mut around = self.silhouette(facets, point)?;
        let corners: Vec<DVec3> = around.iter().map(|&v| self.place(facets, v)).collect();
        let normal = normal(&corners);
        // From a point beside the plane, the plane across the way to it.
        let before = corners.iter().all(|c| (point - *c).dot(normal) > 0.0);
        let normal = if before { normal } else { (point - mean(&corners)).normalize_or_zero() };
        around.rotate_left(farthest(&corners, normal));
        let outline = around.iter().map(|&v| self.vertices[v as usize]).collect();
        Some((Polygon::around(self.triangles.clone(), outline), normal))
    }

    /// All of it: a polygon of all vertices, which bounds it.
    pub fn whole(self) -> Polygon {
        let mut whole = Polygon::around(self.triangles.clone(), self.vertices.clone());
        whole.solid = Some(self.into());
        whole
    }

    /// Its triangles, ascending.
    pub fn triangles(&self) -> &[u32] {
        &self.triangles
    }

    /// Whether a point sees any of it.
    pub fn is_seen_from(&self, facets: &[Facet], point: DVec3, tolerance: f64) -> bool {
        self.heights(facets, point).any(|height| height > tolerance)
    }

    /// Heights of a point over the planes of all triangles.
    fn heights(&self, facets: &[Facet], point: DVec3) -> impl Iterator<Item = f64> {
        let height = move |facet: &Facet| (point - facet.corners[0]).dot(facet.normal);
        self.triangles.iter().map(move |&i| height(&facets[i as usize]))
    }
}

/// The normal of a loop of corners, counter-clockwise.
fn normal(corners: &[DVec3]) -> DVec3 {
    let centre = mean(corners);
    let ends = |k: usize| [k, (k + 1) % corners.len()].map(|k| corners[k] - centre);
    let area: DVec3 = (0..corners.len()).map(ends).map(|[a, b]| a.cross(b)).sum();
    area.normalize_or_zero()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direct::tests::{exact, facets};
    use crate::direct::{DirectLight, Lamp, Visibility, lamps};
    use crate::model::coplanar_tolerance;
    use antirad_base::ranks::Ranks;
    use antirad_scene::{Material, Scene, SceneBuilder, Shape};
    use glam::DAffine3;
    use std::sync::Arc;

    /// A ball over a floor, and a screen that hides some of it from some of the floor.
    fn scene(level: u32, screen: bool) -> Scene {
        let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
        let black = Material::named("black");
        let place = |scale: f64, at: DVec3| {
            DAffine3::from_scale_rotation_translation(
                DVec3::splat(scale),
                glam::DQuat::from_rotation_x(0.1),
                at,
            )
        };
        let mut builder = SceneBuilder::new();
        builder.shape("floor", Shape::Quad { cells: 4 }, &black, place(2.0, DVec3::new(-1.0, 0.0, -1.0)));
        builder.shape(
            "ball",
            Shape::Icosphere { level, inward: false },
            &lamp,
            place(0.2, DVec3::new(0.1, 0.7, 0.05)),
        );
        if screen {
            builder.shape("screen", Shape::Quad { cells: 1 }, &black, place(0.3, DVec3::new(-0.1, 0.3, 0.0)));
        }
        builder.finish("ball").expect("a scene")
    }

    fn light(scene: &Scene, facets: &[Facet], lamps: Vec<Lamp>, visibility: Visibility) -> Vec<f64> {
        let light = DirectLight::new(&Ranks::default(), facets, lamps, visibility, Arc::default(), |i| {
            scene.material(i)
        })
        .expect("one rank");
        let floor = scene.meshes[0].range.clone();
        floor.map(|i| light.factors(i as usize).iter().map(|factor| factor.value).sum()).collect()
    }

    fn emitters(scene: &Scene) -> Vec<u32> {
        (0..scene.triangles.len() as u32).filter(|&i| scene.material(i as usize).emission[0] > 0.0).collect()
    }

    /// The silhouette shines as all of its faces do, whatever stands before it.
    #[test]
    fn a_silhouette_stands_for_all_faces() {
        for (level, screen, tolerance) in [(2, false, 1e-12), (3, false, 1e-12), (2, true, 1e-9)] {
            let scene = scene(level, screen);
            let facets = facets(&scene);
            let found = lamps(&scene, &facets, coplanar_tolerance(&facets));
            assert_eq!(found.len(), 1);
            assert_eq!(found[0].triangles(), emitters(&scene));
            let each = emitters(&scene).into_iter().map(Lamp::single).collect();
            let [one, all] = [found, each].map(|lamps| {
                let light = DirectLight::of_points(&facets, lamps, Visibility::Exact, |i| scene.material(i));
                let at = |i: u32| {
                    let point = facets[i as usize].centroid;
                    light.at_points(&facets, i as usize, &[point])[0]
                        .iter()
                        .map(|(_, phi)| *phi)
                        .sum::<DVec3>()
                };
                scene.meshes[0].range.clone().map(at).collect::<Vec<DVec3>>()
            });
            let brightest = all.iter().map(|phi| phi.length()).fold(0.0, f64::max);
            let error = one.iter().zip(&all).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) / brightest;
            println!("level {level}, screen {screen}: {error:.1e}");
            assert!(error <= tolerance && brightest > 0.01, "level {level}, screen {screen}: {error:e}");
        }
    }

    #[test]
    fn rays_find_the_same() {
        let scene = scene(2, true);
        let facets = facets(&scene);
        let found = || lamps(&scene, &facets, coplanar_tolerance(&facets));
        let exact = light(&scene, &facets, found(), Visibility::Exact);
        let sampled = light(&scene, &facets, found(), Visibility::Sampled);
        let [sum, difference] =
            exact.iter().zip(&sampled).fold([0.0; 2], |[sum, d], (a, b)| [sum + a, d + (a - b).abs()]);
        assert!(difference <= 0.02 * sum, "{difference} of {sum}");
    }

    /// Derivatives by the corners of ball, screen and floor, beside central differences.
    #[test]
    fn derivatives_by_corners() {
        let scene = scene(2, true);
        let at = facets(&scene);
        let lamps = lamps(&scene, &at, coplanar_tolerance(&at));
        let given = exact(&scene, &at, lamps);
        let weight = |receiver: usize| 1.0 + (receiver as f64).sin();
        let floor = scene.meshes[0].range.end as usize;
        let loss = |facets: &[Facet]| -> f64 {
            let light = given.moved(facets).expect("one rank");
            (0..floor).map(|i| weight(i) * light.factor(i, 0)).sum()
        };
        let cotangent = |receiver: usize, _: usize| if receiver < floor { weight(receiver) } else { 0.0 };
        let gradient = given.pull_back(&at, cotangent, |_| true).expect("one rank");
        // Vertices are moved with all triangles that share them, so that the ball stays closed.
        let mut moved = scene.clone();
        for vertex in [0, 30, scene.vertices.len() - 2, scene.vertices.len() - 20] {
            for axis in DVec3::AXES {
                // Where a face is seen along its edge, silhouettes turn: derivatives have kinks there, close to each other.
                let step = 1e-7;
                let mut difference = 0.0;
                for sign in [1.0, -1.0] {
                    moved.vertices[vertex] = scene.vertices[vertex] + sign * step * axis;
                    difference += sign * loss(&facets(&moved)) / (2.0 * step);
                }
                moved.vertices[vertex] = scene.vertices[vertex];
                let of_corner = |i: usize, k: usize| gradient[i].to_corners(&at[i])[k].dot(axis);
                let corners = (0..scene.triangles.len()).flat_map(|i| (0..3).map(move |k| (i, k)));
                let own = corners.filter(|&(i, k)| scene.triangles[i].vertices[k] as usize == vertex);
                let found: f64 = own.map(|(i, k)| of_corner(i, k)).sum();
                assert!(
                    (found - difference).abs() <= 1e-6 * difference.abs().max(0.1),
                    "vertex {vertex}, {axis}: {found}, not {difference}"
                );
            }
        }
    }

    #[test]
    fn what_is_no_bulb_stays_in_parts() {
        let of = |shape: Shape| {
            let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
            let mut builder = SceneBuilder::new();
            builder.shape("lamp", shape, &lamp, DAffine3::IDENTITY);
            let scene = builder.finish("lamp").expect("a scene");
            let facets = facets(&scene);
            lamps(&scene, &facets, coplanar_tolerance(&facets)).len()
        };
        assert_eq!(of(Shape::Box { cells: 2 }), 6);
        assert_eq!(of(Shape::Room { cells: 2 }), 6);
        assert_eq!(of(Shape::Icosphere { level: 2, inward: false }), 1);
        assert_eq!(of(Shape::Icosphere { level: 1, inward: true }), 80);
    }
}
