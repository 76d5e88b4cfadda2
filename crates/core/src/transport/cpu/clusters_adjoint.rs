//! The cotangents of the light of clusters, passed on to their parts, height by height. Twin of crates/core/glsl/scatter.comp, scatter_bins.comp and
//! cluster_shares.comp.

use super::clusters::{ClusterBins, Sources, page, share};
use super::derivative::GRADIENT;
use super::far_adjoint::Accumulated;
use super::pairs::{Facet, minus};
use super::real::Real;
use super::scene::{Context, SLOT};
use crate::backend::{Array, Cpu};
use crate::model::{Class, ClusterRun, Clusters, Parts};
use crate::plan::Plan;
use antirad_base::parallel;
use antirad_base::usage::OverBudget;
use std::ops::Range;

/// Offset in the gradient of a part at which the derivative by its share is kept.
const SHARE: usize = 11;

/// The cotangents of the light of clusters. Those of bins are of one group at a time.
pub struct ClusterCotangents<T> {
    /// Cotangents of diffuse radiance, four numbers per cluster; then of its first moments, three rows per
    /// cluster.
    pub radiance: Array<T>,
    /// Cotangents of bins, with room for the group that has most clusters: of H(b) behind the antiradiance,
    /// as in a state of the adjoint, and of specular radiance.
    bins: [Option<Array<T>>; 2],
}

impl<T: Real> ClusterCotangents<T> {
    /// `None` where no clusters are planned.
    ///
    /// # Errors
    /// Fails if the memory budget of the CPU does not hold the arrays.
    pub fn new(cpu: &Cpu, plan: &Plan) -> Result<Option<Self>, OverBudget> {
        let Some(clusters) = plan.clusters() else { return Ok(None) };
        let bins = |wanted| page(cpu, plan, "cotangent: cluster bins", wanted);
        Ok(Some(Self {
            radiance: cpu.array("cotangent: clusters", 4 * clusters.count() as usize * SLOT)?,
            bins: [bins(|class| class.blocker)?, bins(|class| class.glossy)?],
        }))
    }

    /// Sets to zero the cotangents of the bins of a class, and those of diffuse radiance of all clusters.
    pub fn clear(&mut self, class: Class) {
        self.radiance.fill(T::ZERO);
        self.bins_mut(class).into_iter().flatten().for_each(|bins| bins.fill(T::ZERO));
    }

    /// The cotangents of the antiradiance and of the specular radiance of clusters of a class; `None` where
    /// it has none.
    pub fn bins_mut(&mut self, class: Class) -> [Option<&mut [T]>; 2] {
        let [back, front] = &mut self.bins;
        [back.as_deref_mut().filter(|_| class.blocker), front.as_deref_mut().filter(|_| class.glossy)]
    }

    fn bins(&self, class: Class) -> [&[T]; 2] {
        let [back, front] = &self.bins;
        [
            back.as_deref().filter(|_| class.blocker).unwrap_or(&[]),
            front.as_deref().filter(|_| class.glossy).unwrap_or(&[]),
        ]
    }

    /// The arrays in which a pass accumulates the cotangents of clusters of a class.
    pub fn accumulated(&mut self, class: Class) -> Accumulated<'_, T> {
        let Self { radiance, bins: [back, front] } = self;
        Accumulated {
            radiance,
            back: back.as_deref_mut().filter(|_| class.blocker).unwrap_or(&mut []),
            front: front.as_deref_mut().filter(|_| class.glossy).unwrap_or(&mut []),
        }
    }

    /// Adds to the cotangents of the clusters of a group those of the clusters that contain them, from the
    /// top of the tree down.
    pub fn within(&mut self, context: &Context<T>, (clusters, run): (&Clusters, &ClusterRun)) {
        let of = ClusterBins { clusters, run, facets: &context.scene.facets, reals: context.bins() };
        self.bins_mut(run.class).into_iter().flatten().for_each(|bins| of.within(bins));
        let first = clusters.first();
        for cluster in run.heights.iter().skip(1).rev().flat_map(Range::clone) {
            let given = Given::read(&self.radiance, clusters, cluster);
            for part in clusters.parts()[(cluster - first) as usize].indices() {
                let (factor, light) = given.light(context, cluster, part);
                let moments = [clusters.count() + 3 * (part - first), part - first];
                add(&mut self.radiance, moments[1], T::ONE, light);
                (0..3)
                    .for_each(|a| add(&mut self.radiance, moments[0] + a, factor, given.moment[a as usize]));
            }
        }
    }

    /// Adds those of clusters of triangles to those of this rank's triangles of a group, with these slots: of radiance, and of the bins
    /// behind the backs and in front.
    pub fn to_triangles(
        &self,
        context: &Context<T>,
        (clusters, run): (&Clusters, &ClusterRun),
        slots: &Range<u32>,
        radiance: &mut [T],
        bins: [&mut [T]; 2],
    ) {
        let of = &clusters.of_triangles(run, slots);
        let parts = ClusterBins { clusters, run, facets: &context.scene.facets, reals: context.bins() };
        for (own, to) in self.bins(run.class).into_iter().zip(bins) {
            if !own.is_empty() {
                parts.to_triangles(own, of, (to, slots.start));
            }
        }
        for cluster in of.clone() {
            let given = Given::read(&self.radiance, clusters, cluster);
            for part in clusters.parts()[(cluster - clusters.first()) as usize].indices() {
                add(radiance, part, T::ONE, given.light(context, cluster, part).1);
            }
        }
    }

    /// Sets the derivative by the share of each part in the light of its cluster, in `gradients`, and adds that by the centroids between
    /// which the first moment is taken, for the clusters of a group; `sources` are the light of its triangles and of its clusters.
    pub fn shares(
        &self,
        context: &Context<T>,
        (clusters, run): (&Clusters, &ClusterRun),
        radiance: &[T],
        [triangles, own]: [&Sources<T>; 2],
        gradients: &mut [T],
    ) {
        let Context { plan, scene, .. } = context;
        let first = clusters.first();
        let reals = context.bins();
        let channels = context.layout.channels;
        let [back, front] = self.bins(run.class);
        let of_cluster = |cluster: u32| {
            let given = Given::read(&self.radiance, clusters, cluster);
            let facet = Facet::read(&scene.facets, cluster);
            let parts = &clusters.parts()[(cluster - first) as usize];
            let from = if matches!(parts, Parts::Triangles(_)) { triangles } else { own };
            let to = (cluster - run.range().start) as usize * reals;
            let of_part = |part: u32| {
                let at = (part - from.indices.start) as usize * reals;
                let mut sum = T::ZERO;
                if !back.is_empty() && !from.antiradiance.is_empty() {
                    let pairs = from.antiradiance[at..][..reals].iter().zip(&back[to..][..reals]);
                    for (k, (&light, &cotangent)) in pairs.enumerate() {
                        sum += scene.bin_table[k / channels * SLOT + 3] * light * cotangent;
                    }
                }
                if !front.is_empty() {
                    let pairs = from.specular[at..][..reals].iter().zip(&front[to..][..reals]);
                    pairs.for_each(|(&light, &cotangent)| sum += light * cotangent);
                }
                let part_facet = Facet::read(&scene.facets, part);
                let light = row(radiance, part);
                let offset = minus(part_facet.centre, facet.centre);
                let mut seen = given.own;
                for (offset, moment) in offset.into_iter().zip(&given.moment) {
                    (0..3).for_each(|c| seen[c] += moment[c] * offset);
                }
                sum += inner(light, seen);
                if let Parts::Clusters(_) = parts {
                    for (a, moment) in (0..).zip(&given.moment) {
                        sum += inner(row(radiance, plan.sources() + 3 * (part - first) + a), *moment);
                    }
                }
                let third = share(&part_facet, &facet) / T::of(3.0);
                (part, sum, given.moment.map(|moment| third * inner(moment, light)))
            };
            (cluster, parts.indices().map(of_part).collect::<Vec<_>>())
        };
        let found = parallel::map(run.range(), of_cluster);
        for (cluster, parts) in found {
            for (part, sum, by_centre) in parts {
                gradients[part as usize * GRADIENT + SHARE] = sum;
                add_to_corners(gradients, part, by_centre);
                add_to_corners(gradients, cluster, by_centre.map(|by| -by));
            }
        }
    }
}

/// The cotangent of the radiance of a cluster, and of its first moment.
struct Given<T> {
    own: [T; 3],
    moment: [[T; 3]; 3],
}

impl<T: Real> Given<T> {
    fn read(radiance: &[T], clusters: &Clusters, cluster: u32) -> Self {
        let number = cluster - clusters.first();
        let at = clusters.count() + 3 * number;
        Self { own: row(radiance, number), moment: [0, 1, 2].map(|a| row(radiance, at + a)) }
    }

    /// The share of a part, and what comes of it to the part's radiance.
    fn light(&self, context: &Context<T>, cluster: u32, part: u32) -> (T, [T; 3]) {
        let [part, cluster] = [part, cluster].map(|index| Facet::read(&context.scene.facets, index));
        let factor = share(&part, &cluster);
        let [x, y, z] = minus(part.centre, cluster.centre);
        let m = &self.moment;
        (factor, [0, 1, 2].map(|c| factor * (self.own[c] + (m[0][c] * x + m[1][c] * y + m[2][c] * z))))
    }
}

fn row<T: Real>(of: &[T], at: u32) -> [T; 3] {
    let row = &of[at as usize * SLOT..][..3];
    [row[0], row[1], row[2]]
}

fn add<T: Real>(to: &mut [T], at: u32, factor: T, value: [T; 3]) {
    let row = &mut to[at as usize * SLOT..][..3];
    row.iter_mut().zip(value).for_each(|(to, value)| *to += factor * value);
}

fn inner<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Adds a third of the gradient by the centroid to each corner.
fn add_to_corners<T: Real>(gradients: &mut [T], index: u32, by_corner: [T; 3]) {
    let gradient = &mut gradients[index as usize * GRADIENT..][..GRADIENT];
    for corner in 0..3 {
        (0..3).for_each(|a| gradient[4 * corner + a] += by_corner[a]);
    }
}
