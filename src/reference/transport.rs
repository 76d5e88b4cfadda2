//! U: light from every triangle to every other, with no visibility test. Twin of glsl/transport_*.comp and
//! glsl/near.comp.

use super::geometry::{Facet, centroid, quarters};
use super::near_field::{QUARTER_RANGE, far_share, projected_solid_angle};
use super::{Leaving, Model, State};
use glam::DVec3;
use rayon::prelude::*;

/// H_j(b) += T_b(ω_j) max(cos_j, 0) g_ij a_i |cos_i| · (front: L_i(ω_i); back: -A_i(ω_i)), for all i and j; the state
/// keeps H_j(b) / c_b.
pub fn transport(model: &Model, leaving: &Leaving) -> State {
    let arriving: Vec<Arriving> = (0..model.facets.len())
        .into_par_iter()
        .map(|j| {
            let mut arriving = Arriving::new(model, j);
            for i in 0..model.facets.len() {
                arriving.from(leaving, i);
            }
            arriving
        })
        .collect();
    let mut state = model.zero();
    for (j, arriving) in arriving.into_iter().enumerate() {
        state.irradiance[j] = arriving.irradiance;
        if let Some(range) = model.bins_of(j) {
            for ((bin, h), c) in state.bins[range].iter_mut().zip(arriving.bins).zip(&model.bins.projected) {
                *bin = h / *c;
            }
        }
    }
    state
}

/// What arrives at one triangle.
struct Arriving<'a> {
    model: &'a Model,
    receiver: &'a Facet,
    j: usize,
    irradiance: DVec3,
    /// Empty where the receiver has no bins.
    bins: Vec<DVec3>,
}

impl<'a> Arriving<'a> {
    fn new(model: &'a Model, j: usize) -> Self {
        let receiver = &model.facets[j];
        Self {
            model,
            receiver,
            j,
            irradiance: DVec3::ZERO,
            bins: vec![DVec3::ZERO; model.bins_of(j).map_or(0, |range| range.len())],
        }
    }

    fn from(&mut self, leaving: &Leaving, i: usize) {
        let source = &self.model.facets[i];
        if source.area == 0.0 || self.receiver.area == 0.0 {
            return;
        }
        let r2 = (self.receiver.centroid - source.centroid).length_squared();
        let share = far_share(r2, self.model.range(i, self.j));
        if share > 0.0 {
            self.far(leaving, i, r2, share);
        }
        if share < 1.0 {
            self.near(leaving, i, 1.0 - share);
        }
    }

    /// Centroid to centroid.
    fn far(&mut self, leaving: &Leaving, i: usize, r2: f64, share: f64) {
        let source = &self.model.facets[i];
        let direction = (self.receiver.centroid - source.centroid) / r2.sqrt();
        let (cos_i, cos_j) = (direction.dot(source.normal), -direction.dot(self.receiver.normal));
        if cos_j > 0.0 && cos_i != 0.0 {
            let radiance = leaving.radiance(self.model, i, direction, cos_i > 0.0);
            let g = 1.0 / (r2 + source.area / std::f64::consts::PI);
            self.deposit(-direction, radiance * (share * cos_j * cos_i.abs() * source.area * g));
        }
    }

    /// Quarter to quarter; and for radiance that varies with direction, where two quarters are close for their own size,
    /// quarter of a quarter to quarter of a quarter.
    fn near(&mut self, leaving: &Leaving, i: usize, share: f64) {
        let source = &self.model.facets[i];
        for to in quarters(self.receiver.corners) {
            for from in quarters(source.corners) {
                let r2 = (centroid(to) - centroid(from)).length_squared();
                let far = match self.model.classes[i].has_bins() {
                    true => far_share(r2, self.model.range(i, self.j) * QUARTER_RANGE),
                    false => 1.0,
                };
                self.piece(leaving, i, from, centroid(to), share / 4.0, share * far / 4.0);
                if far < 1.0 {
                    for to in quarters(to) {
                        for from in quarters(from) {
                            self.piece(leaving, i, from, centroid(to), 0.0, share * (1.0 - far) / 16.0);
                        }
                    }
                }
            }
        }
    }

    /// From a piece of the source to a point of the receiver, by Lambert's polygon formula, which is exact for uniform
    /// radiance: `diffuse` and `binned` are the shares of the two kinds of radiance.
    fn piece(
        &mut self,
        leaving: &Leaving,
        i: usize,
        from: [DVec3; 3],
        point: DVec3,
        diffuse: f64,
        binned: f64,
    ) {
        let source = &self.model.facets[i];
        let offset = point - centroid(from);
        let side = offset.dot(source.normal);
        let projected = projected_solid_angle(point, self.receiver.normal, from);
        if side != 0.0 && projected > 0.0 {
            let direction = offset.normalize();
            let radiance = diffuse * leaving.diffuse(i, side > 0.0)
                + binned * leaving.binned(self.model, i, direction, side > 0.0);
            self.deposit(-direction, radiance * projected);
        }
    }

    /// Irradiance from `direction` (receiver to source).
    fn deposit(&mut self, direction: DVec3, irradiance: DVec3) {
        self.irradiance += irradiance;
        if !self.bins.is_empty() {
            for (b, weight) in self.model.bins.taps(self.receiver.to_local(direction)) {
                self.bins[b] += weight * irradiance;
            }
        }
    }
}
