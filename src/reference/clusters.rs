//! U where clusters stand for far triangles. Twin of glsl/gather*.comp and glsl/cluster_bins.comp, glsl/cluster_irradiance.comp.

use super::transport::{Beam, Incident, collect, near_beams, visit_far};
use super::volumes::{VolumeLight, volume_beam};
use super::{Model, Outgoing, State};
use crate::model::{
    Class, Clusters, Facet, LIST, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Parts, Spread, far_weight, share,
};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// U with the sources of each receiver that `clusters` lists, as the mean triangles that they are in `model`; close pairs
/// are those of [`super::transport`].
pub fn transport_through_clusters(model: &Model, clusters: &Clusters, outgoing: &Outgoing) -> State {
    let light = ClusterLight::new(model, clusters, outgoing);
    let volumes = VolumeLight::new(model, clusters, outgoing);
    let slots = slots(model, clusters);
    let receive = |j: usize| {
        let mut incident = Incident::new(model, j);
        for (source, passing) in listed(clusters, slots[j]) {
            match source {
                Source::Triangle(i) => {
                    visit_listed(model, i, j, passing, |beam| incident.receive(outgoing, i, beam));
                }
                Source::Cluster(c) => {
                    if let Some(ClusterBeam { beam, slope }) =
                        cluster_beam(model, &light.facets[c], j, passing)
                    {
                        let even = beam.diffuse * light.radiance(model, c, &beam);
                        let uneven = if beam.front { light.moment[c] * slope } else { DVec3::ZERO };
                        incident.deposit(-beam.direction, even + uneven);
                    }
                }
                Source::Volume(v) => {
                    let beam = volume_beam(model, &volumes.facets[v], j);
                    incident.deposit(-beam.direction, beam.binned * volumes.radiance(model, v, &beam));
                }
            }
        }
        for i in 0..model.facets.len() {
            near_beams(model, i, j, |beam| incident.receive(outgoing, i, beam));
        }
        incident
    };
    collect(model, (0..model.facets.len()).into_par_iter().map(receive).collect())
}

/// A far source.
#[derive(Clone, Copy)]
pub(super) enum Source {
    /// By index in the scene.
    Triangle(usize),
    /// By number.
    Cluster(usize),
    /// By number.
    Volume(usize),
}

/// The slot of each triangle; those without area have none.
pub(super) fn slots(model: &Model, clusters: &Clusters) -> Vec<Option<u32>> {
    let mut slots = vec![None; model.facets.len()];
    for (slot, &i) in (0u32..).zip(clusters.order()) {
        if let Some(of) = slots.get_mut(i as usize) {
            *of = Some(slot);
        }
    }
    slots
}

/// The far sources of a receiver, with what may pass.
pub(super) fn listed(clusters: &Clusters, slot: Option<u32>) -> impl Iterator<Item = (Source, u32)> {
    let entries = slot.into_iter().flat_map(|slot| clusters.sources().sources(slot / LIST));
    entries.map(|(index, passing)| match clusters.order().get(index as usize) {
        Some(&i) => (Source::Triangle(i as usize), passing),
        None if clusters.is_volume(index) => {
            (Source::Volume((index - clusters.first() - clusters.count()) as usize), passing)
        }
        None => (Source::Cluster((index - clusters.first()) as usize), passing),
    })
}

pub(super) fn passes(front: bool, passing: u32) -> bool {
    passing & if front { PAIR_FRONT } else { PAIR_BACK } != 0
}

/// The line from a triangle to a receiver, centroid to centroid.
pub(super) fn visit_listed(model: &Model, i: usize, j: usize, passing: u32, mut visit: impl FnMut(Beam)) {
    let r2 = model.facets[i].centroid.distance_squared(model.facets[j].centroid);
    let near = passing & PAIR_NEAR != 0;
    let weight = if near { far_weight(r2, model.range(i, j)) } else { 1.0 };
    visit_far(model, i, j, weight, &mut |beam| {
        if passes(beam.front, passing) {
            visit(beam);
        }
    });
}

/// The line from a cluster to a receiver.
pub(super) struct ClusterBeam {
    /// For the mean radiance.
    pub beam: Beam,
    /// How the projected solid angle changes along the cluster's plane, sr per unit of length: for the first moment of the diffuse
    /// radiance.
    pub slope: DVec3,
}

pub(super) fn cluster_beam(model: &Model, source: &Facet, j: usize, passing: u32) -> Option<ClusterBeam> {
    let receiver = &model.facets[j];
    let between = receiver.centroid - source.centroid;
    let r2 = between.length_squared();
    let direction = between / r2.sqrt();
    let cos_i = direction.dot(source.normal);
    let front = cos_i > 0.0;
    if !passes(front, passing) {
        return None;
    }
    let tilt = receiver.normal.dot(source.normal) * cos_i.signum();
    // A cluster has the variance of its triangles in place of the characteristic area.
    let angle2 = source.characteristic_area / r2;
    let seen = Spread::new(-direction.dot(receiver.normal), cos_i.abs(), tilt, angle2);
    let sent = cos_i.abs() * source.area / (r2 + source.area / PI);
    let projected = seen.cosine * sent;
    let slope = sent / r2.sqrt() * (seen.above * receiver.normal + 4.0 * seen.mean * direction);
    let beam = Beam { direction, front, diffuse: projected, binned: projected };
    Some(ClusterBeam { beam, slope })
}

/// What each cluster sends.
pub(super) struct ClusterLight {
    pub facets: Vec<Facet>,
    pub diffuse: Vec<DVec3>,
    /// First moment of the diffuse radiance around the centroid, a column for each coordinate.
    pub moment: Vec<DMat3>,
    /// Per bin; empty where the parts have none.
    pub specular: Vec<Vec<DVec3>>,
    pub antiradiance: Vec<Vec<DVec3>>,
}

impl ClusterLight {
    /// Sums up parts, Σ a ⟨n_i, n⟩ L_i / ā, and Σ a ⟨n_i, n⟩ L_i (x_i - c)ᵀ / ā for the first moment. Bins of
    /// parts need no rotation: their frames are similar.
    pub fn new(model: &Model, clusters: &Clusters, outgoing: &Outgoing) -> Self {
        let facets = clusters.facets(&model.facets);
        let mut light = Self {
            facets,
            diffuse: Vec::new(),
            moment: Vec::new(),
            specular: Vec::new(),
            antiradiance: Vec::new(),
        };
        for (c, parts) in clusters.parts().iter().enumerate() {
            let own = light.facets[c];
            let (mut diffuse, mut moment) = (DVec3::ZERO, DMat3::ZERO);
            let (mut specular, mut antiradiance) = (Vec::new(), Vec::new());
            let mut add = |part: &Facet, l: DVec3, m: DMat3, s: &[DVec3], a: &[DVec3]| {
                let share = share(part, &own);
                diffuse += share * l;
                moment += share * (outer(l, part.centroid - own.centroid) + m);
                add_scaled(&mut specular, share, s);
                add_scaled(&mut antiradiance, share, a);
            };
            match parts {
                Parts::Triangles(slots) => {
                    for i in clusters.triangles(slots) {
                        let Class { glossy, blocker } = model.classes[i];
                        let bins = |kept: bool| model.bins_of(i).filter(|_| kept).unwrap_or(0..0);
                        let (s, a) =
                            (&outgoing.specular[bins(glossy)], &outgoing.antiradiance[bins(blocker)]);
                        add(&model.facets[i], outgoing.diffuse[i], DMat3::ZERO, s, a);
                    }
                }
                Parts::Clusters(both) => {
                    for part in both.map(|index| (index - clusters.first()) as usize) {
                        let (s, a) = (&light.specular[part], &light.antiradiance[part]);
                        add(&light.facets[part], light.diffuse[part], light.moment[part], s, a);
                    }
                }
            }
            light.diffuse.push(diffuse);
            light.moment.push(moment);
            light.specular.push(specular);
            light.antiradiance.push(antiradiance);
        }
        light
    }

    fn radiance(&self, model: &Model, c: usize, beam: &Beam) -> DVec3 {
        let gather = |bins: &[DVec3], direction: DVec3| -> DVec3 {
            let taps = model.bins.taps(self.facets[c].to_local(direction));
            taps.iter().map(|&(b, weight)| weight * bins.get(b).copied().unwrap_or_default()).sum()
        };
        match beam.front {
            true => self.diffuse[c] + gather(&self.specular[c], beam.direction),
            false => -gather(&self.antiradiance[c], -beam.direction),
        }
    }
}

/// x yᵀ.
pub(super) fn outer(x: DVec3, y: DVec3) -> DMat3 {
    DMat3::from_cols(x * y.x, x * y.y, x * y.z)
}

/// Adds to values that may still be empty, which counts as zeros.
pub(super) fn add_scaled(sum: &mut Vec<DVec3>, factor: f64, values: &[DVec3]) {
    sum.resize(sum.len().max(values.len()), DVec3::ZERO);
    sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * *value);
}
