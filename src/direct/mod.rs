//! Direct light of lamps, with exact visibility, on the host in f64.
//!
//! What a receiver sees of a lamp is the lamp's cone of directions less the cones of all triangles in between. The rest is cut into
//! convex cones, each of which Lambert's formula integrates exactly, so that there is no sampling noise, and the boundaries of what is
//! visible move smoothly with every vertex. Only the mean over a receiver is a quadrature.

mod cone;
mod lamps;
mod quadrature;
mod shaft;
mod visible;

pub use lamps::{Lamp, lamps};

use crate::model::{Facet, coplanar_tolerance, spatial_order};
use cone::vector_irradiance;
use glam::DVec3;
use quadrature::{Quadrature, Sample};
use rayon::prelude::*;
use visible::{Geometry, Placed, Visible};

/// Per receiver and lamp, the irradiance per radiance of the lamp: a form factor times π.
pub struct Factors {
    lamps: usize,
    values: Vec<f64>,
}

impl Factors {
    /// Of one receiver, lamp by lamp, sr.
    pub fn of(&self, receiver: usize) -> &[f64] {
        &self.values[receiver * self.lamps..(receiver + 1) * self.lamps]
    }
}

/// Light of lamps on the triangles of a scene.
pub struct DirectLight {
    facets: Vec<Facet>,
    order: Vec<u32>,
    tolerance: f64,
    lamps: Vec<Lamp>,
    quadrature: Quadrature,
}

impl DirectLight {
    /// For triangles in any unit of length.
    pub fn new(facets: &[Facet], lamps: Vec<Lamp>) -> Self {
        Self {
            facets: facets.to_vec(),
            order: spatial_order(facets),
            tolerance: coplanar_tolerance(facets),
            lamps,
            quadrature: Quadrature::default(),
        }
    }

    /// The lamps.
    pub fn lamps(&self) -> &[Lamp] {
        &self.lamps
    }

    /// Irradiance factors of every triangle.
    pub fn factors(&self) -> Factors {
        let geometry = Geometry::new(&self.facets, self.order.clone(), self.tolerance);
        let placed: Vec<Placed> = self.lamps.iter().map(|lamp| geometry.place(lamp)).collect();
        let of_receiver = |visible: &mut Visible, receiver: usize| -> Vec<f64> {
            let of_lamp = |lamp: &Placed| self.samples(&geometry, visible, receiver, lamp).iter().map(|(s, v)| s.weight * v).sum();
            placed.iter().map(of_lamp).collect()
        };
        let values = (0..self.facets.len())
            .into_par_iter()
            .map_init(Visible::default, of_receiver)
            .flatten_iter()
            .collect();
        Factors { lamps: self.lamps.len(), values }
    }

    /// Points of a receiver with the irradiance per radiance of a lamp.
    fn samples(
        &self,
        geometry: &Geometry,
        visible: &mut Visible,
        receiver: usize,
        lamp: &Placed,
    ) -> Vec<(Sample, f64)> {
        let facet = &self.facets[receiver];
        if facet.area == 0.0 || !faces(facet, lamp, self.tolerance) {
            return Vec::new();
        }
        let blockers = geometry.blockers(&facet.corners, facet.normal, lamp);
        self.quadrature.samples(&mut |b| {
            let point = facet.corners[0] * b.x + facet.corners[1] * b.y + facet.corners[2] * b.z;
            let mut sum = DVec3::ZERO;
            visible.parts(geometry, point, facet.normal, lamp, &blockers, false, &mut |part| {
                sum += vector_irradiance(part);
            });
            sum.dot(facet.normal)
        })
    }
}

/// Whether a triangle and the front of a lamp can see each other.
fn faces(facet: &Facet, lamp: &Placed, tolerance: f64) -> bool {
    let above = |plane: DVec3, normal: DVec3, corner: &DVec3| (*corner - plane).dot(normal) > tolerance;
    lamp.corners.iter().any(|c| above(facet.centroid, facet.normal, c))
        && facet.corners.iter().any(|c| above(lamp.corners[0], lamp.normal, c))
}
