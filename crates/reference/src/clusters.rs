//! What clusters and volumes send, as weighted sums of what their parts send. Twin of crates/core/glsl/cluster_*.comp, crates/core/glsl/volume_bins.comp and
//! crates/core/glsl/scatter*.comp.

use super::Model;
use super::light::{DIFFUSE, MOMENT, Runs, SPECULAR};
use super::lines::{Beam, Way, sent};
use super::variables::{NUMBERS, gradient, variable};
use antirad_core::model::{
    Bins, Class, Clusters, Dual, Facet, FacetGradient, LIST, PADDING, Parts, Scalar, Vector, VolumeParts,
    share,
};

/// Clusters and volumes, numbered as sources behind the triangles.
pub struct Clustered<'a> {
    bins: &'a Bins,
    clusters: &'a Clusters,
    /// Classes of all sources that are triangles.
    triangles: &'a [Class],
    /// The slot of each triangle; those without area have none.
    slots: Vec<Option<u32>>,
    /// Mean triangles, of clusters and volumes.
    pub facets: Vec<Facet>,
    pub classes: Vec<Class>,
}

impl<'a> Clustered<'a> {
    pub fn new(model: &'a Model, clusters: &'a Clusters) -> Self {
        let mut slots = vec![None; model.facets.len()];
        for (slot, &i) in (0u32..).zip(clusters.order()) {
            if let Some(of) = slots.get_mut(i as usize) {
                *of = Some(slot);
            }
        }
        let volumes = clusters.volume_facets(&model.facets);
        let of_clusters = clusters.runs().iter().flat_map(|run| run.range().map(|_| run.class));
        // Its bins are those of both hemispheres.
        let of_volumes = volumes.iter().map(|_| Class { glossy: true, blocker: true });
        Self {
            bins: &model.bins,
            clusters,
            triangles: &model.classes,
            slots,
            classes: of_clusters.chain(of_volumes).collect(),
            facets: [clusters.facets(&model.facets), volumes].concat(),
        }
    }

    /// The far sources of a receiver.
    pub fn listed(&self, j: usize) -> impl Iterator<Item = (usize, Way)> {
        let entries = self.slots[j].into_iter().flat_map(|slot| self.clusters.sources().sources(slot / LIST));
        entries.map(|(index, passing)| match self.clusters.order().get(index as usize) {
            Some(&i) => (i as usize, Way::Far(passing)),
            None if self.clusters.is_volume(index) => (self.source(index), Way::Volume),
            None => (self.source(index), Way::Cluster(passing)),
        })
    }

    /// The number as a source of a cluster or volume, by its index in lists.
    fn source(&self, index: u32) -> usize {
        self.triangles.len() + (index - self.clusters.first()) as usize
    }

    fn is_volume(&self, source: usize) -> bool {
        source >= self.triangles.len() + self.clusters.count() as usize
    }

    /// All clusters and volumes. Parts have lower numbers than what they make up.
    fn wholes(&self) -> std::ops::Range<usize> {
        self.triangles.len()..self.triangles.len() + self.facets.len()
    }

    /// The sources that make up a cluster, and the triangles of a volume.
    fn parts(&self, whole: usize) -> Vec<usize> {
        let number = whole - self.triangles.len();
        match self.clusters.parts().get(number) {
            None => self.triangles_of(number - self.clusters.count() as usize),
            Some(Parts::Triangles(slots)) => self.clusters.triangles(slots).collect(),
            Some(Parts::Clusters(both)) => both.map(|index| self.source(index)).to_vec(),
        }
    }

    fn triangles_of(&self, volume: usize) -> Vec<usize> {
        let Some(volumes) = self.clusters.volumes() else { return Vec::new() };
        match &volumes.parts()[volume] {
            VolumeParts::Triangles(at) => {
                let slots = &volumes.slots()[at.start as usize..at.end as usize];
                let of = slots.iter().map(|&slot| self.clusters.order()[slot as usize]);
                of.filter(|&i| i != PADDING).map(|i| i as usize).collect()
            }
            VolumeParts::Volumes(both) => {
                let first = volumes.run().range().start;
                both.iter().flat_map(|part| self.triangles_of((part - first) as usize)).collect()
            }
        }
    }

    /// Visits each entry of a cluster's or volume's run with the entry of a part's run that is added to it, and the weight.
    fn for_each_weight<V: Vector>(
        &self,
        [whole, part]: [usize; 2],
        [whole_facet, part_facet]: [&Facet<V>; 2],
        mut visit: impl FnMut(usize, usize, V::Scalar),
    ) {
        if self.is_volume(whole) {
            return self.for_each_bin(part, [whole_facet, part_facet], visit);
        }
        // Bins of parts need no rotation: their frames are similar.
        let share = share(part_facet, whole_facet);
        let class = self.classes[whole - self.triangles.len()];
        let bins = if class.has_bins() { 2 * self.bins.count() } else { 0 };
        (0..SPECULAR + bins).for_each(|entry| visit(entry, entry, share));
        let offset = (part_facet.centroid - whole_facet.centroid).to_array();
        for (axis, offset) in offset.into_iter().enumerate() {
            visit(MOMENT + axis, DIFFUSE, share * offset);
        }
    }

    /// Each bin of a volume, I(ω) / ā with the directions ω of bins above the horizon, and -I(-ω) / ā below, with what a triangle sends in
    /// its direction.
    fn for_each_bin<V: Vector>(
        &self,
        triangle: usize,
        [whole, part]: [&Facet<V>; 2],
        mut visit: impl FnMut(usize, usize, V::Scalar),
    ) {
        for (bin, &centre) in self.bins.centre.iter().enumerate() {
            for (entry, sign) in [(SPECULAR + bin, 1.0), (SPECULAR + self.bins.count() + bin, -1.0)] {
                let direction = V::from(sign * centre);
                let cosine = direction.dot(part.normal);
                let seen = cosine.abs() * part.area / whole.area;
                let front = cosine > 0.0;
                let beam = Beam { direction, front, diffuse: seen, binned: seen, slope: None };
                for &(from, weight) in sent(self.bins, part, self.triangles[triangle], &beam).entries() {
                    visit(entry, from, weight * sign);
                }
            }
        }
    }

    /// Adds to the light of clusters and volumes that of their parts.
    pub fn gather(&self, facets: &[Facet], light: &mut Runs) {
        for whole in self.wholes() {
            for part in self.parts(whole) {
                self.for_each_weight([whole, part], [&facets[whole], &facets[part]], |to, from, weight| {
                    let value = weight * light[part][from];
                    light[whole][to] += value;
                });
            }
        }
    }

    /// The transpose: adds to the cotangents of parts those of what they make up.
    pub fn scatter(&self, facets: &[Facet], cotangents: &mut Runs) {
        for whole in self.wholes().rev() {
            for part in self.parts(whole) {
                self.for_each_weight([whole, part], [&facets[whole], &facets[part]], |to, from, weight| {
                    let value = weight * cotangents[whole][to];
                    cotangents[part][from] += value;
                });
            }
        }
    }

    /// Passes the derivatives by clusters on to their triangles, with those by the weights with which the
    /// light of clusters is gathered. `cotangents`: those of what all sources send.
    pub fn pull(&self, facets: &[Facet], light: &Runs, cotangents: &Runs, gradients: &mut [FacetGradient]) {
        assert!(self.clusters.volumes().is_none(), "volumes are not planned where derivatives are wanted");
        for whole in self.wholes() {
            for part in self.parts(whole) {
                let mut sum = Dual::<{ 2 * NUMBERS }>::from(0.0);
                let ends = [(&facets[whole], 0), (&facets[part], NUMBERS)];
                let [a, b] = ends.map(|(facet, first)| variable(facet, first));
                self.for_each_weight([whole, part], [&a, &b], |to, from, weight| {
                    sum = sum + weight * cotangents[whole][to].dot(light[part][from]);
                });
                let (by_whole, by_part) = sum.slopes.split_at(NUMBERS);
                gradients[whole] += gradient(by_whole);
                gradients[part] += gradient(by_part);
            }
        }
        // By slot, and after these clusters.
        let triangles = self.clusters.order().iter().map(|&i| gradients.get(i as usize));
        let mut by_slot: Vec<FacetGradient> = triangles.map(|of| of.copied().unwrap_or_default()).collect();
        by_slot.extend(&gradients[self.triangles.len()..]);
        let shares = vec![0.0; by_slot.len()];
        self.clusters.pull_to_triangles(&facets[..self.triangles.len()], &mut by_slot, &shares);
        for (&i, of) in self.clusters.order().iter().zip(by_slot) {
            if i != PADDING {
                gradients[i as usize] = of;
            }
        }
    }
}
