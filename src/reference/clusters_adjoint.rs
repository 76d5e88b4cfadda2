//! Uᵀ where clusters stand for far triangles. Twin of glsl/cluster_adjoint.comp and glsl/scatter*.comp.

use super::adjoint::{SourceCotangent, outgoing_cotangent};
use super::clusters::{ClusterBeam, Source, add_scaled, cluster_beam, listed, outer, slots, visit_listed};
use super::transport::near_beams;
use super::volumes::VolumeCotangents;
use super::{Model, Outgoing, State};
use crate::model::{Clusters, Facet, Parts, share};
use glam::DMat3;
use rayon::prelude::*;

/// The transpose of [`super::transport_through_clusters`]: from the adjoint λ of the incident light (`importance`) to the
/// cotangent of the outgoing light.
pub fn transport_through_clusters_adjoint(
    model: &Model,
    clusters: &Clusters,
    importance: &State,
) -> Outgoing {
    let mut cotangents = Cotangents::new(model, clusters, importance);
    cotangents.triangles.par_iter_mut().enumerate().for_each(|(i, cotangent)| {
        for j in 0..model.facets.len() {
            near_beams(model, i, j, |beam| cotangent.receive(model, importance, j, beam));
        }
    });
    outgoing_cotangent(model, cotangents.triangles)
}

/// The cotangents of what triangles and clusters send to far receivers.
pub(super) struct Cotangents {
    pub triangles: Vec<SourceCotangent>,
    pub clusters: Vec<SourceCotangent>,
    /// Of the first moments of clusters.
    pub moments: Vec<DMat3>,
}

impl Cotangents {
    /// That of a cluster contains what reaches it from the clusters that it is part of, and passes on to its own parts.
    pub fn new(model: &Model, clusters: &Clusters, importance: &State) -> Self {
        let facets = clusters.facets(&model.facets);
        let classes = clusters.runs().iter().flat_map(|run| run.range().map(|_| run.class));
        let of_cluster = |(facet, class)| SourceCotangent::new(model, facet, class);
        let mut all = Self {
            triangles: (0..model.facets.len()).map(|i| SourceCotangent::of_triangle(model, i)).collect(),
            clusters: facets.iter().copied().zip(classes).map(of_cluster).collect(),
            moments: vec![DMat3::ZERO; facets.len()],
        };
        let mut volumes = VolumeCotangents::new(model, clusters);
        for (j, slot) in slots(model, clusters).into_iter().enumerate() {
            for (source, passing) in listed(clusters, slot) {
                match source {
                    Source::Triangle(i) => visit_listed(model, i, j, passing, |beam| {
                        all.triangles[i].receive(model, importance, j, beam);
                    }),
                    Source::Cluster(c) => {
                        if let Some(ClusterBeam { beam, slope }) = cluster_beam(model, &facets[c], j, passing)
                        {
                            if beam.front {
                                let importance = importance.importance(model, j, -beam.direction);
                                all.moments[c] += outer(importance, slope);
                            }
                            all.clusters[c].receive(model, importance, j, beam);
                        }
                    }
                    Source::Volume(v) => volumes.receive(model, importance, v, j),
                }
            }
        }
        volumes.pass_on(model, clusters, &mut all.triangles);
        // Parts have lower numbers than what they make up.
        for (c, parts) in clusters.parts().iter().enumerate().rev() {
            let (below, above) = all.clusters.split_at_mut(c);
            let (own, moment) = (&above[0], all.moments[c]);
            let pass_on = |to: &mut SourceCotangent, part: &Facet| {
                let share = share(part, &facets[c]);
                to.add(share, own);
                to.diffuse += share * (moment * (part.centroid - facets[c].centroid));
                share
            };
            match parts {
                Parts::Triangles(slots) => clusters.triangles(slots).for_each(|i| {
                    pass_on(&mut all.triangles[i], &model.facets[i]);
                }),
                Parts::Clusters(both) => both.iter().for_each(|index| {
                    let part = (index - clusters.first()) as usize;
                    let share = pass_on(&mut below[part], &facets[part]);
                    all.moments[part] += share * moment;
                }),
            }
        }
        all
    }
}

impl SourceCotangent {
    fn add(&mut self, factor: f64, other: &Self) {
        self.diffuse += factor * other.diffuse;
        add_scaled(&mut self.specular, factor, &other.specular);
        add_scaled(&mut self.antiradiance, factor, &other.antiradiance);
    }
}
