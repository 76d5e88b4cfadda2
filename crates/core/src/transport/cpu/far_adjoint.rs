//! Uᵀ to far receivers, point to point, and the walk over blocks of sources. Twin of
//! crates/core/glsl/transport_irradiance_adjoint.comp and transport_bins_adjoint.comp.

use super::far::{BLOCK, CLOSE_COST, N, SLOT, SMALL, flag};
use super::pairs::{Facet, Facets, Pairs};
use super::pieces::Pieces;
use super::real::Real;
use super::taps::{Layout, add, flush, scaled};
use crate::model::Class;
use crate::plan::{FarRuns, NearPairs, PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use crate::transport::shape::Shape;
use antirad_base::parallel;
use antirad_gpu::vectorised;
use std::ops::Range;

/// What the light of sources of one class matters to receivers, whose bins are in one page.
pub struct Importance<'a, T> {
    pub shape: Shape,
    pub of: Receivers<'a>,
    pub cotangents: Cotangents<'a, T>,
    /// The slot with which the bins of the receivers begin.
    pub receivers_page: u32,
    /// The index with which the cotangents of the sources' bins begin.
    pub bins_page: u32,
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
    /// Close triangles in a range of slots, piece by piece. Blocks count from the first slot.
    Close { near: &'a NearPairs, slots: Range<u32> },
}

/// 1 or 0 for the front and for the back of sources, by what may pass.
pub(super) fn sides<T: Real>(passing: u32, source: Class) -> [T; 2] {
    [flag(passing & PAIR_FRONT != 0), flag(source.blocker && passing & PAIR_BACK != 0)]
}

impl Receivers<'_> {
    /// Calls `with` with the slots of receivers, and what may pass.
    pub(super) fn visit(&self, block: u32, mut with: impl FnMut(Range<u32>, u32)) {
        match self {
            Self::Tiles { runs, tiles, tile } => {
                for (run, passing) in runs.of(block * BLOCK / tile, tiles) {
                    with(run.start * tile..run.end * tile, passing);
                }
            }
            Self::Close { .. } => {}
        }
    }

    /// Pairs of a block, including those of tiles between which nothing passes.
    pub fn pairs(&self, block: u32) -> u64 {
        match self {
            Self::Tiles { tiles, tile, .. } => u64::from(BLOCK * tile) * tiles.len() as u64,
            Self::Close { near, slots } => {
                (block * BLOCK..(block + 1) * BLOCK).map(|slot| near.of(slot, slots).len() as u64).sum()
            }
        }
    }
}

/// The cotangents of the radiance of the sources of a block.
pub(super) type Sums<T> = [[T; 4]; N];

impl<T: Real> Importance<'_, T> {
    /// Adds to the cotangents of the sources in some blocks what all receivers give them.
    pub fn add(&self, blocks: Range<u32>, to: Accumulated<T>) {
        let source = self.shape.source;
        let Accumulated { radiance, back, front } = to;
        let Cotangents { layout, bins, .. } = self.cotangents;
        let first = (blocks.start * BLOCK).saturating_sub(self.bins_page) as usize * bins;
        let parts = |has: bool, of| {
            if has {
                parts(of, first, N * bins, blocks.len())
            } else {
                blocks.clone().map(|_| &mut [][..]).collect()
            }
        };
        let (back, front): (Vec<_>, Vec<_>) = (parts(source.blocker, back), parts(source.glossy, front));
        let own: Vec<_> = blocks.clone().zip(back.into_iter().zip(front)).collect();
        let state = || {
            let count = |has| if has { N * layout.count } else { 0 };
            Scratch::new([source.blocker, source.glossy].map(count))
        };
        let summed =
            |scratch: &mut Scratch<T>, (block, (back, front)): (u32, (&mut [T], &mut [T]))| match &self.of {
                Receivers::Close { near, slots } => {
                    self.close_block((near, slots), block, scratch, [back, front])
                }
                Receivers::Tiles { .. } => self.block(block, scratch, [back, front]),
            };
        let close = matches!(self.of, Receivers::Close { .. });
        let small = if close { SMALL / CLOSE_COST } else { SMALL };
        let small = blocks.clone().map(|block| self.of.pairs(block)).sum::<u64>() <= small;
        let sums: Vec<Sums<T>> = if small {
            let mut scratch = state();
            own.into_iter().map(|own| summed(&mut scratch, own)).collect()
        } else {
            parallel::map_init(own, state, summed)
        };
        let slots = radiance[(blocks.start * BLOCK) as usize * SLOT..].chunks_exact_mut(SLOT);
        for (to, sum) in slots.zip(sums.as_flattened()) {
            to.iter_mut().zip(&sum[..3]).for_each(|(to, &sum)| *to += sum);
        }
    }

    /// Adds to the bins of the sources of a block, behind the backs and in front, and returns the sums of each: by receivers, one after the other,
    /// to all sources, which share these.
    fn block(&self, block: u32, scratch: &mut Scratch<T>, [back, front]: [&mut [T]; 2]) -> Sums<T> {
        let cotangents = &self.cotangents;
        let sources = Facets::<T, N>::new(|k| Facet::read(cotangents.facets, block * BLOCK + k as u32));
        let layout = &cotangents.layout;
        let source = self.shape.source;
        let Scratch { pairs, backs: back_bins, fronts: front_bins, .. } = scratch;
        let mut sums = [[T::ZERO; 4]; N];
        // The same, by channel and source.
        let mut planes = [[T::ZERO; N]; 3];
        let mut any = false;
        self.of.visit(block, |slots, passing| {
            let sides = sides(passing, source);
            if sides == [T::ZERO; 2] {
                return;
            }
            let near = passing & PAIR_NEAR != 0;
            for slot in slots {
                let receiver = Facet::read(cotangents.facets, slot);
                if receiver.area <= T::ZERO {
                    continue;
                }
                vectorised(
                    #[inline(always)]
                    || {
                        pairs.weigh(|k| sources.get(k), |_| receiver, |_| sides);
                        if near {
                            let areas = |k| sources.get(k).characteristic_area + receiver.characteristic_area;
                            pairs.blend(cotangents.half_range, areas);
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
                                    add(&mut sums[k], T::ONE, value);
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
            sums = std::array::from_fn(|k| [planes[0][k], planes[1][k], planes[2][k], T::ZERO]);
        }
        sums
    }
}

/// So many consecutive parts of this size of an array, from `first` on.
fn parts<T>(of: &mut [T], first: usize, size: usize, count: usize) -> Vec<&mut [T]> {
    of[first..].chunks_exact_mut(size).take(count).collect()
}

/// What a thread reuses: pairs, and the sums of the bins of a block.
pub(super) struct Scratch<T> {
    pairs: Pairs<T, N>,
    pub pieces: Pieces<T>,
    pub backs: Vec<[T; 4]>,
    pub fronts: Vec<[T; 4]>,
}

impl<T: Real> Scratch<T> {
    fn new([backs, fronts]: [usize; 2]) -> Self {
        let zero = |count| vec![[T::ZERO; 4]; count];
        Self { pairs: Pairs::NONE, pieces: Pieces::NONE, backs: zero(backs), fronts: zero(fronts) }
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
