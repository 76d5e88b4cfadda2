//! Volume clusters: what they send, and its transpose. Twin of glsl/volume_bins.comp.

use super::adjoint::SourceCotangent;
use super::transport::Beam;
use super::{Model, Outgoing, State};
use crate::model::{Clusters, Facet, PADDING, Spread, Taps, VolumeParts};
use glam::DVec3;
use std::f64::consts::PI;

/// What each volume sends per bin, over its mean area ā: I(ω) / ā, with the directions ω of bins above the horizon, and -I(-ω) / ā for those
/// below.
pub(super) struct VolumeLight {
    pub facets: Vec<Facet>,
    above: Vec<Vec<DVec3>>,
    below: Vec<Vec<DVec3>>,
}

/// What one triangle sends to one bin of a volume.
struct Part {
    triangle: usize,
    bin: usize,
    above: bool,
    /// Whether its front sends it, or its back.
    front: bool,
    /// Factor on its radiance, or its antiradiance.
    weight: f64,
    taps: Taps,
}

/// Each triangle, seen in the direction of each bin of both hemispheres.
fn parts(model: &Model, clusters: &Clusters, volume: usize, area: f64, mut with: impl FnMut(Part)) {
    for i in triangles(clusters, volume) {
        let facet = &model.facets[i];
        for (bin, &centre) in model.bins.centre.iter().enumerate() {
            for above in [true, false] {
                let direction = if above { centre } else { -centre };
                let cosine = direction.dot(facet.normal);
                let front = cosine > 0.0;
                let seen = cosine.abs() * facet.area / area;
                let weight = if front == above { seen } else { -seen };
                let local = facet.to_local(if front { direction } else { -direction });
                with(Part { triangle: i, bin, above, front, weight, taps: model.bins.taps(local) });
            }
        }
    }
}

/// The triangles of a volume.
pub(super) fn triangles(clusters: &Clusters, volume: usize) -> Vec<usize> {
    let Some(volumes) = clusters.volumes() else { return Vec::new() };
    match &volumes.parts()[volume] {
        VolumeParts::Triangles(at) => {
            let slots = &volumes.slots()[at.start as usize..at.end as usize];
            let of = slots.iter().map(|&slot| clusters.order()[slot as usize]);
            of.filter(|&i| i != PADDING).map(|i| i as usize).collect()
        }
        VolumeParts::Volumes(both) => {
            let first = volumes.run().range().start;
            both.iter().flat_map(|part| triangles(clusters, (part - first) as usize)).collect()
        }
    }
}

impl VolumeLight {
    pub fn new(model: &Model, clusters: &Clusters, outgoing: &Outgoing) -> Self {
        let facets = clusters.volume_facets(&model.facets);
        let dark = vec![vec![DVec3::ZERO; model.bins.count()]; facets.len()];
        let mut light = Self { facets, above: dark.clone(), below: dark };
        for v in 0..light.facets.len() {
            parts(model, clusters, v, light.facets[v].area, |part| {
                let to = if part.above { &mut light.above[v] } else { &mut light.below[v] };
                let bins = |of: &[DVec3]| -> DVec3 {
                    let first = model.bins_of(part.triangle).map_or(0, |range| range.start);
                    part.taps.iter().map(|&(b, weight)| weight * of[first + b]).sum()
                };
                let class = model.classes[part.triangle];
                to[part.bin] += part.weight
                    * match part.front {
                        true if class.glossy => outgoing.diffuse[part.triangle] + bins(&outgoing.specular),
                        true => outgoing.diffuse[part.triangle],
                        false if class.blocker => bins(&outgoing.antiradiance),
                        false => DVec3::ZERO,
                    };
            });
        }
        light
    }

    /// What a volume sends along a beam.
    pub fn radiance(&self, model: &Model, v: usize, beam: &Beam) -> DVec3 {
        let gather = |bins: &[DVec3], direction: DVec3| -> DVec3 {
            model.bins.taps(direction).iter().map(|&(b, weight)| weight * bins[b]).sum()
        };
        match beam.front {
            true => gather(&self.above[v], beam.direction),
            false => -gather(&self.below[v], -beam.direction),
        }
    }
}

/// The line from a volume to a receiver. Its front is above the horizon.
pub(super) fn volume_beam(model: &Model, source: &Facet, j: usize) -> Beam {
    let receiver = &model.facets[j];
    let between = receiver.centroid - source.centroid;
    let r2 = between.length_squared();
    let direction = between / r2.sqrt();
    let seen = Spread::in_space(-direction.dot(receiver.normal), source.characteristic_area / r2);
    let projected = seen.cosine * source.area / (r2 + source.area / PI);
    Beam { direction, front: direction.z > 0.0, diffuse: projected, binned: projected }
}

/// The cotangents of what volumes send.
pub(super) struct VolumeCotangents {
    facets: Vec<Facet>,
    volumes: Vec<SourceCotangent>,
}

impl VolumeCotangents {
    pub fn new(model: &Model, clusters: &Clusters) -> Self {
        let facets = clusters.volume_facets(&model.facets);
        let class = clusters.volumes().map(|volumes| volumes.run().class).unwrap_or_default();
        let volumes = facets.iter().map(|&facet| SourceCotangent::new(model, facet, class)).collect();
        Self { facets, volumes }
    }

    /// Adds what the light that a volume sends to receiver `j` matters.
    pub fn receive(&mut self, model: &Model, importance: &State, v: usize, j: usize) {
        let beam = volume_beam(model, &self.facets[v], j);
        self.volumes[v].receive(model, importance, j, beam);
    }

    /// Adds them to those of triangles.
    pub fn pass_on(&self, model: &Model, clusters: &Clusters, triangles: &mut [SourceCotangent]) {
        for (v, own) in self.volumes.iter().enumerate() {
            parts(model, clusters, v, self.facets[v].area, |part| {
                let from = if part.above { &own.specular } else { &own.antiradiance };
                let value = part.weight * from[part.bin];
                let class = model.classes[part.triangle];
                let to = &mut triangles[part.triangle];
                let deposit = |to: &mut [DVec3]| {
                    part.taps.iter().for_each(|&(b, weight)| to[b] += weight * value);
                };
                match part.front {
                    true => {
                        to.diffuse += value;
                        if class.glossy {
                            deposit(&mut to.specular);
                        }
                    }
                    false if class.blocker => deposit(&mut to.antiradiance),
                    false => {}
                }
            });
        }
    }
}
