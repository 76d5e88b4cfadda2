//! The derivative of U where clusters stand for far triangles. Twin of glsl/cluster_derivative_*.comp, glsl/cluster_shares.comp.

use super::pair::{PairGradient, pair_derivative};
use super::reading::Reading;
use crate::model::{Clusters, Facet, FacetGradient, PADDING, Parts, Spread, pull_unit, share};
use crate::reference::clusters::{ClusterLight, Source, listed, passes, slots};
use crate::reference::clusters_adjoint::Cotangents;
use crate::reference::{Model, Outgoing, State};
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// The gradient of λ·U(outgoing) with respect to every triangle, with U as in
/// [`crate::reference::transport_through_clusters`]: outgoing light and λ (`importance`) held fixed, and which triangles make up which
/// clusters, and stand where in lists.
///
/// # Panics
///
/// If there are volume clusters, which are not planned where derivatives are wanted.
pub fn transport_through_clusters_derivative(
    model: &Model,
    clusters: &Clusters,
    outgoing: &Outgoing,
    importance: &State,
) -> Vec<FacetGradient> {
    assert!(clusters.volumes().is_none(), "volumes are not planned where derivatives by geometry are wanted");
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
                Source::Volume(_) => continue,
            };
            for (index, gradient) in [(index, pair.source), (slot_of(j), pair.receiver)] {
                if let Some(index) = index {
                    gradients[index] += gradient;
                }
            }
        }
    }
    let shares = by_parts(model, clusters, outgoing, importance, &light, &mut gradients);
    clusters.pull_to_triangles(&model.facets, &mut gradients, &shares);
    let of = |slot: &Option<u32>| slot.map(|slot| gradients[slot as usize]).unwrap_or_default();
    slots.iter().map(of).collect()
}

/// The derivative by the share of each source in the light of its cluster: the product of the source's light and the cluster's
/// cotangent. Adds to `gradients` those by the centroids of sources and clusters, between which the first moment is taken.
fn by_parts(
    model: &Model,
    clusters: &Clusters,
    outgoing: &Outgoing,
    importance: &State,
    light: &ClusterLight,
    gradients: &mut [FacetGradient],
) -> Vec<f64> {
    let cotangents = Cotangents::new(model, clusters, importance);
    let first = clusters.first() as usize;
    let mut shares = vec![0.0; first + light.facets.len()];
    let dot = |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
    let of_moments = |a: &DMat3, b: &DMat3| (0..3).map(|k| a.col(k).dot(b.col(k))).sum::<f64>();
    for (c, parts) in clusters.parts().iter().enumerate() {
        let (own, moment, facet) = (&cotangents.clusters[c], &cotangents.moments[c], &light.facets[c]);
        let mut product = |index: usize, part: &Facet, l: DVec3, m: &DMat3, s: &[DVec3], a: &[DVec3]| {
            let by_centroid = share(part, facet) * (moment.transpose() * l);
            gradients[index].add_centroid(by_centroid);
            gradients[first + c].add_centroid(-by_centroid);
            let by_light = own.diffuse + *moment * (part.centroid - facet.centroid);
            shares[index] =
                by_light.dot(l) + of_moments(moment, m) + dot(&own.specular, s) + dot(&own.antiradiance, a);
        };
        match parts {
            Parts::Triangles(range) => {
                for slot in range.clone() {
                    let i = clusters.order()[slot as usize];
                    if i != PADDING {
                        let bins = model.bins_of(i as usize).unwrap_or(0..0);
                        let (s, a) = (&outgoing.specular[bins.clone()], &outgoing.antiradiance[bins]);
                        let (part, l) = (&model.facets[i as usize], outgoing.diffuse[i as usize]);
                        product(slot as usize, part, l, &DMat3::ZERO, s, a);
                    }
                }
            }
            Parts::Clusters(both) => {
                for &index in both {
                    let part = index as usize - first;
                    let (s, a) = (&light.specular[part], &light.antiradiance[part]);
                    let (l, m) = (light.diffuse[part], &light.moment[part]);
                    product(index as usize, &light.facets[part], l, m, s, a);
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
    let seen = Spread::new(to, from, tilt, angle2);
    let lit = passes(front, passing) && seen.cosine > 0.0 && from > 0.0;
    if !lit {
        return gradient;
    }
    let (diffuse, moment, bins) = match front {
        true => (light.diffuse[c], light.moment[c], &light.specular[c]),
        false => (DVec3::ZERO, DMat3::ZERO, &light.antiradiance[c]),
    };
    let sent = Reading::of_bins(model, source.normal, bins, direction, front);
    let incident = Reading::of_receiver(model, importance, j, direction);
    let (radiance, importance) = (diffuse + sent.value, importance.irradiance[j] + incident.value);
    let value = radiance.dot(importance);
    // How the importance of light changes with its place in the cluster: what the first moment is multiplied by.
    let uneven = moment.transpose() * importance / r;
    let (along, across) = (direction.dot(uneven), receiver.normal.dot(uneven));
    let whole = seen.cosine * value + seen.above * across + 4.0 * seen.mean * along;
    let g = 1.0 / (r2 + source.area / PI);
    let sent_area = from * source.area * g;
    let received =
        radiance * seen.cosine + moment * (seen.above * receiver.normal + 4.0 * seen.mean * direction) / r;

    let by_sent = sent.pull(sent_area * seen.cosine * importance);
    let by_incident = incident.pull(sent_area * received);
    let by = Spread { cosine: value, above: across, mean: 4.0 * along };
    let [by_to, by_from, by_tilt, by_angle2] =
        Spread::pull(by, to, from, tilt, angle2).map(|slope| sent_area * slope);
    let by_from = cos_i.signum() * (by_from + whole * source.area * g);
    let by_tilt = cos_i.signum() * by_tilt;
    gradient.source.normal = by_from * direction + by_tilt * receiver.normal + by_sent.normal;
    gradient.receiver.normal =
        by_tilt * source.normal - by_to * direction + sent_area * seen.above * uneven + by_incident.normal;
    // d(a g)/da = r² g², and dg/dr² = -g².
    gradient.source.area = whole * from * r2 * g * g;
    gradient.source.characteristic_area = by_angle2 / r2;
    let by_direction = by_from * source.normal - by_to * receiver.normal
        + sent_area * 4.0 * seen.mean * uneven
        + by_sent.direction
        + by_incident.direction;
    // The first moment is multiplied by 1/r.
    let by_r2 = -whole * sent_area * g
        - by_angle2 * angle2 / r2
        - 0.5 * sent_area * (whole - seen.cosine * value) / r2;
    gradient.add_between(pull_unit(direction, r, by_direction) + 2.0 * by_r2 * between);
    gradient
}
