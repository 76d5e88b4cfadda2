//! U from far sources, point to point, and the walk over blocks of receivers. Twin of crates/core/glsl/transport_irradiance.comp,
//! transport_bins.comp.

use super::pairs::{Facet, Facets, Pairs};
use super::pieces::Pieces;
use super::real::Real;
use super::taps::{Layout, add, flush};
use crate::model::Class;
use crate::plan::{FarRuns, NearPairs, PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use crate::transport::shape::Shape;
use antirad_base::parallel;
use antirad_gpu::vectorised;
use std::ops::Range;

/// Neighbouring receivers that a thread takes at a time.
pub const BLOCK: u32 = 32;
pub(super) const N: usize = BLOCK as usize;
/// Numbers of an RGB value of a slot.
pub(super) const SLOT: usize = 4;
/// So many pairs take less time than to wake other threads.
pub(super) const SMALL: u64 = 1 << 13;
/// Time of a close pair in that of others.
pub(super) const CLOSE_COST: u64 = 64;

/// What receivers receive from sources of one class, whose bins are in one page.
pub struct Received<'a, T> {
    pub shape: Shape,
    pub from: Sources<'a>,
    /// Bits of pairs to consider.
    pub passing: u32,
    pub light: Light<'a, T>,
    /// The index with which the bins of the sources begin.
    pub sources_page: u32,
    /// The slot with which those of the receivers begin.
    pub receivers_page: u32,
}

/// The sources of blocks of receivers.
#[derive(Clone)]
pub enum Sources<'a> {
    /// Triangles in a range of tiles.
    Tiles { runs: &'a FarRuns, tiles: Range<u32>, tile: u32 },
    /// Close triangles in a range of slots, piece by piece.
    Close { near: &'a NearPairs, slots: Range<u32> },
}

impl Sources<'_> {
    /// Calls `with` with the index of each source of a block, and what may pass.
    pub(super) fn visit(&self, block: u32, mut with: impl FnMut(u32, u32)) {
        match self {
            Self::Tiles { runs, tiles, tile } => {
                for (run, bits) in runs.of(block * BLOCK / tile, tiles) {
                    (run.start * tile..run.end * tile).for_each(|slot| with(slot, bits));
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

impl<T: Real> Received<'_, T> {
    /// Adds what some blocks receive: to the irradiance of all slots, and to the bins of this page.
    pub fn add(&self, blocks: Range<u32>, irradiance: &mut [T], incident: &mut [T]) {
        let Light { layout, bins, .. } = self.light;
        let first = (blocks.start * BLOCK).saturating_sub(self.receivers_page) as usize * bins;
        let own: Vec<(u32, &mut [T])> = match self.shape.receiver_bins {
            true => blocks.clone().zip(incident[first..].chunks_mut(N * bins)).collect(),
            false => blocks.clone().map(|block| (block, &mut [][..])).collect(),
        };
        let state = || Scratch::new(if self.shape.receiver_bins { N * layout.count } else { 0 });
        let received = |scratch: &mut Scratch<T>, (block, incident): (u32, &mut [T])| match &self.from {
            Sources::Close { near, slots } => self.close_block((near, slots), block, scratch, incident),
            Sources::Tiles { .. } => self.block(block, scratch, incident),
        };
        let close = matches!(self.from, Sources::Close { .. });
        let small = if close { SMALL / CLOSE_COST } else { SMALL };
        let small = blocks.clone().map(|block| self.from.pairs(block)).sum::<u64>() <= small;
        let sums: Vec<[[T; 4]; N]> = if small {
            let mut scratch = state();
            own.into_iter().map(|own| received(&mut scratch, own)).collect()
        } else {
            parallel::map_init(own, state, received)
        };
        let slots = irradiance[(blocks.start * BLOCK) as usize * SLOT..].chunks_exact_mut(SLOT);
        for (to, sum) in slots.zip(sums.as_flattened()) {
            to.iter_mut().zip(&sum[..3]).for_each(|(to, &sum)| *to += sum);
        }
    }

    /// Adds to the bins of the receivers of a block, and returns the sums of all directions.
    fn block(&self, block: u32, scratch: &mut Scratch<T>, incident: &mut [T]) -> [[T; 4]; N] {
        let light = &self.light;
        let (receivers, exists) = self.receivers(block);
        let layout = &light.layout;
        let Scratch { pairs, bins, .. } = scratch;
        let mut sums = [[T::ZERO; 4]; N];
        let mut planes = [[T::ZERO; N]; 3];
        let mut any = false;
        self.from.visit(block, |index, bits| {
            let bits = bits & self.passing;
            let fronts = bits & PAIR_FRONT != 0;
            let backs = self.shape.source.blocker && bits & PAIR_BACK != 0;
            if !fronts && !backs {
                return;
            }
            vectorised(
                #[inline(always)]
                || {
                    if self.pass((index, bits), &receivers, &exists, pairs) == [false; 2] {
                        return;
                    }
                    any = true;
                    let radiance = light.radiance(index);
                    if !self.shape.any_bins() {
                        for (sums, radiance) in planes.iter_mut().zip(radiance) {
                            for k in 0..N {
                                sums[k] += pairs.weight[k] * radiance;
                            }
                        }
                        return;
                    }
                    let glossy = self.shape.source.glossy;
                    let (front, back) =
                        light.bins_of(index - self.sources_page, Class { blocker: backs, glossy });
                    for k in 0..N {
                        if pairs.weight[k] > T::ZERO {
                            let value = towards(k, pairs, layout, radiance, (front, back));
                            if self.shape.receiver_bins {
                                let own = &mut bins[k * layout.count..][..layout.count];
                                pairs.at_receiver.scatter(k, layout, own, value);
                            }
                            add(&mut sums[k], T::ONE, value);
                        }
                    }
                },
            );
        });
        if any && self.shape.receiver_bins {
            self.flush(bins, incident);
        }
        if !self.shape.any_bins() {
            sums = std::array::from_fn(|k| [planes[0][k], planes[1][k], planes[2][k], T::ZERO]);
        }
        sums
    }

    /// Sets what passes from a source to the receivers of a block, and the bins at both ends; whether fronts send anything, and backs.
    /// `bits`: what may pass.
    #[inline(always)]
    fn pass(
        &self,
        (index, bits): (u32, u32),
        receivers: &Facets<T, N>,
        exists: &[T; N],
        pairs: &mut Pairs<T, N>,
    ) -> [bool; 2] {
        let light = &self.light;
        let source = Facet::read(light.facets, index);
        let backs = self.shape.source.blocker && bits & PAIR_BACK != 0;
        let sides = [flag::<T>(bits & PAIR_FRONT != 0), flag(backs)];
        let sides = |k: usize| [sides[0] * exists[k], sides[1] * exists[k]];
        pairs.weigh(|_| source, |k| receivers.get(k), sides);
        if bits & PAIR_NEAR != 0 {
            let areas = |k| source.characteristic_area + receivers.get(k).characteristic_area;
            pairs.blend(light.half_range, areas);
        }
        let passing = pairs.passing();
        if passing[0] && self.shape.source.glossy || passing[1] {
            pairs.aim_from(&light.layout, |_| source);
        }
        if passing != [false; 2] && self.shape.receiver_bins {
            pairs.aim_at(&light.layout, |k| receivers.get(k));
        }
        passing
    }

    /// The receivers of a block, and 1 for those that exist: padding is within the horizon of everything.
    fn receivers(&self, block: u32) -> (Facets<T, N>, [T; N]) {
        let receivers = Facets::<T, N>::new(|k| Facet::read(self.light.facets, block * BLOCK + k as u32));
        let exists = std::array::from_fn(|k| flag(receivers.get(k).area > T::ZERO));
        (receivers, exists)
    }

    /// Adds the bins of a block to those in memory, and clears them.
    fn flush(&self, bins: &mut [[T; 4]], incident: &mut [T]) {
        let Light { layout, bin_table, .. } = &self.light;
        let own = bins.chunks_exact_mut(layout.count).zip(incident.chunks_exact_mut(self.light.bins));
        own.for_each(|(bins, to)| flush(layout, bins, |bin| T::ONE / bin_table[SLOT * bin + 3], to));
    }
}

/// What a thread reuses: pairs, and the sums of the bins of a block.
pub(super) struct Scratch<T> {
    pairs: Pairs<T, N>,
    pub pieces: Pieces<T>,
    pub bins: Vec<[T; 4]>,
}

impl<T: Real> Scratch<T> {
    fn new(bins: usize) -> Self {
        Self { pairs: Pairs::NONE, pieces: Pieces::NONE, bins: vec![[T::ZERO; 4]; bins] }
    }
}

#[inline(always)]
pub(super) fn flag<T: Real>(is: bool) -> T {
    if is { T::ONE } else { T::ZERO }
}

/// What sources send, in memory.
#[derive(Clone, Copy)]
pub struct Light<'a, T> {
    pub layout: Layout<T>,
    /// Half of `near_field`.
    pub half_range: T,
    pub facets: &'a [T],
    pub corners: &'a [T],
    pub radiance: &'a [T],
    pub antiradiance: &'a [T],
    pub specular: &'a [T],
    pub bin_table: &'a [T],
    /// Numbers of the bins of a triangle.
    pub bins: usize,
}

impl<T: Real> Light<'_, T> {
    /// Diffuse radiance.
    pub fn radiance(&self, at: u32) -> [T; 4] {
        let value = &self.radiance[at as usize * SLOT..][..SLOT];
        [value[0], value[1], value[2], T::ZERO]
    }

    /// Bins of a source by its place in its page, in front and behind; empty without.
    pub fn bins_of(&self, at: u32, class: Class) -> (&[T], &[T]) {
        let own = |has: bool| {
            let first = at as usize * self.bins;
            if has { first..first + self.bins } else { 0..0 }
        };
        (&self.specular[own(class.glossy)], &self.antiradiance[own(class.blocker)])
    }
}

/// The irradiance of one receiver, from the diffuse radiance of a source and its bins in front and behind.
#[inline(always)]
fn towards<T: Real>(
    k: usize,
    pairs: &Pairs<T, N>,
    layout: &Layout<T>,
    radiance: [T; 4],
    (front, back): (&[T], &[T]),
) -> [T; 4] {
    let weight = pairs.weight[k];
    let mut value = [T::ZERO; 4];
    if pairs.front[k] > T::ZERO {
        add(&mut value, weight, radiance);
        if !front.is_empty() {
            add(&mut value, weight, pairs.at_source.gather(k, layout, front));
        }
    } else {
        add(&mut value, -weight, pairs.at_source.gather(k, layout, back));
    }
    value
}
