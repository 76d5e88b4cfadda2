//! Derivatives by the mean triangle of a cluster, passed on to its triangles.

use super::moments::Moments;
use super::{Clusters, Parts, share};
use crate::model::facet::Facet;
use crate::model::facet_gradient::FacetGradient;

impl Clusters {
    /// Adds the derivatives by clusters to those by triangles: `gradients` of all sources by index, where
    /// clusters have the variance of their triangles in place of the characteristic area, and `shares` by the share of each source in the
    /// light of the cluster that it is part of. `facets` are the triangles.
    pub fn pull_to_triangles(&self, facets: &[Facet], gradients: &mut [FacetGradient], shares: &[f64]) {
        let moments = self.moments(facets);
        let means: Vec<Facet> = moments.iter().map(Moments::facet).collect();
        let mut sums = vec![Moments::default(); moments.len()];
        let first = self.first() as usize;
        // Parts have lower numbers than what they make up.
        for (c, parts) in self.parts().iter().enumerate().rev() {
            let own = &means[c];
            let indices: Vec<(usize, &Facet)> = match parts {
                Parts::Triangles(slots) => {
                    let slots = slots.clone().map(|slot| (slot as usize, self.order()[slot as usize]));
                    slots.filter_map(|(slot, i)| Some((slot, facets.get(i as usize)?))).collect()
                }
                Parts::Clusters(both) => {
                    both.iter().map(|&index| (index as usize, &means[index as usize - first])).collect()
                }
            };
            if own.area == 0.0 {
                continue;
            }
            // Of share = a ⟨n_i, n⟩ / ā.
            for &(index, part) in &indices {
                let by_share = shares[index];
                gradients[index].area += by_share * part.normal.dot(own.normal) / own.area;
                gradients[index].normal += by_share * part.area / own.area * own.normal;
                let of_cluster = &mut gradients[first + c];
                of_cluster.area -= by_share * share(part, own) / own.area;
                of_cluster.normal += by_share * part.area / own.area * part.normal;
            }
            let sum = sums[c] + moments[c].pull(&gradients[first + c]);
            for (index, part) in indices {
                match index.checked_sub(first) {
                    Some(cluster) => sums[cluster] = sums[cluster] + sum,
                    None => sum.pull_triangle(part, &mut gradients[index]),
                }
            }
        }
    }
}
