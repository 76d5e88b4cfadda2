//! U: transport between all pairs of triangles, without visibility tests; its transpose and its derivative.

use super::light::{IRRADIANCE, Runs};
use super::lines::{Line, Pair};
use super::variables::{NUMBERS, gradient, variable};
use super::{Model, Outgoing, State};
use antirad_core::model::{Dual, DualVector, Facet, FacetGradient, Vector};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::AddAssign;

/// U: H_j(b) += T_b(ω_j) max(cos_j, 0) g_ij a_i |cos_i| · (front: L_i(ω_i); back: -A_i(ω_i)), for all i and j; the state holds
/// H_j(b) / c_b.
pub struct Exchange<'a> {
    model: &'a Model,
}

/// Ranges of receivers that threads take one after another, so that sums do not depend on the number of
/// threads.
const PARTS: usize = 16;

impl<'a> Exchange<'a> {
    /// U between the triangles of `model`.
    pub fn new(model: &'a Model) -> Self {
        Self { model }
    }

    /// U: from outgoing light to the incident light of all triangles.
    pub fn apply(&self, outgoing: &Outgoing) -> State {
        let light = outgoing.runs(self.model);
        let receivers = (0..self.model.facets.len()).into_par_iter();
        State::of_runs(&receivers.map(|j| self.incident(&light, j)).collect())
    }

    /// The irradiance of some triangles, where that of all would take too long.
    pub fn irradiance(&self, outgoing: &Outgoing, receivers: &[usize]) -> Vec<DVec3> {
        let light = outgoing.runs(self.model);
        receivers.par_iter().map(|&j| self.incident(&light, j)[IRRADIANCE]).collect()
    }

    /// Uᵀ: from the adjoint λ of the incident light (`importance`) to the cotangent of the outgoing light.
    pub fn transpose(&self, importance: &State) -> Outgoing {
        let importance = importance.runs(self.model);
        let dark = self.model.dark().runs(self.model);
        Outgoing::of_runs(&self.sum_over_receivers(&dark, |j, cotangents| {
            self.for_each_line(j, |i, line| line.from.add(line.to.read(&importance[j]), &mut cotangents[i]));
        }))
    }

    /// The gradient of λ·U(outgoing) with respect to every triangle: outgoing light and λ (`importance`) held fixed.
    /// The visible side of a source, and whether a pair exchanges light at all, are
    /// discrete and have no derivative.
    pub fn derivative(&self, outgoing: &Outgoing, importance: &State) -> Vec<FacetGradient> {
        let (light, importance) = (outgoing.runs(self.model), importance.runs(self.model));
        let dark = vec![FacetGradient::default(); self.model.facets.len()];
        self.sum_over_receivers(&dark, |j, gradients| {
            for i in 0..self.model.facets.len() {
                let mut sum = Dual::<{ 2 * NUMBERS }>::from(0.0);
                let ends = [(&self.model.facets[i], 0), (&self.model.facets[j], NUMBERS)];
                let [source, receiver] = ends.map(|(facet, first)| variable(facet, first));
                self.pair(i, j, &source, &receiver).lines(&mut |line| {
                    let radiance: DualVector<_> = line.from.read(&light[i]);
                    sum = sum + radiance.dot(line.to.read(&importance[j]));
                });
                let (by_source, by_receiver) = sum.slopes.split_at(NUMBERS);
                gradients[i] += gradient(by_source);
                gradients[j] += gradient(by_receiver);
            }
        })
    }

    fn incident(&self, light: &Runs, j: usize) -> Vec<DVec3> {
        let mut incident = self.model.unlit(self.model.classes[j]);
        self.for_each_line(j, |i, line| line.to.add(line.from.read(&light[i]), &mut incident));
        incident
    }

    fn for_each_line(&self, j: usize, mut visit: impl FnMut(usize, Line<f64>)) {
        let facets = &self.model.facets;
        for (i, source) in facets.iter().enumerate() {
            self.pair(i, j, source, &facets[j]).lines(&mut |line| visit(i, line));
        }
    }

    fn pair<'b, V: Vector>(
        &'b self,
        i: usize,
        j: usize,
        source: &'b Facet<V>,
        receiver: &'b Facet<V>,
    ) -> Pair<'b, V> {
        let Model { bins, near_field, classes, .. } = self.model;
        let (class, has_bins) = (classes[i], classes[j].has_bins());
        Pair { bins, near_field: *near_field, source, class, receiver, has_bins }
    }

    /// Adds up by source what all receivers contribute.
    fn sum_over_receivers<T: Sum>(&self, zero: &[T], add: impl Fn(usize, &mut [T]) + Sync) -> Vec<T> {
        let receivers: Vec<usize> = (0..self.model.facets.len()).collect();
        let parts: Vec<Vec<T>> = receivers
            .par_chunks(receivers.len().div_ceil(PARTS).max(1))
            .map(|part| {
                let mut sum = zero.to_vec();
                part.iter().for_each(|&j| add(j, &mut sum));
                sum
            })
            .collect();
        let mut sums = zero.to_vec();
        for part in parts {
            sums.iter_mut().zip(part).for_each(|(sum, part)| sum.add(part));
        }
        sums
    }
}

/// What is added up in parts.
trait Sum: Clone + Send + Sync {
    fn add(&mut self, part: Self);
}

impl Sum for FacetGradient {
    fn add(&mut self, part: Self) {
        *self += part;
    }
}

impl<T: AddAssign + Clone + Send + Sync> Sum for Vec<T> {
    fn add(&mut self, part: Self) {
        self.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
    }
}
