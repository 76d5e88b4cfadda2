//! U between close triangles. Twin of crates/core/glsl/near.comp.

use super::far::{N, Received, SLOT, Scratch};
use super::pairs::Facet;
use super::pieces::{ClosePair, Pieces, Triangle};
use super::real::Real;
use super::taps::{Layout, add, flush};
use crate::model::Class;
use crate::plan::{NearPairs, PAIR_BACK};
use std::ops::Range;

impl<T: Real> Triangle<T> {
    /// The triangle of a slot: its facet and its corners.
    pub fn read(facets: &[T], corners: &[T], slot: u32) -> Self {
        let own = &corners[slot as usize * 3 * SLOT..][..3 * SLOT];
        let corner = |k: usize| [own[SLOT * k], own[SLOT * k + 1], own[SLOT * k + 2]];
        let corners = [corner(0), corner(1), corner(2)];
        Self { facet: Facet::read(facets, slot), corners }
    }
}

impl<T: Real> Received<'_, T> {
    /// Adds to the bins of the receivers of a block what close sources in a range of slots send, and returns the sums of all directions.
    pub(super) fn close_block(
        &self,
        (near, slots): (&NearPairs, &Range<u32>),
        block: u32,
        scratch: &mut Scratch<T>,
        incident: &mut [T],
    ) -> [[T; 4]; N] {
        let light = &self.light;
        let class = self.shape.source;
        let class = Class { blocker: class.blocker && self.passing & PAIR_BACK != 0, ..class };
        let (layout, half_range) = (&light.layout, light.half_range);
        let Scratch { pieces, bins, .. } = scratch;
        let bins = &mut bins[..if self.shape.receiver_bins { layout.count } else { 0 }];
        let mut sums = [[T::ZERO; 4]; N];
        for (k, sum) in sums.iter_mut().enumerate() {
            let slot = block * N as u32 + k as u32;
            let sources = near.of(slot, slots);
            if sources.is_empty() {
                continue;
            }
            let receiver = Triangle::read(light.facets, light.corners, slot);
            for &source in sources {
                let triangle = Triangle::read(light.facets, light.corners, source);
                let receiver_bins = self.shape.receiver_bins;
                let pair = ClosePair { source: triangle, receiver, class, receiver_bins, half_range };
                let diffuse = light.radiance(source);
                if !class.has_bins() && !receiver_bins {
                    add(sum, pair.uniform(layout), diffuse);
                    continue;
                }
                let (front, back) = light.bins_of(source - self.sources_page, class);
                pair.walk(layout, pieces, |pieces| {
                    for k in pieces.lit() {
                        let value = value(pieces, k, layout, diffuse, (front, back));
                        if receiver_bins {
                            pieces.at_receiver.scatter(k, layout, bins, value);
                        }
                        add(sum, T::ONE, value);
                    }
                });
            }
            if self.shape.receiver_bins {
                let to = &mut incident[k * light.bins..][..light.bins];
                flush(layout, bins, |bin| T::ONE / light.bin_table[SLOT * bin + 3], to);
            }
        }
        sums
    }
}

/// The irradiance through a piece; `front` and `back`: bins of the source.
fn value<T: Real>(
    pieces: &Pieces<T>,
    k: usize,
    layout: &Layout<T>,
    diffuse: [T; 4],
    (front, back): (&[T], &[T]),
) -> [T; 4] {
    let mut value = [T::ZERO; 4];
    add(&mut value, pieces.diffuse[k], diffuse);
    let binned = pieces.binned[k];
    if binned > T::ZERO {
        match pieces.front[k] > T::ZERO {
            true => add(&mut value, binned, pieces.at_source.gather(k, layout, front)),
            // J is the identity on the state, and antiradiance counts negative.
            false => add(&mut value, -binned, pieces.at_source.gather(k, layout, back)),
        }
    }
    value
}
