//! Uᵀ to far receivers, point to point, and the walk over blocks of sources. Twin of
//! crates/core/glsl/transport_irradiance_adjoint.comp, transport_bins_adjoint.comp and cluster_adjoint.comp.

use super::far::{CLOSE_COST, SLOT, SMALL, flag};
use super::kept_pairs::{KeptPair, KeptPairs};
use super::pairs::{CLUSTERS, Facet, Facets, Pairs, TRIANGLES};
use super::pieces::Pieces;
use super::real::Real;
use super::taps::{Layout, add, flush, scaled};
use crate::model::{Class, ENTRY_BITS, LIST, ReceiverLists, SOURCES};
use crate::plan::{FarRuns, NearPairs, PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use crate::transport::shape::Shape;
use antirad_base::parallel;
use antirad_gpu::vectorised;
use std::ops::Range;

/// Neighbouring sources of a tile that a thread takes at a time.
pub const BLOCK: u32 = LIST;
/// Receivers of a list.
const M: usize = LIST as usize;

/// What the light of sources of one class matters to receivers, whose bins are in one page.
pub struct Importance<'a, T> {
    pub shape: Shape,
    pub of: Receivers<'a>,
    pub cotangents: Cotangents<'a, T>,
    /// The slot with which the bins of the receivers begin.
    pub receivers_page: u32,
    /// The index with which the cotangent of the sources' radiance begins.
    pub radiance_page: u32,
    /// The index with which the cotangents of the sources' bins begin.
    pub bins_page: u32,
    /// What passes to the receivers, by block of [`LIST`] from that slot on, where it is kept.
    pub kept: Option<&'a [KeptPairs<T>]>,
}

/// The arrays in which a pass accumulates the cotangents of the light of sources: of radiance, and of bins
/// behind the back and in front.
pub struct Accumulated<'a, T> {
    pub radiance: &'a mut [T],
    pub back: &'a mut [T],
    pub front: &'a mut [T],
}

/// The receivers of blocks of sources.
#[derive(Clone)]
pub enum Receivers<'a> {
    /// Triangles in a range of tiles. Blocks count from the first slot.
    Tiles { runs: &'a FarRuns, tiles: Range<u32>, tile: u32 },
    /// Receivers in a range of lists; blocks are the groups of `sources`. `clusters`: where the sources are
    /// clusters, the index of the first of all and that of its first moment, both from the begin of the
    /// radiance.
    Listed { lists: &'a ReceiverLists, range: Range<u32>, sources: Range<u32>, clusters: Option<[u32; 2]> },
    /// Close triangles in a range of slots, piece by piece. Blocks count from the first slot.
    Close { near: &'a NearPairs, slots: Range<u32> },
}

/// What may pass to receivers from each source of a block.
#[derive(Clone, Copy)]
pub(super) struct Passing {
    word: u32,
    /// Bits from one source to the next.
    step: u32,
}

impl Passing {
    pub fn has<T: Real>(self, k: usize, bit: u32) -> T {
        flag(self.word >> (self.step * k as u32) & bit != 0)
    }

    /// 1 or 0 for the fronts and for the backs of the first `count` of N sources.
    pub fn sides<T: Real, const N: usize>(self, count: usize, source: Class) -> [[T; 2]; N] {
        std::array::from_fn(|k| {
            let exists = |is: bool| flag::<T>(is && k < count);
            [
                exists(true) * self.has::<T>(k, PAIR_FRONT),
                exists(source.blocker) * self.has::<T>(k, PAIR_BACK),
            ]
        })
    }
}

impl Receivers<'_> {
    /// Calls `with` with the slots of receivers, and what may pass.
    pub(super) fn visit(&self, block: u32, mut with: impl FnMut(Range<u32>, Passing)) {
        match self {
            Self::Tiles { runs, tiles, tile } => {
                for (run, word) in runs.of(block * BLOCK / tile, tiles) {
                    with(run.start * tile..run.end * tile, Passing { word, step: 0 });
                }
            }
            Self::Listed { lists, range, .. } => {
                for &[list, word] in lists.of(block, range) {
                    with(list * LIST..(list + 1) * LIST, Passing { word, step: ENTRY_BITS });
                }
            }
            Self::Close { .. } => {}
        }
    }

    /// Pairs of a block, including those of tiles between which nothing passes.
    pub fn pairs(&self, block: u32) -> u64 {
        match self {
            Self::Tiles { tiles, tile, .. } => u64::from(BLOCK * tile) * tiles.len() as u64,
            Self::Listed { lists, range, .. } => {
                u64::from(SOURCES * LIST) * u64::from(lists.count(block, range))
            }
            Self::Close { near, slots } => {
                (block * BLOCK..(block + 1) * BLOCK).map(|slot| near.of(slot, slots).len() as u64).sum()
            }
        }
    }

    /// The sources of a block.
    pub(super) fn sources(&self, block: u32) -> Range<u32> {
        match self {
            Self::Tiles { .. } | Self::Close { .. } => block * BLOCK..(block + 1) * BLOCK,
            Self::Listed { lists, sources, .. } => {
                let first = sources.start + (block - lists.groups(sources).start) * SOURCES;
                first..(first + SOURCES).min(sources.end)
            }
        }
    }

    pub(super) fn clusters(&self) -> Option<[u32; 2]> {
        match self {
            Self::Tiles { .. } | Self::Close { .. } => None,
            Self::Listed { clusters, .. } => *clusters,
        }
    }
}

/// The sums of a source: the cotangent of radiance, and that of its first moment.
pub(super) type Sums<T> = [[T; 4]; 4];

impl<T: Real> Importance<'_, T> {
    /// Adds to the cotangents of the sources in some blocks what all receivers give them.
    pub fn add(&self, blocks: Range<u32>, to: Accumulated<T>) {
        match self.of {
            Receivers::Tiles { .. } | Receivers::Close { .. } => {
                self.add_blocks::<{ BLOCK as usize }>(blocks, to);
            }
            Receivers::Listed { .. } => self.add_blocks::<{ SOURCES as usize }>(blocks, to),
        }
    }

    /// Adds to the cotangents of the sources in some blocks of N what their receivers give them.
    fn add_blocks<const N: usize>(&self, blocks: Range<u32>, to: Accumulated<T>) {
        let source = self.shape.source;
        let Accumulated { radiance, back, front } = to;
        let Cotangents { layout, bins, .. } = self.cotangents;
        let first = self.of.sources(blocks.start).start.saturating_sub(self.bins_page) as usize * bins;
        let ends: Vec<usize> = blocks.clone().map(|block| self.of.sources(block).len() * bins).collect();
        let parts = |has: bool, of| {
            if has { parts(of, first, &ends) } else { ends.iter().map(|_| &mut [][..]).collect() }
        };
        let (back, front): (Vec<_>, Vec<_>) = (parts(source.blocker, back), parts(source.glossy, front));
        let own: Vec<_> = blocks.clone().zip(back.into_iter().zip(front)).collect();
        let state = || {
            let count = |has| if has { N * layout.count } else { 0 };
            Scratch::<T, N>::new([source.blocker, source.glossy].map(count))
        };
        let summed = |scratch: &mut Scratch<T, N>, (block, (back, front)): (u32, (&mut [T], &mut [T]))| match (
            &self.of, self.kept,
        ) {
            (Receivers::Close { near, slots }, _) => {
                self.close_block((near, slots), block, scratch, [back, front])
            }
            (_, Some(kept)) => self.kept_block(kept, block, scratch, [back, front]),
            (Receivers::Tiles { .. }, _) => self.block(block, scratch, [back, front]),
            (Receivers::Listed { .. }, _) => self.listed_block(block, scratch, [back, front]),
        };
        let close = matches!(self.of, Receivers::Close { .. });
        let small = if close { SMALL / CLOSE_COST } else { SMALL };
        let small = blocks.clone().map(|block| self.of.pairs(block)).sum::<u64>() <= small;
        let sums: Vec<[Sums<T>; N]> = if small {
            let mut scratch = state();
            own.into_iter().map(|own| summed(&mut scratch, own)).collect()
        } else {
            parallel::map_init(own, state, summed)
        };
        for (block, sums) in blocks.zip(sums) {
            for (source, sums) in self.of.sources(block).zip(sums) {
                let mut add = |row: u32, sum: [T; 4]| {
                    let to = &mut radiance[row as usize * SLOT..][..3];
                    to.iter_mut().zip(sum).for_each(|(to, sum)| *to += sum);
                };
                add(source - self.radiance_page, sums[0]);
                if let Some([first, moments]) = self.of.clusters() {
                    (0..3).for_each(|row| add(moments + 3 * (source - first) + row, sums[row as usize + 1]));
                }
            }
        }
    }

    /// Adds to the bins of the sources of a block, behind the backs and in front, and returns the sums of each: by receivers, one after the other,
    /// to all sources, which share these.
    fn block<const N: usize>(
        &self,
        block: u32,
        scratch: &mut Scratch<T, N>,
        [back, front]: [&mut [T]; 2],
    ) -> [Sums<T>; N] {
        let (own, cotangents) = (self.of.sources(block), &self.cotangents);
        let sources =
            Facets::<T, N>::new(|k| Facet::read(cotangents.facets, (own.start + k as u32).min(own.end - 1)));
        let layout = &cotangents.layout;
        let source = self.shape.source;
        let Scratch { pairs, backs: back_bins, fronts: front_bins, .. } = scratch;
        let mut sums = [[[T::ZERO; 4]; 4]; N];
        // The same, by channel and source.
        let mut planes = [[T::ZERO; N]; 3];
        let mut any = false;
        self.of.visit(block, |slots, passing| {
            let sides: [[T; 2]; N] = passing.sides(own.len(), source);
            let near: [T; N] = std::array::from_fn(|k| passing.has(k, PAIR_NEAR));
            if sides.as_flattened().iter().all(|side| *side == T::ZERO) {
                return;
            }
            let any_near = near.iter().any(|near| *near > T::ZERO);
            for slot in slots {
                let receiver = Facet::read(cotangents.facets, slot);
                if receiver.area <= T::ZERO {
                    continue;
                }
                vectorised(
                    #[inline(always)]
                    || {
                        pairs.weigh::<TRIANGLES>(|k| sources.get(k), |_| receiver, |k| sides[k]);
                        if any_near {
                            let areas = |k| sources.get(k).characteristic_area + receiver.characteristic_area;
                            pairs.blend(cotangents.half_range, areas, |k| near[k]);
                        }
                        let passing = pairs.passing();
                        if passing == [false; 2] {
                            return;
                        }
                        any = true;
                        let irradiance = cotangents.of_irradiance(slot);
                        if !self.shape.any_bins() {
                            for (sums, importance) in planes.iter_mut().zip(irradiance) {
                                for k in 0..N {
                                    sums[k] += pairs.weight[k] * importance;
                                }
                            }
                            return;
                        }
                        if passing[0] && source.glossy || passing[1] {
                            pairs.aim_from(layout, |k| sources.get(k));
                        }
                        if self.shape.receiver_bins {
                            pairs.aim_at(layout, |_| receiver);
                        }
                        let incident =
                            cotangents.of_bins(slot - self.receivers_page, self.shape.receiver_bins);
                        for k in 0..N {
                            let weight = pairs.weight[k];
                            if weight > T::ZERO {
                                let mut importance = irradiance;
                                if !incident.is_empty() {
                                    add(
                                        &mut importance,
                                        T::ONE,
                                        pairs.at_receiver.gather(k, layout, incident),
                                    );
                                }
                                let bins = k * layout.count..(k + 1) * layout.count;
                                if pairs.front[k] > T::ZERO {
                                    let value = scaled(weight, importance);
                                    if source.glossy {
                                        pairs.at_source.scatter(k, layout, &mut front_bins[bins], value);
                                    }
                                    add(&mut sums[k][0], T::ONE, value);
                                } else {
                                    let value = scaled(-weight, importance);
                                    pairs.at_source.scatter(k, layout, &mut back_bins[bins], value);
                                }
                            }
                        }
                    },
                );
            }
        });
        if any {
            cotangents.flush([back_bins, front_bins], [back, front]);
        }
        if !self.shape.any_bins() {
            for (k, sums) in sums.iter_mut().enumerate() {
                sums[0] = [planes[0][k], planes[1][k], planes[2][k], T::ZERO];
            }
        }
        sums
    }

    /// [`block`](Self::block), from what is kept.
    fn kept_block<const N: usize>(
        &self,
        kept: &[KeptPairs<T>],
        block: u32,
        scratch: &mut Scratch<T, N>,
        [back, front]: [&mut [T]; 2],
    ) -> [Sums<T>; N] {
        let (own, cotangents) = (self.of.sources(block), &self.cotangents);
        let layout = &cotangents.layout;
        let Scratch { backs: back_bins, fronts: front_bins, .. } = scratch;
        let mut sums = [[[T::ZERO; 4]; 4]; N];
        for (first, kept) in (self.receivers_page..).step_by(M).zip(kept) {
            for (source, pairs) in kept.of(&own, self.shape.source.glossy) {
                let k = (source - own.start) as usize;
                let bins = k * layout.count..(k + 1) * layout.count;
                for KeptPair { receiver, weight, at_receiver, at_source } in pairs {
                    let slot = first + receiver as u32;
                    let mut importance = cotangents.of_irradiance(slot);
                    if let Some(tap) = at_receiver {
                        let incident = cotangents.of_bins(slot - self.receivers_page, true);
                        add(&mut importance, T::ONE, tap.gather(layout, incident));
                    }
                    let value = scaled(weight, importance);
                    if weight > T::ZERO {
                        add(&mut sums[k][0], T::ONE, value);
                    }
                    if let Some(tap) = at_source {
                        let of = if weight > T::ZERO { &mut *front_bins } else { &mut *back_bins };
                        tap.scatter(layout, &mut of[bins.clone()], value);
                    }
                }
            }
        }
        cotangents.flush([back_bins, front_bins], [back, front]);
        sums
    }

    /// Sums of the N sources of a block from the receivers of one list at a time, source by source: many
    /// lists have few of the sources of a block.
    fn listed_block<const N: usize>(
        &self,
        block: u32,
        scratch: &mut Scratch<T, N>,
        [back, front]: [&mut [T]; 2],
    ) -> [Sums<T>; N] {
        let (own, cotangents) = (self.of.sources(block), &self.cotangents);
        let layout = &cotangents.layout;
        let clusters = self.of.clusters().is_some();
        let Class { glossy, .. } = self.shape.source;
        let Scratch { pairs_of_list: pairs, backs: back_bins, fronts: front_bins, .. } = scratch;
        let mut sums = [[[T::ZERO; 4]; 4]; N];
        // The same, by source, row, channel and receiver.
        let mut planes = [[[[T::ZERO; M]; 3]; 4]; N];
        let mut any = false;
        self.of.visit(block, |slots, passing| {
            let sides: [[T; 2]; N] = passing.sides(own.len(), self.shape.source);
            let receivers = Facets::<T, M>::new(|m| Facet::read(cotangents.facets, slots.start + m as u32));
            let exists: [T; M] = std::array::from_fn(|m| flag(receivers.get(m).area > T::ZERO));
            let irradiance: [[T; 4]; M] =
                std::array::from_fn(|m| cotangents.of_irradiance(slots.start + m as u32));
            for (k, [fronts, backs]) in sides.into_iter().enumerate() {
                if fronts + backs == T::ZERO {
                    continue;
                }
                let source = Facet::read(cotangents.facets, own.start + k as u32);
                let sides = |m: usize| [fronts * exists[m], backs * exists[m]];
                vectorised(
                    #[inline(always)]
                    || {
                        match clusters {
                            true => pairs.weigh::<CLUSTERS>(|_| source, |m| receivers.get(m), sides),
                            false => pairs.weigh::<TRIANGLES>(|_| source, |m| receivers.get(m), sides),
                        }
                        if passing.has::<T>(k, PAIR_NEAR) > T::ZERO {
                            let areas = |m| source.characteristic_area + receivers.get(m).characteristic_area;
                            pairs.blend(cotangents.half_range, areas, |_| T::ONE);
                        }
                        let passing = pairs.passing();
                        if passing == [false; 2] {
                            return;
                        }
                        any = true;
                        if !self.shape.any_bins() {
                            return add_diffuse(pairs, &irradiance, clusters, &mut planes[k]);
                        }
                        if passing[0] && glossy || passing[1] {
                            pairs.aim_from(layout, |_| source);
                        }
                        if self.shape.receiver_bins {
                            pairs.aim_at(layout, |m| receivers.get(m));
                        }
                        let bins = k * layout.count..(k + 1) * layout.count;
                        for m in 0..M {
                            let weight = pairs.weight[m];
                            if weight > T::ZERO {
                                let mut importance = irradiance[m];
                                if self.shape.receiver_bins {
                                    let at = slots.start + m as u32 - self.receivers_page;
                                    let incident = cotangents.of_bins(at, true);
                                    add(
                                        &mut importance,
                                        T::ONE,
                                        pairs.at_receiver.gather(m, layout, incident),
                                    );
                                }
                                if pairs.front[m] > T::ZERO {
                                    let value = scaled(weight, importance);
                                    if glossy {
                                        let own = &mut front_bins[bins.clone()];
                                        pairs.at_source.scatter(m, layout, own, value);
                                    }
                                    add(&mut sums[k][0], T::ONE, value);
                                    if clusters {
                                        let rows = sums[k][1..].iter_mut().zip(&pairs.slope);
                                        rows.for_each(|(row, slope)| add(row, slope[m], importance));
                                    }
                                } else {
                                    let value = scaled(-weight, importance);
                                    let own = &mut back_bins[bins.clone()];
                                    pairs.at_source.scatter(m, layout, own, value);
                                }
                            }
                        }
                    },
                );
            }
        });
        if any {
            cotangents.flush([back_bins, front_bins], [back, front]);
        }
        if !self.shape.any_bins() {
            let sum = |values: &[T; M]| values.iter().fold(T::ZERO, |sum, &value| sum + value);
            for (sums, planes) in sums.iter_mut().zip(&planes) {
                for (sums, [red, green, blue]) in sums.iter_mut().zip(planes) {
                    *sums = [sum(red), sum(green), sum(blue), T::ZERO];
                }
            }
        }
        sums
    }
}

/// Adds what the front of a source sends to the receivers of a list, by row, channel and receiver.
#[inline(always)]
fn add_diffuse<T: Real>(
    pairs: &Pairs<T, M>,
    irradiance: &[[T; 4]; M],
    clusters: bool,
    sums: &mut [[[T; M]; 3]; 4],
) {
    let [radiance, moments @ ..] = sums;
    let add = |sums: &mut [[T; M]; 3], weights: &[T; M]| {
        for (c, sums) in sums.iter_mut().enumerate() {
            for m in 0..M {
                sums[m] += weights[m] * irradiance[m][c];
            }
        }
    };
    add(radiance, &pairs.weight);
    if clusters {
        moments.iter_mut().zip(&pairs.slope).for_each(|(row, slope)| add(row, slope));
    }
}

/// Splits the numbers of an array from `first` on into consecutive ranges of these sizes.
fn parts<'a, T>(of: &'a mut [T], first: usize, sizes: &[usize]) -> Vec<&'a mut [T]> {
    let mut rest = &mut of[first..];
    let mut parts = Vec::with_capacity(sizes.len());
    for &size in sizes {
        let (part, after) = rest.split_at_mut(size);
        parts.push(part);
        rest = after;
    }
    parts
}

/// What a thread reuses: pairs, and the sums of the bins of a block.
pub(super) struct Scratch<T, const N: usize> {
    pairs: Pairs<T, N>,
    pairs_of_list: Pairs<T, M>,
    pub pieces: Pieces<T>,
    pub backs: Vec<[T; 4]>,
    pub fronts: Vec<[T; 4]>,
}

impl<T: Real, const N: usize> Scratch<T, N> {
    fn new([backs, fronts]: [usize; 2]) -> Self {
        let zero = |count| vec![[T::ZERO; 4]; count];
        Self {
            pairs: Pairs::NONE,
            pairs_of_list: Pairs::NONE,
            pieces: Pieces::NONE,
            backs: zero(backs),
            fronts: zero(fronts),
        }
    }
}

/// Cotangents of what receivers receive, in memory.
#[derive(Clone, Copy)]
pub struct Cotangents<'a, T> {
    pub layout: Layout<T>,
    /// Half of `near_field`.
    pub half_range: T,
    pub facets: &'a [T],
    pub corners: &'a [T],
    pub irradiance: &'a [T],
    pub incident: &'a [T],
    pub bin_table: &'a [T],
    /// Numbers of the bins of a triangle.
    pub bins: usize,
}

impl<T: Real> Cotangents<'_, T> {
    pub fn of_irradiance(&self, slot: u32) -> [T; 4] {
        let value = &self.irradiance[slot as usize * SLOT..][..SLOT];
        [value[0], value[1], value[2], T::ZERO]
    }

    /// Cotangents of the bins of the receiver at place `at` of its page; empty if it has none.
    pub fn of_bins(&self, at: u32, has: bool) -> &[T] {
        let first = at as usize * self.bins;
        &self.incident[if has { first..first + self.bins } else { 0..0 }]
    }

    /// Adds sums by bin to those in memory, of backs and of fronts, by source, and sets them to zero.
    fn flush(&self, bins: [&mut [[T; 4]]; 2], to: [&mut [T]; 2]) {
        let count = self.layout.count;
        let [backs, fronts] = bins.map(|bins| bins.chunks_exact_mut(count));
        let [back, front] = to.map(|to| to.chunks_exact_mut(self.bins));
        backs.zip(back).for_each(|(bins, to)| self.flush_back(bins, to));
        fronts.zip(front).for_each(|(bins, to)| self.flush_front(bins, to));
    }

    /// Jᵀ is the identity on a state of A(b) = H(b) / c_b, of which this is the cotangent of H(b).
    pub fn flush_back(&self, bins: &mut [[T; 4]], to: &mut [T]) {
        flush(&self.layout, bins, |bin| T::ONE / self.bin_table[SLOT * bin + 3], to);
    }

    pub fn flush_front(&self, bins: &mut [[T; 4]], to: &mut [T]) {
        flush(&self.layout, bins, |_| T::ONE, to);
    }
}
