//! Uᵀ between close triangles. Twin of crates/core/glsl/near_adjoint.comp.

use super::far::N;
use super::far_adjoint::{Importance, Scratch, Sums};
use super::pieces::{ClosePair, Triangle};
use super::real::Real;
use super::taps::{add, scaled};
use crate::plan::NearPairs;
use std::ops::Range;

impl<T: Real> Importance<'_, T> {
    /// Adds to the bins of the sources of a block, behind the backs and in front, what their light matters to close receivers in a range of
    /// slots, and returns the sums of each.
    pub(super) fn close_block(
        &self,
        (near, slots): (&NearPairs, &Range<u32>),
        block: u32,
        scratch: &mut Scratch<T>,
        [back, front]: [&mut [T]; 2],
    ) -> Sums<T> {
        let cotangents = &self.cotangents;
        let (class, receiver_bins) = (self.shape.source, self.shape.receiver_bins);
        let (layout, half_range) = (&cotangents.layout, cotangents.half_range);
        let Scratch { pieces, backs, fronts, .. } = scratch;
        let own = |has: bool| if has { layout.count } else { 0 };
        let (backs, fronts) = (&mut backs[..own(class.blocker)], &mut fronts[..own(class.glossy)]);
        let mut sums = [[T::ZERO; 4]; N];
        for (k, sum) in sums.iter_mut().enumerate() {
            let slot = block * N as u32 + k as u32;
            let receivers = near.of(slot, slots);
            if receivers.is_empty() {
                continue;
            }
            let source = Triangle::read(cotangents.facets, cotangents.corners, slot);
            for &slot in receivers {
                let receiver = Triangle::read(cotangents.facets, cotangents.corners, slot);
                let pair = ClosePair { source, receiver, class, receiver_bins, half_range };
                let irradiance = cotangents.of_irradiance(slot);
                if !self.shape.any_bins() {
                    add(sum, pair.uniform(layout), irradiance);
                    continue;
                }
                let incident = cotangents.of_bins(slot - self.receivers_page, receiver_bins);
                pair.walk(layout, pieces, |pieces| {
                    for k in pieces.lit() {
                        let mut importance = irradiance;
                        if receiver_bins {
                            add(&mut importance, T::ONE, pieces.at_receiver.gather(k, layout, incident));
                        }
                        add(sum, pieces.diffuse[k], importance);
                        let binned = pieces.binned[k];
                        if binned > T::ZERO {
                            let (bins, sign) = match pieces.front[k] > T::ZERO {
                                true => (&mut *fronts, binned),
                                false => (&mut *backs, -binned),
                            };
                            pieces.at_source.scatter(k, layout, bins, scaled(sign, importance));
                        }
                    }
                });
            }
            let bins = k * cotangents.bins..(k + 1) * cotangents.bins;
            if class.blocker {
                cotangents.flush_back(backs, &mut back[bins.clone()]);
            }
            if class.glossy {
                cotangents.flush_front(fronts, &mut front[bins]);
            }
        }
        sums
    }
}
