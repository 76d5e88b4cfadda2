//! The transposes of U, K - J and S, and the adjoint light equation. Twin of glsl/*_adjoint.comp.
//!
//! For a loss F(H, C) with partial derivatives λ0 and μ0, the total derivatives λ = dF/dH and μ = dF/dC over all light paths
//! satisfy
//!
//! ```text
//! μ = μ0 + Uᵀ λ,   λ = λ0 + (K - J)ᵀ μ.
//! ```
//!
//! λ has the form of a [`State`] and μ that of [`Outgoing`]: an entry is the derivative with respect to that entry as it is
//! stored, so in particular with respect to H(b) / c_b.

use super::reflection::{specular_scale, spread};
use super::transport::{Beam, beams};
use super::{Model, Outgoing, State};
use crate::model::{Class, Facet, Taps};
use crate::solve::LightOperator;
use glam::DVec3;
use rayon::prelude::*;
use std::convert::Infallible;
use std::f64::consts::PI;

/// Uᵀ: from the adjoint λ of the incident light (`importance`) to the cotangent of the outgoing light.
pub fn transport_adjoint(model: &Model, importance: &State) -> Outgoing {
    let gather = |i: usize| {
        let mut cotangent = SourceCotangent::of_triangle(model, i);
        for j in 0..model.facets.len() {
            beams(model, i, j, |beam| cotangent.receive(model, importance, j, beam));
        }
        cotangent
    };
    outgoing_cotangent(model, (0..model.facets.len()).into_par_iter().map(gather).collect())
}

/// The cotangents of all triangles.
pub(super) fn outgoing_cotangent(model: &Model, cotangents: Vec<SourceCotangent>) -> Outgoing {
    let mut outgoing = model.dark();
    for (i, cotangent) in cotangents.into_iter().enumerate() {
        outgoing.diffuse[i] = cotangent.diffuse;
        if let Some(range) = model.bins_of(i) {
            outgoing.specular[range.clone()].copy_from_slice(&cotangent.specular);
            outgoing.antiradiance[range].copy_from_slice(&cotangent.antiradiance);
        }
    }
    outgoing
}

impl State {
    /// For a state that holds λ: the importance of light incident on triangle `j` from a world direction (receiver to source),
    /// per W/m²: λ_E + Σ_b T_b λ_A(b) / c_b.
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

/// The cotangent of the outgoing light of one source.
pub(super) struct SourceCotangent {
    facet: Facet,
    class: Class,
    pub diffuse: DVec3,
    /// Empty where the source has no bins.
    pub specular: Vec<DVec3>,
    /// Empty where the source has no bins.
    pub antiradiance: Vec<DVec3>,
}

impl SourceCotangent {
    pub fn new(model: &Model, facet: Facet, class: Class) -> Self {
        let dark = vec![DVec3::ZERO; if class.has_bins() { model.bins.count() } else { 0 }];
        Self { facet, class, diffuse: DVec3::ZERO, specular: dark.clone(), antiradiance: dark }
    }

    pub fn of_triangle(model: &Model, i: usize) -> Self {
        Self::new(model, model.facets[i], model.classes[i])
    }

    /// Adds what the light along a beam to receiver `j` matters.
    pub fn receive(&mut self, model: &Model, importance: &State, j: usize, beam: Beam) {
        let importance = importance.importance(model, j, -beam.direction);
        let local = |direction| model.bins.taps(self.facet.to_local(direction));
        match (beam.front, self.class) {
            (true, Class { glossy, .. }) => {
                self.diffuse += beam.diffuse * importance;
                if glossy {
                    deposit(&mut self.specular, local(beam.direction), beam.binned * importance);
                }
            }
            // Antiradiance is stored positive; U applies the minus.
            (false, Class { blocker: true, .. }) => {
                deposit(&mut self.antiradiance, local(-beam.direction), -beam.binned * importance);
            }
            (false, _) => {}
        }
    }
}

fn deposit(bins: &mut [DVec3], taps: Taps, value: DVec3) {
    for (b, weight) in taps {
        bins[b] += weight * value;
    }
}

/// (K - J)ᵀ. J is the identity on the state, so the cotangent of antiradiance passes unchanged: the minus is applied in U.
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

/// The specular lobe is symmetric in its two directions; the state holds radiance, hence the c_b of the incident bin.
fn lobe(model: &Model, i: usize, cotangent: &[DVec3]) -> Vec<DVec3> {
    let material = &model.materials[i];
    let adjoint = spread(&model.bins, material.power, |out| cotangent[out]);
    adjoint.iter().zip(&model.bins.projected).map(|(w, c)| specular_scale(material) * *w * *c).collect()
}

/// Sᵀ: from the cotangent of the colours of triangles, seen from `camera_position`, to that of their outgoing light.
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

/// The equation λ = λ0 + (K - J)ᵀ (μ0 + Uᵀ λ) for the solvers of [`crate::solve`]; λ0 + (K - J)ᵀ μ0 takes the place of emission.
pub struct AdjointEquation<'a> {
    /// The discretised scene.
    pub model: &'a Model,
    /// λ0, the partial derivative of the loss with respect to the incident light.
    pub incident: State,
    /// μ0, the partial derivative of the loss with respect to the outgoing light.
    pub outgoing: Outgoing,
}

impl AdjointEquation<'_> {
    /// μ = μ0 + Uᵀ λ: the derivative of the loss with respect to the outgoing light, and hence to emission.
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

    /// Convergence is judged by all entries: importance per bin is as much a result as that of irradiance, and includes the areas.
    fn judged(&mut self, _: &State) -> Result<Option<Vec<f64>>, Infallible> {
        Ok(None)
    }
}
