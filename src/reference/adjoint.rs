//! The transposes of U, K - J and S, and the adjoint of the light equation. Twin of glsl/*_adjoint.comp.
//!
//! Of a loss F(H, C), λ = dF/dH and μ = dF/dC along every way by which light reaches it: with λ0 and μ0 the partial
//! derivatives of F itself,
//!
//! ```text
//! μ = μ0 + Uᵀ λ,   λ = λ0 + (K - J)ᵀ μ.
//! ```
//!
//! λ has the form of a [`State`] and μ that of [`Outgoing`]: an entry is the derivative with respect to that entry, as
//! it is stored, so in particular with respect to H(b) / c_b.

use super::reflection::{specular_scale, spread};
use super::transport::beams;
use super::{Model, Outgoing, State};
use crate::model::{Class, Taps};
use crate::solve::LightOperator;
use glam::DVec3;
use rayon::prelude::*;
use std::convert::Infallible;
use std::f64::consts::PI;

/// Uᵀ: what the light that leaves each triangle is worth where it arrives.
pub fn transport_adjoint(model: &Model, importance: &State) -> Outgoing {
    let outgoing_of_source: Vec<Departing> = (0..model.facets.len())
        .into_par_iter()
        .map(|i| {
            let mut outgoing_of_source = Departing::new(model, i);
            for j in 0..model.facets.len() {
                outgoing_of_source.towards(importance, j);
            }
            outgoing_of_source
        })
        .collect();
    let mut outgoing = model.dark();
    for (i, outgoing_of_source) in outgoing_of_source.into_iter().enumerate() {
        outgoing.diffuse[i] = outgoing_of_source.diffuse;
        if let Some(range) = model.bins_of(i) {
            outgoing.specular[range.clone()].copy_from_slice(&outgoing_of_source.specular);
            outgoing.antiradiance[range].copy_from_slice(&outgoing_of_source.antiradiance);
        }
    }
    outgoing
}

impl State {
    /// Of a cotangent: what one W/m² is worth that arrives at triangle `j` from a direction of the world (receiver to
    /// source): λ_E + Σ_b T_b λ_A(b) / c_b.
    pub fn importance(&self, model: &Model, j: usize, direction: DVec3) -> DVec3 {
        let binned = match model.bins_of(j) {
            None => DVec3::ZERO,
            Some(range) => model
                .bins
                .taps(model.facets[j].to_local(direction))
                .iter()
                .map(|&(b, weight)| weight * self.bins[range.start + b] / model.bins.projected[b])
                .sum(),
        };
        self.irradiance[j] + binned
    }
}

/// What the light that leaves one triangle is worth.
struct Departing<'a> {
    model: &'a Model,
    i: usize,
    diffuse: DVec3,
    /// Empty where the source has no bins.
    specular: Vec<DVec3>,
    /// Empty where the source has no bins.
    antiradiance: Vec<DVec3>,
}

impl<'a> Departing<'a> {
    fn new(model: &'a Model, i: usize) -> Self {
        let dark = vec![DVec3::ZERO; model.bins_of(i).map_or(0, |range| range.len())];
        Self { model, i, diffuse: DVec3::ZERO, specular: dark.clone(), antiradiance: dark }
    }

    fn towards(&mut self, importance: &State, j: usize) {
        let model = self.model;
        beams(model, self.i, j, |beam| {
            let adjoint = importance.importance(model, j, -beam.direction);
            let local = |direction| model.bins.taps(model.facets[self.i].to_local(direction));
            match (beam.front, model.classes[self.i]) {
                (true, Class { glossy, .. }) => {
                    self.diffuse += beam.diffuse * adjoint;
                    if glossy {
                        deposit(&mut self.specular, local(beam.direction), beam.binned * adjoint);
                    }
                }
                // Antiradiance is kept positive and read with a minus.
                (false, Class { blocker: true, .. }) => {
                    deposit(&mut self.antiradiance, local(-beam.direction), -beam.binned * adjoint);
                }
                (false, _) => {}
            }
        });
    }
}

fn deposit(bins: &mut [DVec3], taps: Taps, value: DVec3) {
    for (b, weight) in taps {
        bins[b] += weight * value;
    }
}

/// (K - J)ᵀ. J is the identity on the state, so the cotangent of antiradiance passes as it is: the minus belongs to
/// the reading in U.
pub fn reflect_adjoint(model: &Model, cotangent: &Outgoing) -> State {
    let irradiance = (0..model.facets.len())
        .map(|i| DVec3::from(model.materials[i].diffuse_albedo()) / PI * cotangent.diffuse[i])
        .collect();
    let mut state = State { irradiance, bins: cotangent.antiradiance.clone() };
    let lobes: Vec<(usize, Vec<DVec3>)> = (0..model.facets.len())
        .into_par_iter()
        .filter(|&i| model.classes[i].glossy)
        .filter_map(|i| {
            model.bins_of(i).map(|range| (range.start, lobe(model, i, &cotangent.specular[range])))
        })
        .collect();
    for (first, lobe) in lobes {
        for (bin, value) in state.bins[first..].iter_mut().zip(lobe) {
            *bin += value;
        }
    }
    state
}

/// The specular lobe is symmetric in both directions; what arrives is radiance, hence the c_b of the incoming bin.
fn lobe(model: &Model, i: usize, cotangent: &[DVec3]) -> Vec<DVec3> {
    let material = &model.materials[i];
    let adjoint = spread(&model.bins, material.power, |out| cotangent[out]);
    adjoint.iter().zip(&model.bins.projected).map(|(w, c)| specular_scale(material) * *w * *c).collect()
}

/// Sᵀ: from the cotangent of the colours of faces, seen from `camera_position`, to that of what leaves them.
pub fn observe_adjoint(model: &Model, camera_position: DVec3, colours: &[DVec3]) -> Outgoing {
    let mut outgoing = model.dark();
    for (i, (facet, &colour)) in model.facets.iter().zip(colours).enumerate() {
        let to_camera = (camera_position - facet.centroid).normalize_or_zero();
        if to_camera.dot(facet.normal) > 0.0 {
            outgoing.diffuse[i] = colour;
            if let Some(range) = model.bins_of(i).filter(|_| model.classes[i].glossy) {
                deposit(&mut outgoing.specular[range], model.bins.taps(facet.to_local(to_camera)), colour);
            }
        }
    }
    outgoing
}

/// The equation λ = λ0 + (K - J)ᵀ (μ0 + Uᵀ λ) for the solvers of [`crate::solve`]: its emission is
/// λ0 + (K - J)ᵀ μ0.
pub struct AdjointEquation<'a> {
    /// The scene.
    pub model: &'a Model,
    /// λ0, the cotangent of what arrives.
    pub incident: State,
    /// μ0, the cotangent of what leaves.
    pub outgoing: Outgoing,
}

impl AdjointEquation<'_> {
    /// μ = μ0 + Uᵀ λ: the derivative of the loss with respect to what leaves, emission among it.
    pub fn outgoing(&self, importance: &State) -> Outgoing {
        let mut outgoing = transport_adjoint(self.model, importance);
        let add = |to: &mut [DVec3], from: &[DVec3]| to.iter_mut().zip(from).for_each(|(t, f)| *t += *f);
        add(&mut outgoing.diffuse, &self.outgoing.diffuse);
        add(&mut outgoing.specular, &self.outgoing.specular);
        add(&mut outgoing.antiradiance, &self.outgoing.antiradiance);
        outgoing
    }
}

impl LightOperator for AdjointEquation<'_> {
    type Vector = State;
    type Error = Infallible;

    fn vector(&mut self) -> Result<State, Infallible> {
        Ok(self.model.zero())
    }

    fn pass(&mut self, x: Option<&State>, emission: bool, y: &mut State) -> Result<(), Infallible> {
        *y = match (x, emission) {
            (None, false) => self.model.zero(),
            (None, true) => reflect_adjoint(self.model, &self.outgoing),
            (Some(x), false) => reflect_adjoint(self.model, &transport_adjoint(self.model, x)),
            (Some(x), true) => reflect_adjoint(self.model, &self.outgoing(x)),
        };
        if emission {
            self.model.combine(1.0, &self.incident, 1.0, y)?;
        }
        Ok(())
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, Infallible> {
        self.model.dot(x, y)
    }

    fn combine(&mut self, a: f64, x: &State, b: f64, y: &mut State) -> Result<(), Infallible> {
        self.model.combine(a, x, b, y)
    }

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), Infallible> {
        self.model.scale(b, y)
    }

    /// All entries: importance per bin is as much a result as that of irradiance, and areas are in it already.
    fn judged(&mut self, _: &State) -> Result<Option<Vec<f64>>, Infallible> {
        Ok(None)
    }
}
