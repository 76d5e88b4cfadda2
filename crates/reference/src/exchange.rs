//! U: transport between all pairs of triangles, without visibility tests, directly or through clusters; its transpose and its
//! derivative.

use super::clusters::Clustered;
use super::light::{IRRADIANCE, Runs};
use super::lines::{Line, Pair, Way};
use super::variables::{NUMBERS, gradient, variable};
use super::{Model, Outgoing, State};
use antirad_core::model::{Class, Clusters, Dual, DualVector, Facet, FacetGradient, Vector};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::AddAssign;

/// U: H_j(b) += T_b(ω_j) max(cos_j, 0) g_ij a_i |cos_i| · (front: L_i(ω_i); back: -A_i(ω_i)), for all i and j; the state holds
/// H_j(b) / c_b.
pub struct Exchange<'a> {
    model: &'a Model,
    clusters: Option<Clustered<'a>>,
    /// All sources: triangles, and after these clusters and volumes.
    facets: Vec<Facet>,
    classes: Vec<Class>,
}

/// Ranges of receivers that threads take one after another, so that sums do not depend on the number of
/// threads.
const PARTS: usize = 16;

impl<'a> Exchange<'a> {
    /// U between triangles or, with `clusters`, between each receiver and the sources that its list has.
    /// Clusters are the mean triangles that they are in `model`; close pairs are the same in both.
    pub fn new(model: &'a Model, clusters: Option<&'a Clusters>) -> Self {
        let clusters = clusters.map(|clusters| Clustered::new(model, clusters));
        let (mut facets, mut classes) = (model.facets.clone(), model.classes.clone());
        if let Some(clusters) = &clusters {
            facets.extend(&clusters.facets);
            classes.extend(&clusters.classes);
        }
        Self { model, clusters, facets, classes }
    }

    /// U: from outgoing light to the incident light of all triangles.
    pub fn apply(&self, outgoing: &Outgoing) -> State {
        let light = self.light(outgoing);
        let receivers = (0..self.model.facets.len()).into_par_iter();
        State::of_runs(&receivers.map(|j| self.incident(&light, j)).collect())
    }

    /// The irradiance of some triangles, where that of all would take too long.
    pub fn irradiance(&self, outgoing: &Outgoing, receivers: &[usize]) -> Vec<DVec3> {
        let light = self.light(outgoing);
        receivers.par_iter().map(|&j| self.incident(&light, j)[IRRADIANCE]).collect()
    }

    /// Uᵀ: from the adjoint λ of the incident light (`importance`) to the cotangent of the outgoing light.
    pub fn transpose(&self, importance: &State) -> Outgoing {
        let cotangents = self.cotangents(&importance.runs(self.model));
        Outgoing::of_runs(&cotangents[..self.model.facets.len()])
    }

    /// The gradient of λ·U(outgoing) with respect to every triangle: outgoing light and λ (`importance`) held fixed, and which triangles
    /// make up which clusters, and stand where in lists. The visible side of a source, and whether a pair exchanges light at all, are
    /// discrete and have no derivative.
    ///
    /// # Panics
    ///
    /// If there are volume clusters, which are not planned where derivatives are wanted.
    pub fn derivative(&self, outgoing: &Outgoing, importance: &State) -> Vec<FacetGradient> {
        let (light, importance) = (self.light(outgoing), importance.runs(self.model));
        let dark = vec![FacetGradient::default(); self.facets.len()];
        let mut gradients = self.sum_over_receivers(&dark, |j, gradients| {
            for (i, way) in self.ways(j) {
                let mut sum = Dual::<{ 2 * NUMBERS }>::from(0.0);
                let ends = [(&self.facets[i], 0), (&self.model.facets[j], NUMBERS)];
                let [source, receiver] = ends.map(|(facet, first)| variable(facet, first));
                self.pair(i, j, &source, &receiver).lines(way, &mut |line| {
                    let radiance: DualVector<_> = line.from.read(&light[i]);
                    sum = sum + radiance.dot(line.to.read(&importance[j]));
                });
                let (by_source, by_receiver) = sum.slopes.split_at(NUMBERS);
                gradients[i] += gradient(by_source);
                gradients[j] += gradient(by_receiver);
            }
        });
        if let Some(clusters) = &self.clusters {
            let cotangents = self.cotangents(&importance);
            clusters.pull(&self.facets, &light, &cotangents, &mut gradients);
        }
        gradients.truncate(self.model.facets.len());
        gradients
    }

    /// What all sources send.
    fn light(&self, outgoing: &Outgoing) -> Runs {
        let mut light = self.all(outgoing.runs(self.model));
        if let Some(clusters) = &self.clusters {
            clusters.gather(&self.facets, &mut light);
        }
        light
    }

    /// The cotangents of what all sources send; those of clusters are scattered to their triangles.
    fn cotangents(&self, importance: &Runs) -> Runs {
        let dark = self.all(self.model.dark().runs(self.model));
        let mut cotangents = self.sum_over_receivers(&dark, |j, cotangents| {
            self.for_each_line(j, |i, line| line.from.add(line.to.read(&importance[j]), &mut cotangents[i]));
        });
        if let Some(clusters) = &self.clusters {
            clusters.scatter(&self.facets, &mut cotangents);
        }
        cotangents
    }

    /// Light of triangles, and none of clusters.
    fn all(&self, mut triangles: Runs) -> Runs {
        let clusters = &self.classes[triangles.len()..];
        triangles.extend(clusters.iter().map(|class| self.model.unsent(*class)));
        triangles
    }

    fn incident(&self, light: &Runs, j: usize) -> Vec<DVec3> {
        let mut incident = self.model.unlit(self.model.classes[j]);
        self.for_each_line(j, |i, line| line.to.add(line.from.read(&light[i]), &mut incident));
        incident
    }

    /// The sources of a receiver.
    fn ways(&self, j: usize) -> impl Iterator<Item = (usize, Way)> {
        let listed = self.clusters.iter().flat_map(move |clusters| clusters.listed(j));
        let way = if self.clusters.is_some() { Way::Near } else { Way::Whole };
        listed.chain((0..self.model.facets.len()).map(move |i| (i, way)))
    }

    fn for_each_line(&self, j: usize, mut visit: impl FnMut(usize, Line<f64>)) {
        for (i, way) in self.ways(j) {
            self.pair(i, j, &self.facets[i], &self.model.facets[j]).lines(way, &mut |line| visit(i, line));
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
        let (class, has_bins) = (self.classes[i], classes[j].has_bins());
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
