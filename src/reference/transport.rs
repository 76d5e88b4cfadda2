//! U: transport between all pairs of triangles, without visibility tests. Twin of glsl/transport_*.comp and glsl/near.comp.

use super::{Model, Outgoing, State};
use crate::model::projected_solid_angle;
use crate::model::{QUARTER_RANGE, centroid, far_weight, quarters};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// H_j(b) += T_b(ω_j) max(cos_j, 0) g_ij a_i |cos_i| · (front: L_i(ω_i); back: -A_i(ω_i)), for all i and j; the state holds
/// H_j(b) / c_b.
pub fn transport(model: &Model, outgoing: &Outgoing) -> State {
    let incident: Vec<Incident> = (0..model.facets.len())
        .into_par_iter()
        .map(|j| {
            let mut incident = Incident::new(model, j);
            for i in 0..model.facets.len() {
                incident.from(outgoing, i);
            }
            incident
        })
        .collect();
    collect(model, incident)
}

/// The irradiance of some triangles by [`transport`], where that of all would take too long.
pub fn irradiance_of(model: &Model, outgoing: &Outgoing, receivers: &[usize]) -> Vec<DVec3> {
    let of = |&j: &usize| {
        let mut irradiance = DVec3::ZERO;
        for i in 0..model.facets.len() {
            beams(model, i, j, |beam| {
                irradiance += beam.diffuse * outgoing.diffuse(i, beam.front)
                    + beam.binned * outgoing.binned(model, i, beam.direction, beam.front);
            });
        }
        irradiance
    };
    receivers.par_iter().map(of).collect()
}

/// The state of all incident light.
pub(super) fn collect(model: &Model, incident: Vec<Incident>) -> State {
    let mut state = model.zero();
    for (j, incident) in incident.into_iter().enumerate() {
        state.irradiance[j] = incident.irradiance;
        if let Some(range) = model.bins_of(j) {
            for ((bin, h), c) in state.bins[range].iter_mut().zip(incident.bins).zip(&model.bins.projected) {
                *bin = h / *c;
            }
        }
    }
    state
}

/// Incident light of one triangle.
pub(super) struct Incident<'a> {
    pub model: &'a Model,
    pub j: usize,
    irradiance: DVec3,
    /// Empty where the receiver has no bins.
    bins: Vec<DVec3>,
}

impl<'a> Incident<'a> {
    pub fn new(model: &'a Model, j: usize) -> Self {
        let bins = vec![DVec3::ZERO; model.bins_of(j).map_or(0, |range| range.len())];
        Self { model, j, irradiance: DVec3::ZERO, bins }
    }

    fn from(&mut self, outgoing: &Outgoing, i: usize) {
        beams(self.model, i, self.j, |beam| self.receive(outgoing, i, beam));
    }

    /// Adds what triangle `i` sends along a beam.
    pub fn receive(&mut self, outgoing: &Outgoing, i: usize, beam: Beam) {
        let radiance = beam.diffuse * outgoing.diffuse(i, beam.front)
            + beam.binned * outgoing.binned(self.model, i, beam.direction, beam.front);
        self.deposit(-beam.direction, radiance);
    }

    /// Adds irradiance from `direction` (receiver to source).
    pub fn deposit(&mut self, direction: DVec3, irradiance: DVec3) {
        self.irradiance += irradiance;
        if !self.bins.is_empty() {
            for (b, weight) in self.model.bins.taps(self.model.facets[self.j].to_local(direction)) {
                self.bins[b] += weight * irradiance;
            }
        }
    }
}

/// Transport along one line from a source to a receiver. The irradiance is `diffuse` times the uniform part of the radiance plus
/// `binned` times the part that varies with direction.
pub(super) struct Beam {
    /// Unit, from the source to the receiver.
    pub direction: DVec3,
    /// Whether the receiver is on the front side of the source.
    pub front: bool,
    /// Projected solid angle for uniform radiance, sr.
    pub diffuse: f64,
    /// Projected solid angle for directional radiance, sr.
    pub binned: f64,
}

/// The lines along which light travels from source `i` to receiver `j`. U and its transpose both use them, so that they agree.
pub(super) fn beams(model: &Model, i: usize, j: usize, mut visit: impl FnMut(Beam)) {
    let (source, receiver) = (&model.facets[i], &model.facets[j]);
    if source.area == 0.0 || receiver.area == 0.0 {
        return;
    }
    let r2 = (receiver.centroid - source.centroid).length_squared();
    let weight = far_weight(r2, model.range(i, j));
    if weight > 0.0 {
        visit_far(model, i, j, weight, &mut visit);
    }
    near_beams(model, i, j, visit);
}

/// Those of the near field alone.
pub(super) fn near_beams(model: &Model, i: usize, j: usize, mut visit: impl FnMut(Beam)) {
    let (source, receiver) = (&model.facets[i], &model.facets[j]);
    let r2 = (receiver.centroid - source.centroid).length_squared();
    let weight = far_weight(r2, model.range(i, j));
    if weight < 1.0 && source.area > 0.0 && receiver.area > 0.0 {
        visit_near(model, i, j, 1.0 - weight, &mut visit);
    }
}

/// Centroid to centroid.
pub(super) fn visit_far(model: &Model, i: usize, j: usize, weight: f64, visit: &mut impl FnMut(Beam)) {
    let (source, receiver) = (&model.facets[i], &model.facets[j]);
    let between = receiver.centroid - source.centroid;
    let r2 = between.length_squared();
    let direction = between / r2.sqrt();
    let (cos_i, cos_j) = (direction.dot(source.normal), -direction.dot(receiver.normal));
    if cos_j > 0.0 && cos_i != 0.0 {
        let g = 1.0 / (r2 + source.area / PI);
        let projected = weight * cos_j * cos_i.abs() * source.area * g;
        visit(Beam { direction, front: cos_i > 0.0, diffuse: projected, binned: projected });
    }
}

/// Quarters to quarters; for directional radiance, where two quarters are close relative to their size, sixteenths to sixteenths.
fn visit_near(model: &Model, i: usize, j: usize, weight: f64, visit: &mut impl FnMut(Beam)) {
    for to in quarters(model.facets[j].corners) {
        for from in quarters(model.facets[i].corners) {
            let r2 = (centroid(to) - centroid(from)).length_squared();
            let far = match model.classes[i].has_bins() {
                true => far_weight(r2, model.range(i, j) * QUARTER_RANGE),
                false => 1.0,
            };
            visit_piece(model, i, j, [from, to], [weight / 4.0, weight * far / 4.0], visit);
            if far < 1.0 {
                for to in quarters(to) {
                    for from in quarters(from) {
                        let binned = weight * (1.0 - far) / 16.0;
                        visit_piece(model, i, j, [from, to], [0.0, binned], visit);
                    }
                }
            }
        }
    }
}

/// Distances from a plane below this multiple of the triangle's size √s are rounding and have no side. Otherwise the two sides of
/// a sheet would illuminate each other.
pub(super) const COINCIDENT: f64 = 1e-12;

/// From a piece of the source to the centroid of a piece of the receiver, by Lambert's polygon formula, which is exact for
/// uniform radiance. `diffuse` and `binned` are the weights of the two kinds of radiance.
fn visit_piece(
    model: &Model,
    i: usize,
    j: usize,
    [from, to]: [[DVec3; 3]; 2],
    [diffuse, binned]: [f64; 2],
    visit: &mut impl FnMut(Beam),
) {
    let point = centroid(to);
    let offset = point - centroid(from);
    let side = offset.dot(model.facets[i].normal);
    let projected = projected_solid_angle(point, model.facets[j].normal, from);
    let apart = side.abs() > COINCIDENT * model.facets[i].characteristic_area.sqrt();
    if apart && projected > 0.0 {
        visit(Beam {
            direction: offset.normalize(),
            front: side > 0.0,
            diffuse: diffuse * projected,
            binned: binned * projected,
        });
    }
}
