//! Direct light of lamps, with exact visibility, on the host in f64.
//!
//! What a point sees of a lamp is the lamp's cone of directions less the cones of all triangles in between. The rest is cut into
//! convex cones, each of which Lambert's formula integrates exactly, so that there is no sampling noise, and the boundaries of what is
//! visible move smoothly with every vertex. Only the mean over a receiver is a quadrature.

mod cone;
mod derivative;
mod lamps;
mod quadrature;
mod shaft;
mod visible;

pub use lamps::{Lamp, lamps};

use crate::model::{Facet, FacetGradient};
use derivative::{Contributions, Sight};
use glam::DVec3;
use quadrature::{Quadrature, Sample};
use rayon::prelude::*;
use visible::{Geometry, Placed, Tree, Visible};

/// Light of lamps on the triangles of a scene.
pub struct DirectLight {
    tree: Tree,
    lamps: Vec<Lamp>,
    receivers: usize,
    /// By receiver, then lamp.
    factors: Vec<f64>,
    quadrature: Quadrature,
}

impl DirectLight {
    /// Computes the light of lamps on triangles, in any unit of length.
    pub fn new(facets: &[Facet], lamps: Vec<Lamp>) -> Self {
        Self::with(facets, lamps, Quadrature::default())
    }

    fn with(facets: &[Facet], lamps: Vec<Lamp>, quadrature: Quadrature) -> Self {
        let mut light =
            Self { tree: Tree::new(facets), lamps, receivers: facets.len(), factors: Vec::new(), quadrature };
        let geometry = light.geometry(facets);
        let placed: Vec<Placed> = light.lamps.iter().map(|lamp| geometry.place(lamp)).collect();
        let mean = |visible: &mut Visible, receiver: usize, lamp: &Placed| {
            let blockers = geometry.blockers_of(receiver, lamp);
            let samples = light.samples(geometry, visible, receiver, lamp, &blockers);
            samples.iter().map(|(sample, value)| sample.weight * value).sum::<f64>()
        };
        let factors = (0..facets.len())
            .into_par_iter()
            .map_init(Visible::default, |visible, receiver| {
                placed.iter().map(|lamp| mean(visible, receiver, lamp)).collect::<Vec<f64>>()
            })
            .flatten_iter()
            .collect();
        light.factors = factors;
        light
    }

    fn geometry<'a>(&'a self, facets: &'a [Facet]) -> Geometry<'a> {
        Geometry { facets, tree: &self.tree }
    }

    /// The lamps.
    pub fn lamps(&self) -> &[Lamp] {
        &self.lamps
    }

    /// Mean irradiance of a triangle per radiance of each lamp, sr: its form factor times π.
    pub fn factors(&self, receiver: usize) -> &[f64] {
        &self.factors[receiver * self.lamps.len()..(receiver + 1) * self.lamps.len()]
    }

    /// Irradiance of each triangle, W/m², RGB; `emission`: radiance of each triangle, W/(m² sr).
    pub fn irradiance(&self, emission: impl Fn(usize) -> [f64; 3]) -> Vec<DVec3> {
        let radiance: Vec<DVec3> =
            self.lamps.iter().map(|lamp| DVec3::from(emission(lamp.first()))).collect();
        let of = |receiver| self.factors(receiver).iter().zip(&radiance).map(|(&f, &l)| f * l).sum();
        (0..self.receivers).map(of).collect()
    }

    /// Derivatives of a loss by the triangles, where `cotangent` is its derivative by [`Self::factors`] of a receiver and a lamp.
    pub fn pull_back(
        &self,
        facets: &[Facet],
        cotangent: impl Fn(usize, usize) -> f64 + Sync,
    ) -> Vec<FacetGradient> {
        let geometry = self.geometry(facets);
        let placed: Vec<Placed> = self.lamps.iter().map(|lamp| geometry.place(lamp)).collect();
        let of_receiver = |visible: &mut Visible, receiver: usize| {
            let mut to = Contributions::default();
            for (l, lamp) in placed.iter().enumerate() {
                let weight = cotangent(receiver, l);
                if weight != 0.0 {
                    self.pull_back_to(geometry, visible, [receiver, l], lamp, weight, &mut to);
                }
            }
            to.merged()
        };
        let mut gradients = vec![FacetGradient::default(); facets.len()];
        for first in (0..facets.len()).step_by(RECEIVERS) {
            let receivers = first..facets.len().min(first + RECEIVERS);
            let parts: Vec<_> = receivers.into_par_iter().map_init(Visible::default, of_receiver).collect();
            // One after the other, so that sums are the same from run to run.
            for (triangle, gradient) in parts.into_iter().flatten() {
                gradients[triangle as usize] += gradient;
            }
        }
        gradients
    }

    fn pull_back_to(
        &self,
        geometry: Geometry,
        visible: &mut Visible,
        [receiver, l]: [usize; 2],
        lamp: &Placed,
        weight: f64,
        to: &mut Contributions,
    ) {
        if self.factors(receiver)[l] == 0.0 {
            return;
        }
        let Facet { corners, normal, .. } = geometry.facets[receiver];
        let blockers = geometry.blockers_of(receiver, lamp);
        let mut own = FacetGradient::default();
        for (Sample { barycentric, weight: share }, _) in
            self.samples(geometry, visible, receiver, lamp, &blockers)
        {
            let sight =
                Sight { geometry, point: at(corners, barycentric), normal, lamp, blockers: &blockers };
            let (light, by_point) = sight.pull_back(visible, weight * share * normal, to);
            own.normal += weight * share * light;
            for (corner, b) in own.corners.iter_mut().zip(barycentric.to_array()) {
                *corner += b * by_point;
            }
        }
        to.add(receiver as u32, own);
    }

    /// Points of a receiver with the irradiance per radiance of a lamp.
    fn samples(
        &self,
        geometry: Geometry,
        visible: &mut Visible,
        receiver: usize,
        lamp: &Placed,
        blockers: &[u32],
    ) -> Vec<(Sample, f64)> {
        let Facet { corners, normal, .. } = geometry.facets[receiver];
        if !geometry.faces(receiver, lamp) {
            return Vec::new();
        }
        self.quadrature.samples(&mut |b| {
            let sight = Sight { geometry, point: at(corners, b), normal, lamp, blockers };
            sight.vector_irradiance(visible).dot(normal)
        })
    }
}

/// Receivers whose derivatives are held in memory at a time.
const RECEIVERS: usize = 4096;

/// The point with given barycentric coordinates.
fn at([a, b, c]: [DVec3; 3], barycentric: DVec3) -> DVec3 {
    a * barycentric.x + b * barycentric.y + c * barycentric.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, Scene, SceneBuilder, Shape};
    use glam::DAffine3;
    use rand::{RngExt, SeedableRng};

    /// A jittered floor, three blockers, one of which crosses the plane of the lamp, and a lamp of eight triangles.
    fn scene() -> Scene {
        let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
        let black = Material::named("black");
        let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
        let down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
        let tilted = DAffine3::from_rotation_x(1.2) * DAffine3::from_rotation_y(0.4);
        let small = DAffine3::from_scale(DVec3::splat(0.4));
        let mut builder = SceneBuilder::new();
        builder
            .shape("floor", Shape::Quad { cells: 2 }, &black, at(0.0, 0.0, 0.0))
            .shape("low", Shape::Quad { cells: 1 }, &black, at(0.1, 0.4, 0.07) * small)
            .shape("high", Shape::Quad { cells: 1 }, &black, at(-0.2, 0.7, 0.1) * tilted * small)
            .shape("crossing", Shape::Quad { cells: 1 }, &black, at(0.3, 0.95, -0.1) * tilted * small)
            .shape("lamp", Shape::Quad { cells: 2 }, &lamp, at(0.05, 1.0, 0.0) * down * small);
        let mut scene = builder.finish("direct").expect("a scene");
        let mut random = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(7);
        let jitter = scene.vertices.len() - 9;
        for vertex in &mut scene.vertices[..jitter] {
            *vertex += DVec3::from_array(random.random::<[f64; 3]>()) * 0.03;
        }
        scene
    }

    fn facets(scene: &Scene) -> Vec<Facet> {
        (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect()
    }

    fn weight(receiver: usize, _: usize) -> f64 {
        1.0 + (receiver as f64).sin()
    }

    fn loss(facets: &[Facet], lamps: &[Lamp]) -> f64 {
        let light = DirectLight::with(facets, lamps.to_vec(), Quadrature::uniform(2));
        (0..facets.len()).map(|receiver| weight(receiver, 0) * light.factors(receiver)[0]).sum()
    }

    /// Central differences with fixed points.
    #[test]
    fn derivatives_are_those_of_central_differences() {
        let scene = scene();
        let facets = facets(&scene);
        let lamps = lamps(&scene, &facets, 1e-9);
        assert_eq!(lamps.len(), 1);
        assert_eq!((lamps[0].corners.len(), lamps[0].outline.len()), (4, 8));
        let light = DirectLight::with(&facets, lamps.clone(), Quadrature::uniform(2));
        let gradients: Vec<[DVec3; 3]> =
            light.pull_back(&facets, weight).iter().zip(&facets).map(|(g, f)| g.to_corners(f)).collect();
        // What moves are all vertices of the outline, not only those that are corners now.
        let moving = vec![Lamp { corners: lamps[0].outline.clone(), ..lamps[0].clone() }];
        // Vertices move with all triangles that share them: a lamp stays one piece.
        let mut by_vertex = vec![DVec3::ZERO; scene.vertices.len()];
        for (triangle, gradient) in scene.triangles.iter().zip(&gradients) {
            triangle.vertices.iter().zip(gradient).for_each(|(&v, g)| by_vertex[v as usize] += *g);
        }
        let step = 1e-5;
        let largest = by_vertex.iter().map(|g| g.length()).fold(0.0, f64::max);
        let mut worst = 0.0_f64;
        for (vertex, gradient) in by_vertex.iter().enumerate() {
            let emits = vertex >= scene.vertices.len() - 9;
            for axis in 0..3 {
                // Out of its plane, the lamp would come apart.
                if emits && axis == 1 {
                    continue;
                }
                let moved = |by: f64| {
                    let mut scene = scene.clone();
                    scene.vertices[vertex][axis] += by;
                    loss(&self::facets(&scene), &moving)
                };
                let difference = (moved(step) - moved(-step)) / (2.0 * step);
                let error = (difference - gradient[axis]).abs() / largest;
                worst = worst.max(error);
            }
        }
        println!("{worst:e} of {largest}");
        assert!(worst <= 1e-6, "{worst:e}");
    }
}
