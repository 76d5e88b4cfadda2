//! The light of clusters, gathered from their parts, group by group, and height by height. Twin of crates/core/glsl/gather.comp and gather_bins.comp.

use super::completion::complete;
use super::pairs::{Facet, dot, minus};
use super::real::Real;
use super::scene::{Context, SLOT, count};
use super::steps::Steps;
use crate::backend::{Array, Cpu};
use crate::model::{Class, ClusterRun, Clusters, Parts};
use crate::plan::Plan;
use crate::transport::TransportError;
use crate::transport::bin_shares::BinShares;
use antirad_base::parallel;
use antirad_base::usage::OverBudget;
use std::ops::Range;

/// The light of the clusters of one group at a time.
pub struct ClusterLight<T> {
    /// Bins of the clusters of the group that has most of them.
    antiradiance: Option<Array<T>>,
    specular: Option<Array<T>>,
    /// Who computes bins, by group.
    shares: Vec<BinShares>,
}

/// Sources of one class with their bins in one page: the triangles or the clusters of a group.
#[derive(Clone)]
pub struct Sources<'a, T> {
    pub class: Class,
    pub indices: Range<u32>,
    pub antiradiance: &'a [T],
    pub specular: &'a [T],
}

impl<T: Real> ClusterLight<T> {
    /// `None` where no clusters are planned.
    ///
    /// # Errors
    /// Fails if the memory budget of the CPU does not hold the pages.
    pub fn new(cpu: &Cpu, plan: &Plan) -> Result<Option<Self>, OverBudget> {
        let Some(clusters) = plan.clusters() else { return Ok(None) };
        let runs = clusters.runs().iter().enumerate();
        Ok(Some(Self {
            antiradiance: page(cpu, plan, "cluster antiradiance", |class| class.blocker)?,
            specular: page(cpu, plan, "cluster specular", |class| class.glossy)?,
            shares: runs.map(|(group, run)| BinShares::of(plan, group, clusters, run)).collect(),
        }))
    }

    /// Computes the light of the clusters of a group from that of its triangles; with `backs`, of their
    /// backs, too. It replaces that of the group before.
    ///
    /// # Errors
    /// Fails if the plan has no clusters, or if another rank has ended.
    pub fn gather(
        &mut self,
        context: &Context<T>,
        radiance: &mut [T],
        group: usize,
        triangles: &Sources<T>,
        backs: bool,
        steps: &Steps,
    ) -> Result<(), TransportError> {
        let (clusters, run) = clusters_of(&context.plan, group)?;
        let share = &self.shares[group];
        let class = run.class;
        let pages = [
            (class.blocker && backs, &mut self.antiradiance, triangles.antiradiance),
            (class.glossy, &mut self.specular, triangles.specular),
        ];
        steps.timed("clusters", "radiance", run.range().len() as u64, || {
            gather_radiance(context, clusters, run, radiance);
        });
        for (wanted, page, from) in pages {
            if !wanted {
                continue;
            }
            let page = page.as_mut().ok_or_else(|| TransportError::missing("bins of clusters"))?;
            let bins = ClusterBins { clusters, run, facets: &context.scene.facets, reals: context.bins() };
            let from = (from, triangles.indices.start);
            steps.timed("clusters", "bins", run.range().len() as u64, || {
                let ranks = context.cpu.ranks();
                if let Some(own) = share.by_rank.get(ranks.rank()) {
                    let own: Vec<_> = own.iter().map(|of| vec![of.clone()]).collect();
                    bins.gather(from, page, &own);
                    for height in 0..run.heights.len() {
                        let shares: Vec<_> = share.by_rank.iter().map(|of| of[height].clone()).collect();
                        complete(ranks, page, (run.range().start, context.bins()), &shares)?;
                    }
                }
                bins.gather(from, page, &share.by_all);
                Ok::<_, TransportError>(())
            })?;
        }
        Ok(())
    }

    /// The clusters of a group as sources, once they are gathered.
    ///
    /// # Errors
    /// Fails if the plan has no clusters.
    pub fn sources(&self, plan: &Plan, group: usize, backs: bool) -> Result<Sources<'_, T>, TransportError> {
        let (_, run) = clusters_of(plan, group)?;
        fn bins<T>(page: &Option<Array<T>>, wanted: bool) -> &[T] {
            page.as_ref().filter(|_| wanted).map_or(&[], |page| page)
        }
        Ok(Sources {
            class: run.class,
            indices: run.range(),
            antiradiance: bins(&self.antiradiance, run.class.blocker && backs),
            specular: bins(&self.specular, run.class.glossy),
        })
    }
}

/// The diffuse radiance of clusters, L = Σ a ⟨n_i, n⟩ L_i / ā, and its first moment around the centroid.
fn gather_radiance<T: Real>(context: &Context<T>, clusters: &Clusters, run: &ClusterRun, radiance: &mut [T]) {
    let (facets, first) = (&context.scene.facets, clusters.first());
    let moments = context.plan.sources();
    let row = |at: u32| at as usize * SLOT;
    for cluster in run.range() {
        let own = Facet::read(facets, cluster);
        let parts = &clusters.parts()[(cluster - first) as usize];
        let (mut sum, mut moment) = ([T::ZERO; 3], [[T::ZERO; 3]; 3]);
        for part in parts.indices() {
            let facet = Facet::read(facets, part);
            let factor = share(&facet, &own);
            let offset = minus(facet.centre, own.centre);
            for c in 0..3 {
                let light = factor * radiance[row(part) + c];
                sum[c] += light;
                (0..3).for_each(|a| moment[a][c] += offset[a] * light);
            }
            if let Parts::Clusters(_) = parts {
                let at = moments + 3 * (part - first);
                for (a, moment) in moment.iter_mut().enumerate() {
                    (0..3).for_each(|c| moment[c] += factor * radiance[row(at + a as u32) + c]);
                }
            }
        }
        radiance[row(cluster)..][..3].copy_from_slice(&sum);
        for (a, moment) in moment.iter().enumerate() {
            radiance[row(moments + 3 * (cluster - first) + a as u32)..][..3].copy_from_slice(moment);
        }
    }
}

/// The bins of the clusters of a group, or cotangents of these.
pub struct ClusterBins<'a, T> {
    pub clusters: &'a Clusters,
    pub run: &'a ClusterRun,
    pub facets: &'a [T],
    /// Numbers of the bins of one cluster.
    pub reals: usize,
}

/// The index with which bins begin.
#[derive(Clone, Copy)]
struct Page {
    reals: usize,
    first: u32,
}

impl Page {
    fn at(self, index: u32) -> Range<usize> {
        let begin = (index - self.first) as usize * self.reals;
        begin..begin + self.reals
    }
}

impl<T: Real> ClusterBins<'_, T> {
    fn page(&self) -> Page {
        Page { reals: self.reals, first: self.run.range().start }
    }

    fn parts(&self, cluster: u32) -> &Parts {
        &self.clusters.parts()[(cluster - self.clusters.first()) as usize]
    }

    /// Sets the bins of some clusters, by height, from those of triangles, which begin with a slot, or of others.
    fn gather(&self, (triangles, first): (&[T], u32), own: &mut [T], heights: &[Vec<Range<u32>>]) {
        let page = self.page();
        let of_triangles = Page { first, ..page };
        for of in heights.iter().flatten() {
            // Parts come before what they make up.
            let (before, own) = own.split_at_mut(page.at(of.start).start);
            let own = &mut own[..of.len() * page.reals];
            let gathered = |(own, cluster): (&mut [T], u32)| {
                own.fill(T::ZERO);
                for part in self.parts(cluster).indices() {
                    let from = match self.parts(cluster) {
                        Parts::Triangles(_) => &triangles[of_triangles.at(part)],
                        Parts::Clusters(_) => &before[page.at(part)],
                    };
                    add(share_of(self.facets, part, cluster), from, own);
                }
            };
            parallel::each(own.chunks_mut(page.reals).zip(of.clone()), gathered);
        }
    }

    /// Adds to the cotangents of clusters those of the clusters that contain them, from the top of the tree
    /// down.
    pub fn within(&self, own: &mut [T]) {
        let page = self.page();
        for of in self.run.heights.iter().skip(1).rev() {
            let (before, own) = own.split_at_mut(page.at(of.start).start);
            self.scatter(of, (own, Page { first: of.start, ..page }), (before, page));
        }
    }

    /// Adds to the cotangents of triangles, of which the first has the slot `first`, those of the clusters
    /// `of` that contain them.
    pub fn to_triangles(&self, own: &[T], of: &Range<u32>, (triangles, first): (&mut [T], u32)) {
        let page = self.page();
        self.scatter(of, (own, page), (triangles, Page { first, ..page }));
    }

    /// Adds the cotangents of the clusters `of` to those of their parts, weighted by their shares. Each page
    /// comes with its layout.
    fn scatter(&self, of: &Range<u32>, (from, from_page): (&[T], Page), (to, to_page): (&mut [T], Page)) {
        let of_cluster = |cluster: u32| self.parts(cluster).indices().map(move |part| (part, cluster));
        let mut parts: Vec<(u32, u32)> = of.clone().flat_map(of_cluster).collect();
        parts.sort_unstable();
        // No part belongs to two clusters.
        let mut own = Vec::with_capacity(parts.len());
        let (mut rest, mut at) = (to, 0);
        for &(part, cluster) in &parts {
            let Range { start, end } = to_page.at(part);
            let (this, behind) = rest.split_at_mut(end - at);
            own.push((&mut this[start - at..], part, cluster));
            (rest, at) = (behind, end);
        }
        parallel::each(own, |(to, part, cluster)| {
            add(share_of(self.facets, part, cluster), &from[from_page.at(cluster)], to);
        });
    }
}

/// The weight of a part's radiance in that of its cluster: [`crate::model::share`].
pub fn share<T: Real>(part: &Facet<T>, cluster: &Facet<T>) -> T {
    let share = part.area * dot(part.normal, cluster.normal) / cluster.area;
    if cluster.area > T::ZERO { share } else { T::ZERO }
}

fn share_of<T: Real>(facets: &[T], part: u32, cluster: u32) -> T {
    share(&Facet::read(facets, part), &Facet::read(facets, cluster))
}

fn add<T: Real>(factor: T, from: &[T], to: &mut [T]) {
    for (to, &from) in to.iter_mut().zip(from) {
        *to += factor * from;
    }
}

/// The clusters of the scene, and of one group.
///
/// # Errors
/// Fails if the plan has no clusters.
pub fn clusters_of(plan: &Plan, group: usize) -> Result<(&Clusters, &ClusterRun), TransportError> {
    let of = plan.clusters().and_then(|clusters| Some((clusters, clusters.runs().get(group)?)));
    of.ok_or_else(|| TransportError::missing("clusters"))
}

/// Room for the bins of the clusters of any group of some classes. `None` where there is none.
///
/// # Errors
/// Fails if the memory budget of the CPU does not hold the page.
pub fn page<T: Real>(
    cpu: &Cpu,
    plan: &Plan,
    label: &str,
    wanted: fn(&Class) -> bool,
) -> Result<Option<Array<T>>, OverBudget> {
    let reals = count::<T>(plan.cluster_page_bytes(wanted));
    (reals > 0).then(|| cpu.array(label, reals)).transpose()
}
