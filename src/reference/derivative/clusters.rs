//! The derivative of U where clusters stand for far triangles. Twin of glsl/cluster_derivative_*.comp, glsl/cluster_shares.comp.

use super::pair::{PairGradient, pair_derivative};
use super::reading::Reading;
use crate::model::{
    Clusters, Facet, FacetGradient, PADDING, Parts, pull_unit, spread_over, spread_over_gradient,
};
use crate::reference::clusters::{ClusterLight, Source, listed, passes, slots};
use crate::reference::clusters_adjoint::Cotangents;
use crate::reference::{Model, Outgoing, State};
use glam::DVec3;
use std::f64::consts::PI;

/// The gradient of λ·U(outgoing) with respect to every triangle, with U as in
/// [`crate::reference::transport_through_clusters`]: outgoing light and λ (`importance`) held fixed, and which triangles make up which
/// clusters, and stand where in lists.
pub fn transport_through_clusters_derivative(
    model: &Model,
    clusters: &Clusters,
    outgoing: &Outgoing,
    importance: &State,
) -> Vec<FacetGradient> {
    let light = ClusterLight::new(model, clusters, outgoing);
    let first = clusters.first() as usize;
    let slots = slots(model, clusters);
    let slot_of = |i: usize| slots[i].map(|slot| slot as usize);
    let mut gradients = vec![FacetGradient::default(); first + light.facets.len()];
    for (j, slot) in slots.iter().enumerate() {
        for (source, passing) in listed(clusters, *slot) {
            let (index, pair) = match source {
                Source::Triangle(i) => (slot_of(i), pair_derivative(model, outgoing, importance, i, j)),
                Source::Cluster(c) => {
                    (Some(first + c), cluster_derivative(model, &light, importance, c, j, passing))
                }
            };
            for (index, gradient) in [(index, pair.source), (slot_of(j), pair.receiver)] {
                if let Some(index) = index {
                    gradients[index] += gradient;
                }
            }
        }
    }
    let shares = by_shares(model, clusters, outgoing, importance, &light);
    clusters.pull_to_triangles(&model.facets, &mut gradients, &shares);
    let of = |slot: &Option<u32>| slot.map(|slot| gradients[slot as usize]).unwrap_or_default();
    slots.iter().map(of).collect()
}

/// The derivative by the share of each source in the light of its cluster: the product of the source's light and the cluster's
/// cotangent.
fn by_shares(
    model: &Model,
    clusters: &Clusters,
    outgoing: &Outgoing,
    importance: &State,
    light: &ClusterLight,
) -> Vec<f64> {
    let cotangents = Cotangents::new(model, clusters, importance).clusters;
    let first = clusters.first() as usize;
    let mut shares = vec![0.0; first + light.facets.len()];
    let dot = |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
    for (own, parts) in cotangents.iter().zip(clusters.parts()) {
        let product = |diffuse: DVec3, specular: &[DVec3], antiradiance: &[DVec3]| {
            own.diffuse.dot(diffuse) + dot(&own.specular, specular) + dot(&own.antiradiance, antiradiance)
        };
        match parts {
            Parts::Triangles(range) => {
                for slot in range.clone() {
                    let i = clusters.order()[slot as usize];
                    if i != PADDING {
                        let bins = model.bins_of(i as usize).unwrap_or(0..0);
                        let (s, a) = (&outgoing.specular[bins.clone()], &outgoing.antiradiance[bins]);
                        shares[slot as usize] = product(outgoing.diffuse[i as usize], s, a);
                    }
                }
            }
            Parts::Clusters(both) => {
                for &index in both {
                    let part = index as usize - first;
                    let (s, a) = (&light.specular[part], &light.antiradiance[part]);
                    shares[index as usize] = product(light.diffuse[part], s, a);
                }
            }
        }
    }
    shares
}

/// From cluster `c` to receiver `j`. The gradient by the cluster has that by its variance in place of the characteristic area.
fn cluster_derivative(
    model: &Model,
    light: &ClusterLight,
    importance: &State,
    c: usize,
    j: usize,
    passing: u32,
) -> PairGradient {
    let mut gradient = PairGradient::default();
    let (source, receiver): (&Facet, &Facet) = (&light.facets[c], &model.facets[j]);
    let between = receiver.centroid - source.centroid;
    let (r2, r) = (between.length_squared(), between.length());
    let direction = between / r;
    let cos_i = direction.dot(source.normal);
    let front = cos_i > 0.0;
    let (from, to) = (cos_i.abs(), -direction.dot(receiver.normal));
    let tilt = receiver.normal.dot(source.normal) * cos_i.signum();
    let angle2 = source.characteristic_area / r2;
    let cos_j = spread_over(to, from, tilt, angle2);
    let lit = passes(front, passing) && cos_j > 0.0 && from > 0.0;
    if !lit {
        return gradient;
    }
    let (diffuse, bins) = match front {
        true => (light.diffuse[c], &light.specular[c]),
        false => (DVec3::ZERO, &light.antiradiance[c]),
    };
    let sent = Reading::of_bins(model, source.normal, bins, direction, front);
    let incident = Reading::of_receiver(model, importance, j, direction);
    let (radiance, importance) = (diffuse + sent.value, importance.irradiance[j] + incident.value);
    let value = radiance.dot(importance);
    let g = 1.0 / (r2 + source.area / PI);
    let projected = cos_j * from * source.area * g;

    let (by_sent, by_incident) = (sent.pull(projected * importance), incident.pull(projected * radiance));
    let [by_to, by_from, by_tilt, by_angle2] =
        spread_over_gradient(to, from, tilt, angle2).map(|slope| value * from * source.area * g * slope);
    let by_from = cos_i.signum() * (by_from + value * cos_j * source.area * g);
    let by_tilt = cos_i.signum() * by_tilt;
    gradient.source.normal = by_from * direction + by_tilt * receiver.normal + by_sent.normal;
    gradient.receiver.normal = by_tilt * source.normal - by_to * direction + by_incident.normal;
    // d(a g)/da = r² g², and dg/dr² = -g².
    gradient.source.area = value * cos_j * from * r2 * g * g;
    gradient.source.characteristic_area = by_angle2 / r2;
    let by_direction =
        by_from * source.normal - by_to * receiver.normal + by_sent.direction + by_incident.direction;
    let by_r2 = -value * projected * g - by_angle2 * angle2 / r2;
    gradient.add_between(pull_unit(direction, r, by_direction) + 2.0 * by_r2 * between);
    gradient
}
