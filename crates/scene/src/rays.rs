//! Ray casting against triangles with a bounding volume hierarchy.
//!
//! The hierarchy is a compressed wide one (Ylitie, Karras and Laine, HPG 2017) of the crate `obvhs`, in f32; triangles are intersected in
//! f64.

use super::{Scene, bounds};
use glam::DVec3;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::ray::{Ray, RayHit};
use std::time::Duration;

/// Hits closer than this share of the scene's diagonal to either end of a ray count as its ends.
const EPSILON: f64 = 1e-9;
/// What boxes are grown by, and distances, in units of half the diagonal: far above the rounding of f32.
const ROUNDING: f64 = 2e-6;
/// The hierarchy leaves out what rays leave closer to their origin than 1e-4: they begin so much before it.
const BEFORE: f64 = 2e-4;
/// Rays begin so close to the middle of the scene at most, in the same units.
const AROUND: f64 = 2.0;

/// The intersection of a ray with a triangle.
struct Hit {
    distance: f64,
    /// Whether the ray comes from the front of the triangle.
    front: bool,
}

/// A side of a triangle.
pub(crate) enum Side {
    /// That of this triangle.
    Front(usize),
    Back,
}

/// The box of a triangle, grown by rounding, in a frame about such a centre with such a scale, in which the scene is within the unit ball.
pub(super) fn boxed(corners: [DVec3; 3], (centre, scale): (DVec3, f64)) -> Aabb {
    let (low, high) = bounds(corners.map(|corner| (corner - centre) * scale));
    Aabb::new((low - ROUNDING).as_vec3a(), (high + ROUNDING).as_vec3a())
}

/// A bounding volume hierarchy of the triangles of a scene, except those without area.
pub struct Rays {
    /// In a frame in which the scene is within the unit ball.
    bvh: CwBvh,
    /// The triangles in the order of the hierarchy, and their corners.
    order: Vec<u32>,
    corners: Vec<[DVec3; 3]>,
    /// The middle of the scene, and one over half its diagonal, 1/m.
    centre: DVec3,
    scale: f64,
    /// [`EPSILON`] of the scene, m.
    epsilon: f64,
}

impl Rays {
    /// Builds the tree of a scene.
    pub fn new(scene: &Scene) -> Self {
        let corners = (0..scene.triangles.len()).map(|i| scene.corners(i)).collect();
        Self::among(corners, |i| scene.degenerate.binary_search(i).is_err())
    }

    /// Builds the hierarchy of those triangles that are `solid`.
    pub fn among(corners: Vec<[DVec3; 3]>, solid: impl Fn(&u32) -> bool) -> Self {
        let solid: Vec<u32> = (0..corners.len() as u32).filter(solid).collect();
        let (low, high) = bounds(solid.iter().flat_map(|&i| corners[i as usize]));
        let size = if solid.is_empty() { 1.0 } else { (high - low).length().max(f64::MIN_POSITIVE) };
        let (centre, scale) = (0.5 * (low + high), 2.0 / size);
        let boxes: Vec<Aabb> = solid.iter().map(|&i| boxed(corners[i as usize], (centre, scale))).collect();
        let bvh = match boxes.is_empty() {
            true => CwBvh::default(),
            false => build_cwbvh(&boxes, BvhBuildParams::fast_build(), &mut Duration::default()),
        };
        let order: Vec<u32> = bvh.primitive_indices.iter().map(|&k| solid[k as usize]).collect();
        let corners = order.iter().map(|&i| corners[i as usize]).collect();
        Self { bvh, order, corners, centre, scale, epsilon: EPSILON * size }
    }

    /// The nearest triangle along a unit direction and its distance, m; never `from`, where the ray starts. Of the two sides of a sheet it
    /// is the one that faces the ray.
    pub fn nearest(&self, origin: DVec3, direction: DVec3, from: Option<usize>) -> Option<(usize, f64)> {
        let mut best: Option<(usize, Hit)> = None;
        self.visit(origin, direction, f64::INFINITY, |triangle, hit| {
            if Some(triangle) == from {
                return None;
            }
            let nearer = best.as_ref().is_none_or(|(_, best)| {
                let coincide = (hit.distance - best.distance).abs() <= self.epsilon;
                if coincide { hit.front && !best.front } else { hit.distance < best.distance }
            });
            nearer.then(|| {
                let limit = hit.distance + self.epsilon;
                best = Some((triangle, hit));
                limit
            })
        });
        best.map(|(triangle, hit)| (triangle, hit.distance))
    }

    /// The side of a triangle that a ray along a unit direction meets first, `None` for nothing, or for both sides of a sheet and two
    /// surfaces that touch. Never `from`, where it starts.
    pub(crate) fn first_side(&self, origin: DVec3, direction: DVec3, from: usize) -> Option<Side> {
        // The nearest back and front, and their distances.
        let mut nearest = [(f64::INFINITY, from); 2];
        self.visit(origin, direction, f64::INFINITY, |triangle, hit| {
            let side = usize::from(hit.front);
            let nearer = triangle != from && hit.distance < nearest[side].0;
            nearer.then(|| {
                nearest[side] = (hit.distance, triangle);
                nearest[0].0.min(nearest[1].0) + self.epsilon
            })
        });
        let [(back, _), (front, triangle)] = nearest;
        let side = if front < back { Side::Front(triangle) } else { Side::Back };
        ((back - front).abs() > self.epsilon).then_some(side)
    }

    /// All fronts along a unit direction, from near to far, with their distances, m; without `from`, where the ray starts.
    pub fn fronts(&self, origin: DVec3, direction: DVec3, from: usize) -> Vec<(usize, f64)> {
        let mut fronts = Vec::new();
        self.visit(origin, direction, f64::INFINITY, |triangle, hit| {
            if hit.front && triangle != from {
                fronts.push((triangle, hit.distance));
            }
            None
        });
        fronts.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        fronts
    }

    /// Whether any triangle lies between two points, front or back, that is not an exception.
    pub fn blocked(&self, from: DVec3, to: DVec3, exception: impl Fn(usize) -> bool) -> bool {
        let length = from.distance(to);
        let direction = (to - from) / length;
        let mut found = false;
        self.visit(from, direction, length, |triangle, hit| {
            found = found || hit.distance < length - self.epsilon && !exception(triangle);
            // No other hit matters.
            found.then_some(f64::NEG_INFINITY)
        });
        found
    }

    /// Calls `call` with triangles that the ray meets, all of those within a limit, roughly from near to far. The limit, m, is the
    /// last that a call returned.
    fn visit(
        &self,
        origin: DVec3,
        direction: DVec3,
        limit: f64,
        mut call: impl FnMut(usize, Hit) -> Option<f64>,
    ) {
        // From far away a ray begins close by, where f32 is accurate.
        let (from, length) = ((origin - self.centre) * self.scale, direction.length());
        let skipped = (-from.dot(direction) / (length * length) - AROUND / length).max(0.0) - BEFORE;
        let shortened = |limit: f64| (((limit * self.scale) - skipped) * (1.0 + ROUNDING) + ROUNDING) as f32;
        let begin = (from + skipped * direction).as_vec3a();
        let ray = Ray::new(begin, direction.as_vec3a(), 0.0, shortened(limit));
        self.bvh.ray_traverse(ray, &mut RayHit::none(), |_, k| {
            let hit = self.hit(k, origin, direction);
            hit.and_then(|hit| call(self.order[k] as usize, hit)).map_or(f32::INFINITY, shortened)
        });
    }

    /// The intersection of a ray with a triangle by its place in the hierarchy, if there is one (Möller and Trumbore 1997).
    fn hit(&self, at: usize, origin: DVec3, direction: DVec3) -> Option<Hit> {
        let [a, b, c] = self.corners[at];
        let (ab, ac) = (b - a, c - a);
        let p = direction.cross(ac);
        let determinant = ab.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let s = origin - a;
        let u = s.dot(p) / determinant;
        let q = s.cross(ab);
        let v = direction.dot(q) / determinant;
        let distance = ac.dot(q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > self.epsilon)
            .then_some(Hit { distance, front: determinant > 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Material, SceneBuilder, Shape};
    use glam::DAffine3;

    fn scene(far: f64, size: f64) -> Scene {
        let grey = Material::named("grey");
        let place = |scale: [f64; 3], to: [f64; 3]| {
            let away =
                DAffine3::from_translation(DVec3::splat(far)) * DAffine3::from_scale(DVec3::splat(size));
            away * DAffine3::from_translation(to.into()) * DAffine3::from_scale(scale.into())
        };
        let mut builder = SceneBuilder::new();
        builder.shape("floor", Shape::Quad { cells: 4 }, &grey, place([1.0; 3], [0.0; 3]));
        for height in [0.3, 0.4, 0.5] {
            let plate = Shape::Slab { cells: 4 };
            builder.shape("plate", plate, &grey, place([1.0, 0.01, 1.0], [0.0, height, 0.0]));
        }
        builder.shape(
            "ball",
            Shape::Icosphere { level: 2, inward: false },
            &grey,
            place([0.2; 3], [0.5, 1.2, 0.5]),
        );
        builder.finish("plates").expect("a scene")
    }

    /// The nearest of all triangles, and whether any is in between, from faces, from within and from far away, wherever a scene lies.
    #[test]
    fn rays_meet_what_they_meet_without_a_hierarchy() {
        for (far, size) in [(0.0, 1.0), (0.0, 1e-9), (4.5e6, 1e3), (1e3, 1.0)] {
            let scene = scene(far, size);
            let rays = Rays::new(&scene);
            let mut state = 1u64;
            let mut random = move || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            };
            let middle = rays.centre;
            for k in 0..20_000 {
                let from = (random() * scene.triangles.len() as f64) as usize;
                let [a, b, c] = scene.corners(from);
                let on_face = a + random().sqrt() * ((b - a) + random() * (c - b));
                let direction = (DVec3::new(random(), random(), random()) - 0.5).normalize();
                let away = [0.0, 0.0, 1e3, 1e6][k % 4] * size;
                let origin = on_face - away * direction;
                let hits = (0..rays.order.len()).filter_map(|at| {
                    let hit = rays.hit(at, origin, direction)?;
                    (rays.order[at] as usize != from).then_some(hit.distance)
                });
                let truth = hits.fold(f64::INFINITY, f64::min);
                let found = rays.nearest(origin, direction, Some(from)).map_or(f64::INFINITY, |(_, at)| at);
                let same = truth == found || (truth - found).abs() <= 2.0 * rays.epsilon;
                assert!(same, "{far} {size} {k}: {found}, not {truth}, around {middle}");
            }
        }
    }
}
