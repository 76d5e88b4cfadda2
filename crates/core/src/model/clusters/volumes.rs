//! Volume clusters: triangles with bins, of any orientation and class, that lie close together and radiate as one point, with an
//! intensity per direction over the whole sphere (F. Sillion 1995, "A Unified Hierarchical Algorithm for Global Illumination with
//! Scattering Volumes and Object Clusters").
//!
//! Clusters of one normal each are small and many where surfaces curve, and none reaches beyond an object. To
//! a volume it does not matter what it contains: with the direction ω from its centroid c to the receiver, it
//! sends the net intensity I(ω) = Σ a_i |⟨n_i, ω⟩| (front: L_i(ω); back: -A_i(-ω)), in which what fronts send
//! and what backs cancel are one. The first moment of the places of triangles along ω is left out on purpose:
//! seen from its centre a sphere that shines evenly is exact without.

use super::acceptance::{Receivers, WIDEST, are_near};
use super::moments::Moments;
use super::{ClusterInput, ClusterRun};
use crate::model::class::Class;
use crate::model::facet::Facet;
use crate::model::hierarchy::Hierarchy;
use crate::model::order::{BoundedRun, PADDING};
use glam::{DMat3, DVec3};
use rayon::join;
use std::f64::consts::PI;
use std::ops::Range;

/// Fewest triangles that are cut in two, if there is room for as many volumes.
const LEAST: usize = 32;
/// Plane pieces of surface in a volume, at least: clusters of one normal serve fewer as fast, and more accurately.
const FEWEST: usize = 8;
/// Largest vector area of a volume over its area. What faces one way shines like a cosine, which the wide bins of a volume flatten.
const ONE_SIDED: f64 = 0.98;
/// Triangles of a branch that is built by one thread.
const ALONE: usize = 1 << 14;
/// Smallest share of its triangles in a part, which bounds the height of the tree.
const LEAST_SHARE: usize = 8;
/// Factor on the error that a volume may have: with this, what is left of 50 000 triangles of balls is below the error asked down to .1 %;
/// with .5 it is not.
const CAREFUL: f64 = 0.2;

/// What a volume consists of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum VolumeParts {
    /// Triangles, by their positions in [`Volumes::slots`].
    Triangles(Range<u32>),
    /// Two volumes.
    Volumes([u32; 2]),
}

/// The volumes that lists of sources refer to, and what they consist of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Volumes {
    slots: Vec<u32>,
    parts: Vec<VolumeParts>,
    run: ClusterRun,
}

impl Volumes {
    /// Slots of triangles, ascending within each volume of triangles.
    pub fn slots(&self) -> &[u32] {
        &self.slots
    }

    /// What each volume consists of.
    pub fn parts(&self) -> &[VolumeParts] {
        &self.parts
    }

    /// Indices of the volumes by height: those of triangles, those of the former, and so on.
    pub fn run(&self) -> &ClusterRun {
        &self.run
    }

    /// Each volume as a facet. Its corners are its centroid, its area is the mean area ā = Σ a² / Σ a of its
    /// triangles, its frame is that of the world, and its characteristic area is the variance of the
    /// triangles. `facets`: by slot, `None` for padding.
    pub fn facets<'a>(&self, facets: impl Fn(u32) -> Option<&'a Facet>) -> Vec<Facet> {
        let first = self.run.range().start;
        let mut moments: Vec<Moments> = Vec::with_capacity(self.parts.len());
        for parts in &self.parts {
            moments.push(match parts {
                VolumeParts::Triangles(at) => {
                    let slots = &self.slots[at.start as usize..at.end as usize];
                    slots.iter().filter_map(|&slot| facets(slot)).map(|f| Moments::of(f, 0.0)).sum()
                }
                VolumeParts::Volumes([a, b]) => moments[(a - first) as usize] + moments[(b - first) as usize],
            });
        }
        moments.iter().map(|moments| Facet { normal: DVec3::Z, ..moments.facet() }).collect()
    }
}

/// Runs of positions by which a place is known: the two trees cut space differently, and one run would span much that lies between.
const RUNS: usize = 4;

/// The place of the triangles of a branch of another tree in the tree of volumes: whether it holds all, and
/// runs of positions that contain those that it holds.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub all: bool,
    /// The first and the last position of each, ascending; as many as there are, and then empty ones.
    runs: [[u32; 2]; RUNS],
}

impl Place {
    const EMPTY: [u32; 2] = [u32::MAX, 0];

    /// The place of no triangles.
    pub const NOWHERE: Self = Self { all: true, runs: [Self::EMPTY; RUNS] };

    /// The place of one triangle by its position, if it is in the tree.
    pub fn of(position: Option<u32>) -> Self {
        let mut runs = [Self::EMPTY; RUNS];
        if let Some(at) = position {
            runs[0] = [at, at];
        }
        Self { all: position.is_some(), runs }
    }

    pub fn runs(&self) -> impl Iterator<Item = [u32; 2]> {
        self.runs.into_iter().take_while(|run| *run != Self::EMPTY)
    }

    /// The place of the triangles of both. Where there are too many runs, those with the least between them
    /// become one.
    pub fn with(self, other: Self) -> Self {
        let mut both = [Self::EMPTY; 2 * RUNS];
        both[..RUNS].copy_from_slice(&self.runs);
        both[RUNS..].copy_from_slice(&other.runs);
        both.sort_unstable();
        let mut count = both.iter().filter(|run| **run != Self::EMPTY).count();
        let between = |both: &[[u32; 2]], k: usize| both[k + 1][0].saturating_sub(both[k][1]);
        loop {
            let nearest = (1..count).map(|k| k - 1).min_by_key(|&k| between(&both, k));
            let Some(k) = nearest.filter(|&k| count > RUNS || between(&both, k) <= 1) else { break };
            both[k][1] = both[k][1].max(both[k + 1][1]);
            both.copy_within(k + 2..count, k + 1);
            count -= 1;
            both[count] = Self::EMPTY;
        }
        let mut runs = [Self::EMPTY; RUNS];
        runs.copy_from_slice(&both[..RUNS]);
        Self { all: self.all && other.all, runs }
    }
}

/// A branch of the tree over all triangles with bins.
struct Branch {
    /// Positions of its triangles.
    at: Range<u32>,
    bounds: BoundedRun,
    /// The largest.
    characteristic_area: f64,
    moments: Moments,
    /// Σ a n nᵀ.
    orientations: DMat3,
    blocks: bool,
    /// The plane pieces of surface that its triangles belong to, up to [`FEWEST`] of them.
    planes: Vec<u32>,
    parts: Option<[usize; 2]>,
}

/// The tree from which lists choose volumes.
pub struct VolumeTree<'a> {
    input: &'a ClusterInput<'a>,
    /// Branches, each before its parts.
    branches: Vec<Branch>,
    slots: Vec<u32>,
    /// The position of each slot, if it is in the tree.
    position: Vec<Option<u32>>,
}

impl<'a> VolumeTree<'a> {
    /// Builds a tree of at most `most` volumes, or of one if even that is more. `planes`: per slot, the plane
    /// piece of surface that its triangle belongs to.
    pub fn new(input: &'a ClusterInput<'a>, most: usize, planes: &[u32]) -> Self {
        let &ClusterInput { order, classes, .. } = input;
        let has_bins = |slot: &u32| {
            let i = order[*slot as usize];
            i != PADDING && classes[i as usize].has_bins()
        };
        let mut slots: Vec<u32> = (0..order.len() as u32).filter(has_bins).collect();
        let (mut branches, mut least) = (Vec::new(), LEAST);
        if !slots.is_empty() {
            Grown { input, least, planes }.grow(&mut slots, 0, &mut branches);
        }
        while branches.len() > most && least <= slots.len() {
            // With a reserve, as cuts are uneven.
            least = 1 + least * branches.len() * 9 / (8 * most.max(1));
            branches.clear();
            Grown { input, least, planes }.grow(&mut slots, 0, &mut branches);
        }
        let mut position = vec![None; order.len()];
        for (at, &slot) in (0..).zip(&slots) {
            position[slot as usize] = Some(at);
        }
        Self { input, branches, slots, position }
    }

    pub fn count(&self) -> usize {
        self.branches.len()
    }

    pub fn position(&self, slot: u32) -> Option<u32> {
        self.position[slot as usize]
    }

    /// Chooses volumes for a group of receivers: calls `take` with the number of each, its bounds, and the positions of its triangles,
    /// ascending.
    pub fn choose(&self, to: &Receivers, mut take: impl FnMut(u32, &BoundedRun, &Range<u32>)) {
        let mut left = if self.branches.is_empty() { Vec::new() } else { vec![0] };
        while let Some(at) = left.pop() {
            let branch = &self.branches[at];
            if branch.planes.len() < FEWEST || branch.moments.vector_area() > ONE_SIDED * branch.moments.area
            {
                continue;
            }
            if self.stands_for(to, branch) {
                take(at as u32, &branch.bounds, &branch.at);
            } else if let Some([a, b]) = branch.parts {
                left.extend([b, a]);
            }
        }
    }

    fn stands_for(&self, to: &Receivers, branch: &Branch) -> bool {
        let Branch { moments, bounds, .. } = branch;
        let receivers = &to.node.bounds;
        let centroid = moments.centroid();
        let nearest = centroid.clamp(receivers.min, receivers.max);
        let r2 = centroid.distance_squared(nearest);
        let angle2 = moments.spread() / r2;
        let near = are_near(to.node, bounds, branch.characteristic_area, self.input.half_range);
        // At a distance of zero the angle is no number, or infinite.
        let narrow = angle2 <= WIDEST * WIDEST;
        if near || !narrow {
            return false;
        }
        let direction = (centroid - to.centre).normalize_or_zero();
        let wide = (to.radius + moments.spread().sqrt()) / r2.sqrt();
        let received = (Hierarchy::steepest(to.node, direction) + wide).clamp(0.0, 1.0);
        // Half of Σ a |⟨n, ω⟩| is seen from either side, and more of what does not close.
        let across = (direction.dot(branch.orientations * direction) * moments.area).max(0.0).sqrt();
        let seen = 0.5 * (across + moments.vector_area());
        let backs = if branch.blocks { self.input.backs } else { 0.0 };
        let light = seen * (moments.brightness / moments.area).max(backs);
        let share = received * light / (PI * r2);
        let offset = moments.offset();
        share * (angle2 / self.input.bin + offset * offset / r2) <= CAREFUL * self.input.error
    }

    /// Keeps the volumes that lists refer to, and those that they consist of, with indices from `first` on: those of the numbers
    /// `used`. `None` where there are none; otherwise also the new index by number.
    pub fn keep(self, mut used: Vec<bool>, first: u32) -> Option<(Volumes, Vec<u32>)> {
        let count = self.branches.len();
        let mut heights = vec![0u32; count];
        // Each comes before its parts.
        for at in 0..count {
            if let Some([a, b]) = self.branches[at].parts.filter(|_| used[at]) {
                used[a] = true;
                used[b] = true;
            }
        }
        for at in (0..count).rev() {
            if let Some([a, b]) = self.branches[at].parts {
                heights[at] = 1 + heights[a].max(heights[b]);
            }
        }
        let mut kept: Vec<usize> = (0..count).filter(|&at| used[at]).collect();
        if kept.is_empty() {
            return None;
        }
        kept.sort_by_key(|&at| heights[at]);
        let mut index = vec![0; count];
        let (mut parts, mut runs) = (Vec::with_capacity(kept.len()), Vec::<Range<u32>>::new());
        for (&at, number) in kept.iter().zip(first..) {
            index[at] = number;
            let branch = &self.branches[at];
            parts.push(match branch.parts {
                Some(both) => VolumeParts::Volumes(both.map(|part| index[part])),
                None => VolumeParts::Triangles(branch.at.clone()),
            });
            let height = heights[at] as usize;
            while runs.len() <= height {
                runs.push(number..number);
            }
            runs[height].end = number + 1;
        }
        let class = Class { blocker: true, glossy: true };
        Some((Volumes { slots: self.slots, parts, run: ClusterRun { class, heights: runs } }, index))
    }
}

/// What branches grow from.
#[derive(Clone, Copy)]
struct Grown<'a> {
    input: &'a ClusterInput<'a>,
    /// Fewest triangles that are cut in two.
    least: usize,
    planes: &'a [u32],
}

impl Grown<'_> {
    fn facet(&self, slot: u32) -> &Facet {
        &self.input.facets[self.input.order[slot as usize] as usize]
    }

    /// Adds the branch of some slots, which begin at a position, with all that it consists of, and sorts them.
    fn grow(self, slots: &mut [u32], begin: usize, branches: &mut Vec<Branch>) {
        let at = branches.len();
        branches.push(self.branch(slots, begin));
        let cut = if slots.len() < self.least { None } else { self.cut(slots) };
        let Some(cut) = cut else {
            slots.sort_unstable();
            return;
        };
        let alone = slots.len() <= ALONE;
        let (one, other) = slots.split_at_mut(cut);
        let parts = if alone {
            let first = branches.len();
            self.grow(one, begin, branches);
            let second = branches.len();
            self.grow(other, begin + cut, branches);
            [first, second]
        } else {
            let of = |slots: &mut [u32], begin| {
                let mut own = Vec::new();
                self.grow(slots, begin, &mut own);
                own
            };
            let (one, other) = join(|| of(one, begin), || of(other, begin + cut));
            [one, other].map(|own| {
                let first = branches.len();
                let moved = |[a, b]: [usize; 2]| [first + a, first + b];
                branches.extend(own.into_iter().map(|b| Branch { parts: b.parts.map(moved), ..b }));
                first
            })
        };
        branches[at].parts = Some(parts);
    }

    fn branch(self, slots: &[u32], begin: usize) -> Branch {
        let ClusterInput { order, classes, brightness, .. } = *self.input;
        let facets = || slots.iter().map(|&slot| self.facet(slot));
        let mut planes = Vec::new();
        for &slot in slots {
            let of = self.planes[slot as usize];
            if planes.len() < FEWEST && !planes.contains(&of) {
                planes.push(of);
            }
        }
        let of = |&slot: &u32| Moments::of(self.facet(slot), brightness[order[slot as usize] as usize]);
        let outer =
            |f: &Facet| DMat3::from_cols(f.normal * f.normal.x, f.normal * f.normal.y, f.normal * f.normal.z);
        Branch {
            at: begin as u32..(begin + slots.len()) as u32,
            bounds: BoundedRun::around(facets()),
            characteristic_area: facets().map(|f| f.characteristic_area).fold(0.0, f64::max),
            moments: slots.iter().map(of).sum(),
            orientations: facets().map(|f| outer(f) * f.area).sum(),
            blocks: slots.iter().any(|&slot| classes[order[slot as usize] as usize].blocker),
            planes,
            parts: None,
        }
    }

    /// Cuts the space around the centroids in the middle, across its longest side. `None` where all are in one place.
    fn cut(self, slots: &mut [u32]) -> Option<usize> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &slot in slots.iter() {
            let centroid = self.facet(slot).centroid;
            (low, high) = (low.min(centroid), high.max(centroid));
        }
        let size = high - low;
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b]))?;
        if size[axis] <= 0.0 {
            return None;
        }
        let middle = low[axis].midpoint(high[axis]);
        let of = |slot: &u32| self.facet(*slot).centroid[axis];
        let below = slots.iter().filter(|slot| of(slot) < middle).count();
        let least = slots.len() / LEAST_SHARE;
        let cut = below.clamp(least, slots.len() - least);
        slots.select_nth_unstable_by(cut, |a, b| of(a).total_cmp(&of(b)).then(a.cmp(b)));
        Some(cut)
    }
}
