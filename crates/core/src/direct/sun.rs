//! Lamps at infinity: suns, each a regular polygon of directions in place of its disc.
//!
//! As a point sees it, such a lamp is a polygon beyond everything else that moves with the point: all that holds for planar lamps holds
//! for it, and nothing reaches its plane. It has no triangles: derivatives by positions are those of blockers and receivers alone.

use super::cone::{Side, sides, vector_irradiance};
use antirad_scene::{Scene, Sun};
use glam::DVec3;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Corners of the polygon. It is nowhere farther from the limb than 2.5 % of the radius.
const CORNERS: u32 = 12;

/// A sun, as a lamp.
#[derive(Clone, Debug, PartialEq)]
pub struct Disc {
    sun: Sun,
    /// Directions to its corners, counter-clockwise seen from where it shines, in a plane at distance 1.
    corners: Vec<DVec3>,
    /// Its projected solid angle for a receiver that faces it, sr.
    projected: f64,
    /// Triangles that stand behind it, ascending.
    behind: Arc<[u32]>,
}

impl Disc {
    /// The suns of a scene.
    pub fn all(scene: &Scene) -> Vec<Self> {
        let behind: Arc<[u32]> = if scene.suns.is_empty() { Vec::new() } else { scene.behind_suns() }.into();
        scene.suns.iter().map(|sun| Self::new(sun.clone(), behind.clone())).collect()
    }

    fn new(sun: Sun, behind: Arc<[u32]>) -> Self {
        let along = sun.travels();
        let u = along.any_orthonormal_vector();
        let v = along.cross(u);
        let step = TAU / f64::from(CORNERS);
        // As large as the disc, where it stands out of the axis.
        let radius = sun.angular_radius().tan() * (step / step.sin()).sqrt();
        let corner = |k: u32| {
            let (sin, cos) = (step * f64::from(k)).sin_cos();
            radius * (u * cos + v * sin) - along
        };
        let corners: Vec<DVec3> = (0..CORNERS).map(corner).collect();
        // The front is seen clockwise.
        let cone: Vec<Side> = corners.iter().rev().map(|&corner| Side { corner, plane: 0 }).collect();
        let projected = vector_irradiance(sides(&cone)).length();
        Self { sun, corners, projected, behind }
    }

    /// The direction in which its light travels, the normal of its front.
    pub fn normal(&self) -> DVec3 {
        self.sun.travels()
    }

    /// Directions to its corners.
    pub fn corners(&self) -> &[DVec3] {
        &self.corners
    }

    /// Its projected solid angle for a receiver that faces it, sr.
    pub fn projected(&self) -> f64 {
        self.projected
    }

    /// Its radiance, W/(m² sr).
    pub fn radiance(&self) -> DVec3 {
        DVec3::from(self.sun.irradiance) / self.projected
    }

    /// Whether it is the same but for its irradiance.
    pub fn is_at(&self, other: &Self) -> bool {
        self.corners == other.corners && self.behind == other.behind
    }

    /// Whether it shines through a triangle, which stands behind it.
    pub fn is_before(&self, triangle: u32) -> bool {
        self.behind.binary_search(&triangle).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direct::tests::{exact, facets};
    use crate::direct::{DirectLight, lamps};
    use crate::model::Facet;
    use antirad_scene::{Material, SceneBuilder, Shape};
    use glam::DAffine3;

    /// A box over a floor beside a wall, under a wide sun and a narrow one.
    fn scene() -> Scene {
        let black = Material::named("black");
        let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
        let turned = DAffine3::from_rotation_y(0.37) * DAffine3::from_rotation_x(0.14);
        let small = DAffine3::from_scale(DVec3::splat(0.4));
        let mut builder = SceneBuilder::new();
        builder
            .shape("floor", Shape::Quad { cells: 2 }, &black, DAffine3::IDENTITY)
            .shape("box", Shape::Box { cells: 2 }, &black, at(0.3, 0.2, 0.37) * turned * small)
            .shape("wall", Shape::Quad { cells: 2 }, &black, DAffine3::from_rotation_z(-1.5));
        let mut scene = builder.finish("sun").expect("a scene");
        let mut sun = Sun::new(DVec3::new(-0.6, -1.0, 0.3), [1.0; 3]);
        sun.angular_diameter = 15.0;
        scene.suns = vec![sun, Sun::new(DVec3::new(0.3, -1.0, 0.2), [1.0; 3])];
        scene
    }

    /// The polygon is as large as the disc, and its light on a surface is that which is stated.
    #[test]
    fn a_polygon_stands_for_a_disc() {
        let mut scene = scene();
        for (diameter, tolerance) in [(0.01, 1e-6), (0.53, 1e-6), (20.0, 3e-3), (90.0, 4e-2)] {
            scene.suns[0].angular_diameter = diameter;
            let disc = &Disc::all(&scene)[0];
            let truth = std::f64::consts::PI * scene.suns[0].angular_radius().sin().powi(2);
            assert!((disc.projected() / truth - 1.0).abs() <= tolerance, "{diameter}: {}", disc.projected());
            assert!((disc.radiance() * disc.projected() - DVec3::ONE).length() < 1e-12);
        }
    }

    /// By every vertex, of receivers and of what stands before them, beside central differences.
    #[test]
    fn derivatives_by_corners() {
        let scene = scene();
        let at = facets(&scene);
        let given = exact(&scene, &at, lamps(&scene, &at, 1e-9));
        let weight = |receiver: usize, lamp: usize| (1.0 + (receiver as f64).sin()) * [1.0, 40.0][lamp];
        let loss = |light: &DirectLight| -> f64 {
            let of = |i: usize| (0..2).map(move |l| (i, l));
            (0..at.len()).flat_map(of).map(|(i, l)| weight(i, l) * light.factor(i, l)).sum()
        };
        let gradient = given.pull_back(&at, weight, |_| true).expect("one rank");
        let mut by_vertex = vec![DVec3::ZERO; scene.vertices.len()];
        for ((triangle, gradient), facet) in scene.triangles.iter().zip(&gradient).zip(&at) {
            triangle
                .vertices
                .iter()
                .zip(gradient.to_corners(facet))
                .for_each(|(&v, by)| by_vertex[v as usize] += by);
        }
        let largest = by_vertex.iter().map(|by| by.length()).fold(0.0, f64::max);
        let step = 1e-7;
        for (vertex, by) in by_vertex.iter().enumerate().step_by(2) {
            for axis in 0..3 {
                let moved = |by: f64| {
                    let mut scene = scene.clone();
                    scene.vertices[vertex][axis] += by;
                    let facets: Vec<Facet> = facets(&scene);
                    loss(&given.moved(&facets).expect("one rank"))
                };
                let difference = (moved(step) - moved(-step)) / (2.0 * step);
                let error = (difference - by[axis]).abs() / largest;
                assert!(error <= 1e-5, "vertex {vertex}, {axis}: {}, not {difference}", by[axis]);
            }
        }
    }
}
