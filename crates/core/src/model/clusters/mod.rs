//! Clusters: branches of a tree over a group of triangles of one class, each of which can stand for its triangles as one source.
//!
//! A cluster is a mean triangle: the centroid c = Σ a x / Σ a, the normal n along Σ a n_i, and in place of the area
//! ā = Σ a² / Σ a, so that g = 1/(r² + ā/π) is that of its triangles. Its radiance, diffuse or per bin, is
//! Σ a ⟨n_i, n⟩ L_i / ā: with the area ā, a source of the same vector area. Whatever holds from triangle to triangle
//! then holds from cluster to triangle. Where surfaces curve too much for that, there are volume clusters ([`Volumes`]).

mod acceptance;
mod gradient;
mod mean_cosine;
mod moments;
mod receivers;
mod sources;
mod volumes;

pub use mean_cosine::Spread;
pub use receivers::{ReceiverLists, SOURCES};
pub use sources::{ENTRY_BITS, SourceLists};
pub use volumes::{VolumeParts, Volumes};

use super::class::Class;
use super::facet::Facet;
use super::hierarchy::Hierarchy;
use super::order::PADDING;
use super::vector::Vector;
use acceptance::{Acceptance, Trees};
use glam::DVec3;
use moments::{Cuts, Moments};
use std::ops::Range;
use volumes::VolumeTree;

/// Receivers that share a list of sources: neighbouring slots.
pub const LIST: u32 = 32;

/// How far corners may move, in units of the root of a triangle's characteristic area, before lists should be chosen anew. With derivatives,
/// clusters keep the distance that this takes from the near field, so that no list changes until then but for what cannot send light.
pub const MOVED: f64 = 0.25;

/// What a cluster consists of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Parts {
    /// Triangles, by slot; padding among them counts as black.
    Triangles(Range<u32>),
    /// Two clusters.
    Clusters([u32; 2]),
}

impl Parts {
    /// Slots of the triangles, or indices of the two clusters.
    pub fn indices(&self) -> impl Iterator<Item = u32> + use<> {
        let (slots, both) = match self {
            Self::Triangles(slots) => (slots.clone(), None),
            Self::Clusters(both) => (0..0, Some(*both)),
        };
        slots.chain(both.into_iter().flatten())
    }
}

/// The clusters of one group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClusterRun {
    /// The class of all its triangles.
    pub class: Class,
    /// Clusters by their height in the tree: those of triangles, those of the former, and so on.
    pub heights: Vec<Range<u32>>,
}

impl ClusterRun {
    /// All clusters of the group.
    pub fn range(&self) -> Range<u32> {
        let end = self.heights.last().map_or(0, |last| last.end);
        self.heights.first().map_or(0, |first| first.start)..end
    }
}

/// What lists of sources are built from.
#[derive(Clone, Copy, Debug)]
pub struct ClusterInput<'a> {
    /// Triangles.
    pub facets: &'a [Facet],
    /// The triangles at their current positions, if vertices have moved. Clusters and lists are chosen for
    /// `facets` all the same, so that a loss depends smoothly on vertices. What cannot send light now, and
    /// what is too close, follows from the current positions.
    pub moved: Option<&'a [Facet]>,
    /// Class of each triangle.
    pub classes: &'a [Class],
    /// Brightness of the front of each triangle, relative to the mean.
    pub brightness: &'a [f64],
    /// Brightness of the backs of blockers, relative to the mean, one value for all. Antiradiance is as
    /// narrow as the light that it cancels.
    pub backs: f64,
    /// Triangle of each slot, sorted by class, or [`PADDING`].
    pub order: &'a [u32],
    /// The slots with which groups begin. A group has triangles of one class; no cluster has triangles of several.
    pub groups: &'a [u32],
    /// Slots per cluster of the lowest height.
    pub leaf: u32,
    /// Volumes at most; `None` where there are to be none.
    pub most_volumes: Option<usize>,
    /// Half of the near field's range, in units of the sum of characteristic areas.
    pub half_range: f64,
    /// Solid angle of a bin, sr.
    pub bin: f64,
    /// Wanted error of irradiance, relative to its mean.
    pub error: f64,
    /// Whether derivatives are wanted.
    pub slopes: bool,
    /// Whether sources that cannot send light are left out.
    pub cull: bool,
}

/// All clusters of a scene, and for each group of receivers the sources, clusters and triangles, that together make up
/// all others. An index below the number of slots is a triangle's slot; clusters have the indices behind.
#[derive(Clone, Debug)]
pub struct Clusters {
    order: Vec<u32>,
    parts: Vec<Parts>,
    runs: Vec<ClusterRun>,
    volumes: Option<Volumes>,
    sources: SourceLists,
    receivers: Option<ReceiverLists>,
}

impl Clusters {
    /// Builds the tree and the lists, with `by_source` also those of receivers. `None` if there are too many sources to count.
    pub fn new(input: &ClusterInput, by_source: bool) -> Option<Self> {
        let order = input.order;
        let cuts = Cuts::new(input);
        let trees = Trees::new(input, &cuts);
        let Numbered { index, parts, runs } = Numbered::new(input, &trees.sources, &cuts.groups);
        let first = (order.len() + parts.len()) as u32;
        let acceptance = Acceptance::new(input, &trees, &index);
        let mut lists = acceptance.lists(first)?;
        let volumes = acceptance.into_volumes().and_then(|tree| volumes_in(&mut lists, tree, first));
        let sources = SourceLists::new(&lists)?;
        let mut receivers = None;
        if by_source {
            let all = std::iter::once(0..order.len() as u32).chain(runs.iter().map(ClusterRun::range));
            receivers = Some(ReceiverLists::new(&sources, all)?);
        }
        Some(Self { order: order.to_vec(), parts, runs, volumes, sources, receivers })
    }

    /// Number of clusters.
    pub fn count(&self) -> u32 {
        self.parts.len() as u32
    }

    /// Index of the first cluster: the number of slots.
    pub fn first(&self) -> u32 {
        self.order.len() as u32
    }

    /// What each cluster consists of.
    pub fn parts(&self) -> &[Parts] {
        &self.parts
    }

    /// The clusters by group, in the order of their indices.
    pub fn runs(&self) -> &[ClusterRun] {
        &self.runs
    }

    /// The clusters of a run that consist of triangles in a range of slots, of whole groups of [`LIST`].
    pub fn of_triangles(&self, run: &ClusterRun, slots: &Range<u32>) -> Range<u32> {
        let of = run.heights.first().map_or(0..0, Range::clone);
        let parts = &self.parts[(of.start - self.first().min(of.start)) as usize..][..of.len()];
        // Clusters of one height follow one another like their triangles.
        let before = |end: u32| parts.partition_point(|parts| parts.indices().next() < Some(end)) as u32;
        of.start + before(slots.start)..of.start + before(slots.end)
    }

    /// The clusters of a run all of whose triangles are in a range of slots: one range of clusters per height
    /// of the tree.
    pub fn within(&self, run: &ClusterRun, slots: &Range<u32>) -> Vec<Range<u32>> {
        let first = run.range().start;
        let mut spans: Vec<Range<u32>> = Vec::with_capacity(run.range().len());
        // Parts have lower numbers than what they make up.
        for cluster in run.range() {
            let of = |part: u32| &spans[(part - first) as usize];
            spans.push(match &self.parts[(cluster - self.first()) as usize] {
                Parts::Triangles(slots) => slots.clone(),
                Parts::Clusters([a, b]) => of(*a).start.min(of(*b).start)..of(*a).end.max(of(*b).end),
            });
        }
        // Those of one height follow one another like their triangles.
        let of_height = |of: &Range<u32>| {
            let spans = &spans[(of.start - first) as usize..][..of.len()];
            let begin = spans.partition_point(|span| span.start < slots.start) as u32;
            let end = spans.partition_point(|span| span.end <= slots.end) as u32;
            of.start + begin..of.start + end.max(begin)
        };
        run.heights.iter().map(of_height).collect()
    }

    /// Whether an index is that of a cluster of one normal.
    pub fn is_cluster(&self, index: u32) -> bool {
        index >= self.first() && !self.is_volume(index)
    }

    /// Whether an index is that of a volume cluster.
    pub fn is_volume(&self, index: u32) -> bool {
        index >= self.first() + self.count()
    }

    /// The volume clusters among the sources, if any; they have the indices behind those of the others.
    pub fn volumes(&self) -> Option<&Volumes> {
        self.volumes.as_ref()
    }

    /// The volume clusters as facets ([`Volumes::facets`]).
    pub fn volume_facets(&self, facets: &[Facet]) -> Vec<Facet> {
        let of = |slot: u32| facets.get(self.order[slot as usize] as usize);
        self.volumes.as_ref().map_or(Vec::new(), |volumes| volumes.facets(of))
    }

    /// The sources of each group of [`LIST`] receivers.
    pub fn sources(&self) -> &SourceLists {
        &self.sources
    }

    /// The receivers of each group of sources, if asked for.
    pub fn receivers(&self) -> Option<&ReceiverLists> {
        self.receivers.as_ref()
    }

    /// Triangle of each slot, or [`PADDING`].
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// The mean triangle of each cluster. Its corners are its centroid.
    pub fn facets(&self, facets: &[Facet]) -> Vec<Facet> {
        self.moments(facets).iter().map(Moments::facet).collect()
    }

    fn moments(&self, facets: &[Facet]) -> Vec<Moments> {
        let mut moments: Vec<Moments> = Vec::with_capacity(self.parts.len());
        // Parts have lower numbers than what they make up.
        for parts in &self.parts {
            let of = |cluster: &u32| moments[(cluster - self.first()) as usize];
            let sum = match parts {
                Parts::Triangles(slots) => self.triangles(slots).map(|i| Moments::of(&facets[i], 0.0)).sum(),
                Parts::Clusters(both) => both.iter().map(of).sum(),
            };
            moments.push(sum);
        }
        moments
    }

    /// The triangles in a range of slots.
    pub fn triangles(&self, slots: &Range<u32>) -> impl Iterator<Item = usize> + use<'_> {
        let slots = &self.order[slots.start as usize..slots.end as usize];
        slots.iter().filter(|&&i| i != PADDING).map(|&i| i as usize)
    }
}

/// The volumes that lists refer to, which then have their final indices there.
fn volumes_in(lists: &mut [Vec<u32>], tree: VolumeTree, first: u32) -> Option<Volumes> {
    let mut used = vec![false; tree.count()];
    let number = |entry: u32| (entry >> ENTRY_BITS).checked_sub(first).map(|number| number as usize);
    lists.iter().flatten().filter_map(|&entry| number(entry)).for_each(|number| used[number] = true);
    let (volumes, index) = tree.keep(used, first)?;
    for list in lists.iter_mut() {
        for entry in list.iter_mut() {
            if let Some(number) = number(*entry) {
                *entry = index[number] << ENTRY_BITS | *entry & ((1 << ENTRY_BITS) - 1);
            }
        }
        list.sort_unstable();
    }
    Some(volumes)
}

/// The weight of a part's radiance in that of its cluster: a ⟨n_i, n⟩ / ā.
pub fn share<V: Vector>(part: &Facet<V>, cluster: &Facet<V>) -> V::Scalar {
    match cluster.area > 0.0 {
        true => part.area * part.normal.dot(cluster.normal) / cluster.area,
        false => 0.0.into(),
    }
}

/// The branches of a tree that are of one group, numbered as clusters.
struct Numbered {
    /// Per node of the tree, the index of its cluster; `None` if its triangles are of several groups.
    index: Vec<Option<u32>>,
    parts: Vec<Parts>,
    runs: Vec<ClusterRun>,
}

impl Numbered {
    /// `groups`: the group of each leaf of the tree.
    fn new(input: &ClusterInput, tree: &Hierarchy, groups: &[u32]) -> Self {
        let &ClusterInput { order, leaf, .. } = input;
        let nodes = tree.nodes();
        let first = order.len() as u32;
        let (mut heights, mut found) = (vec![0u32; nodes.len()], Vec::new());
        let group_of = |at: usize| {
            let leaves = &nodes[at].leaves;
            let [begin, end] = [leaves.start, leaves.end - 1].map(|leaf| groups[leaf]);
            (begin == end).then_some(begin)
        };
        for at in (0..nodes.len()).rev() {
            if let Some([a, b]) = tree.branches(at) {
                heights[at] = 1 + heights[a].max(heights[b]);
            }
            if let Some(group) = group_of(at) {
                found.push((group, heights[at], at));
            }
        }
        found.sort_unstable();
        let mut index = vec![None; nodes.len()];
        for (&(_, _, at), number) in found.iter().zip(first..) {
            index[at] = Some(number);
        }
        // A group begins with a triangle.
        let run = |&begin: &u32| ClusterRun {
            class: input.classes[order[begin as usize] as usize],
            heights: Vec::new(),
        };
        let mut runs: Vec<ClusterRun> = input.groups.iter().map(run).collect();
        let mut parts = Vec::with_capacity(found.len());
        for (&(group, height, at), number) in found.iter().zip(first..) {
            parts.push(match tree.branches(at).map(|both| both.map(|b| index[b])) {
                Some([Some(a), Some(b)]) => Parts::Clusters([a, b]),
                _ => {
                    let leaves = &nodes[at].leaves;
                    let end = (leaves.end as u32 * leaf).min(first);
                    Parts::Triangles(leaves.start as u32 * leaf..end)
                }
            });
            // Heights of a group follow one another without gaps.
            let of = &mut runs[group as usize].heights;
            if of.len() as u32 <= height {
                of.push(number..number);
            }
            if let Some(last) = of.last_mut() {
                last.end = number + 1;
            }
        }
        Self { index, parts, runs }
    }
}

/// The unit vector along a sum of normals; zero if they cancel.
fn mean_normal(sum: DVec3) -> DVec3 {
    sum.normalize_or_zero()
}
