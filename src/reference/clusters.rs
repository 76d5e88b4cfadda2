//! U where clusters stand for far triangles. Twin of glsl/gather*.comp and glsl/cluster_*.comp.

use super::transport::{Incident, collect, near_beams, visit_far};
use super::{Model, Outgoing, State};
use crate::model::{
    Clusters, Facet, LIST, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Parts, far_weight, share, spread_over,
};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// U with the sources of each receiver that `clusters` lists, as the mean triangles that they are in `model`; close pairs
/// are those of [`super::transport`].
pub fn transport_through_clusters(model: &Model, clusters: &Clusters, outgoing: &Outgoing) -> State {
    let light = ClusterLight::new(model, clusters, outgoing);
    let mut slots = vec![None; model.facets.len()];
    for (slot, &i) in (0u32..).zip(clusters.order()) {
        if let Some(of) = slots.get_mut(i as usize) {
            *of = Some(slot);
        }
    }
    let receive = |j: usize| {
        let mut incident = Incident::new(model, j);
        // Triangles without area have no slot.
        for (index, passing) in
            slots[j].into_iter().flat_map(|slot: u32| clusters.sources().sources(slot / LIST))
        {
            match clusters.order().get(index as usize) {
                Some(&i) => from_triangle(&mut incident, outgoing, i as usize, passing),
                None => light.send(&mut incident, (index - clusters.first()) as usize, passing),
            }
        }
        for i in 0..model.facets.len() {
            near_beams(model, i, j, |beam| incident.receive(outgoing, i, beam));
        }
        incident
    };
    collect(model, (0..model.facets.len()).into_par_iter().map(receive).collect())
}

fn passes(front: bool, passing: u32) -> bool {
    passing & if front { PAIR_FRONT } else { PAIR_BACK } != 0
}

fn from_triangle(incident: &mut Incident, outgoing: &Outgoing, i: usize, passing: u32) {
    let (model, j) = (incident.model, incident.j);
    let r2 = model.facets[i].centroid.distance_squared(model.facets[j].centroid);
    let near = passing & PAIR_NEAR != 0;
    let weight = if near { far_weight(r2, model.range(i, j)) } else { 1.0 };
    visit_far(model, i, j, weight, &mut |beam| {
        if passes(beam.front, passing) {
            incident.receive(outgoing, i, beam);
        }
    });
}

/// What each cluster sends.
struct ClusterLight {
    facets: Vec<Facet>,
    diffuse: Vec<DVec3>,
    /// Per bin; empty where the parts have none.
    specular: Vec<Vec<DVec3>>,
    antiradiance: Vec<Vec<DVec3>>,
}

impl ClusterLight {
    /// Sums up parts, Σ a ⟨n_i, n⟩ L_i / ā. Bins of parts need no rotation: their frames are similar.
    fn new(model: &Model, clusters: &Clusters, outgoing: &Outgoing) -> Self {
        let facets = clusters.facets(&model.facets);
        let mut light = Self { facets, diffuse: Vec::new(), specular: Vec::new(), antiradiance: Vec::new() };
        for (c, parts) in clusters.parts().iter().enumerate() {
            let own = light.facets[c];
            let (mut diffuse, mut specular, mut antiradiance) = (DVec3::ZERO, Vec::new(), Vec::new());
            let mut add = |part: &Facet, l: DVec3, s: &[DVec3], a: &[DVec3]| {
                let share = share(part, &own);
                diffuse += share * l;
                add_scaled(&mut specular, share, s);
                add_scaled(&mut antiradiance, share, a);
            };
            match parts {
                Parts::Triangles(slots) => {
                    for i in clusters.triangles(slots) {
                        let bins = model.bins_of(i).unwrap_or(0..0);
                        let (s, a) = (&outgoing.specular[bins.clone()], &outgoing.antiradiance[bins]);
                        add(&model.facets[i], outgoing.diffuse[i], s, a);
                    }
                }
                Parts::Clusters(both) => {
                    for part in both.map(|index| (index - clusters.first()) as usize) {
                        let (s, a) = (&light.specular[part], &light.antiradiance[part]);
                        add(&light.facets[part], light.diffuse[part], s, a);
                    }
                }
            }
            light.diffuse.push(diffuse);
            light.specular.push(specular);
            light.antiradiance.push(antiradiance);
        }
        light
    }

    fn send(&self, incident: &mut Incident, c: usize, passing: u32) {
        let (model, source) = (incident.model, &self.facets[c]);
        let receiver = &model.facets[incident.j];
        let between = receiver.centroid - source.centroid;
        let r2 = between.length_squared();
        let direction = between / r2.sqrt();
        let cos_i = direction.dot(source.normal);
        let front = cos_i > 0.0;
        if !passes(front, passing) {
            return;
        }
        let tilt = receiver.normal.dot(source.normal) * cos_i.signum();
        // A cluster has the variance of its triangles in place of the characteristic area.
        let angle2 = source.characteristic_area / r2;
        let cos_j = spread_over(-direction.dot(receiver.normal), cos_i.abs(), tilt, angle2);
        let projected = cos_j * cos_i.abs() * source.area / (r2 + source.area / PI);
        let gather = |bins: &[DVec3], direction: DVec3| -> DVec3 {
            let taps = model.bins.taps(source.to_local(direction));
            taps.iter().map(|&(b, weight)| weight * bins.get(b).copied().unwrap_or_default()).sum()
        };
        let radiance = match front {
            true => self.diffuse[c] + gather(&self.specular[c], direction),
            false => -gather(&self.antiradiance[c], -direction),
        };
        incident.deposit(-direction, projected * radiance);
    }
}

fn add_scaled(sum: &mut Vec<DVec3>, factor: f64, values: &[DVec3]) {
    sum.resize(sum.len().max(values.len()), DVec3::ZERO);
    sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * *value);
}
