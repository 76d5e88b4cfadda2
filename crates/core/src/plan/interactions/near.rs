//! Close pairs, which are integrated piecewise: O(N) of them.

use super::{FarRuns, PAIR_NEAR};
use crate::model::{BoundedRun, Class, Facet, PADDING, reaches};
use crate::plan::PlanError;
use crate::plan::TileLayout;
use antirad_base::parallel;
use std::ops::Range;

/// Slots of the close partners of each target slot, ascending. Targets are receivers and partners sources, or
/// the other way round.
#[derive(Clone, Debug, Default)]
pub struct NearPairs {
    /// Index in `partners` at which the list of each slot starts; one entry more than there are slots.
    pub offsets: Vec<u32>,
    /// Slots of the close triangles, list after list, ascending in each.
    pub partners: Vec<u32>,
}

impl NearPairs {
    /// Finds the close pairs among the tiles marked [`PAIR_NEAR`].
    ///
    /// # Errors
    /// Fails if the pairs are more than 32-bit indices can address.
    pub fn of_tiles(
        layout: &TileLayout,
        far: &FarRuns,
        facets: &[Facet],
        classes: &[Class],
        half_range: f64,
        tolerance: f64,
    ) -> Result<Self, PlanError> {
        let real = |slot: usize| Some(layout.order[slot]).filter(|&i| i != PADDING).map(|i| i as usize);
        let close = |j: usize, i: usize| {
            let (to, from) = (&facets[j], &facets[i]);
            i != j
                && (to.centroid - from.centroid).length_squared()
                    < half_range * (to.characteristic_area + from.characteristic_area)
                && (reaches(from, to, 1.0, tolerance)
                    || classes[i].blocker && reaches(from, to, -1.0, tolerance))
        };
        let lists_of = |tile: u32| -> Vec<Vec<u32>> {
            let slots = layout.slots_of(&(tile..tile + 1));
            let receivers = slots.clone().filter_map(|slot| real(slot as usize)).map(|j| &facets[j]);
            let around = BoundedRun::around(receivers.clone());
            let largest = receivers.map(|f| f.characteristic_area).fold(0.0, f64::max);
            // Most sources are far from all of them.
            let within = |&(_, i): &(u32, usize)| {
                let from = &facets[i];
                let nearest = from.centroid.clamp(around.min, around.max);
                nearest.distance_squared(from.centroid) < half_range * (largest + from.characteristic_area)
            };
            let near = far.passing(tile, &(0..layout.tiles()), PAIR_NEAR);
            let sources = near.flat_map(|tile| layout.slots_of(&(tile..tile + 1)));
            let sources = sources.filter_map(|slot| Some((slot, real(slot as usize)?)));
            let sources: Vec<(u32, usize)> = sources.filter(within).collect();
            let of = |slot: u32| {
                let Some(j) = real(slot as usize) else { return Vec::new() };
                sources.iter().filter(|&&(_, i)| close(j, i)).map(|&(source, _)| source).collect()
            };
            slots.map(of).collect()
        };
        let lists: Vec<Vec<u32>> = parallel::flat_map(0..layout.tiles(), lists_of);
        let count = lists.iter().map(Vec::len).sum::<usize>();
        if u32::try_from(count).is_err() {
            return Err(PlanError::TooManyPairs { what: "close pairs", count: count as u64 });
        }
        let mut offsets = Vec::with_capacity(lists.len() + 1);
        offsets.push(0);
        for list in &lists {
            offsets.push(offsets.last().copied().unwrap_or(0) + list.len() as u32);
        }
        Ok(Self { offsets, partners: lists.concat() })
    }

    /// The partners of a target within a range of slots.
    pub fn of(&self, target: u32, partners: &Range<u32>) -> &[u32] {
        let list = target as usize..=target as usize + 1;
        let &[begin, end] = &self.offsets[list] else { return &[] };
        let all = &self.partners[begin as usize..end as usize];
        let before = |bound: u32| all.partition_point(|&partner| partner < bound);
        &all[before(partners.start)..before(partners.end)]
    }

    /// The pairs with targets and partners exchanged.
    pub fn transposed(&self) -> Self {
        let slots = self.offsets.len() - 1;
        let mut offsets = vec![0; slots + 1];
        for &partner in &self.partners {
            offsets[partner as usize + 1] += 1;
        }
        for slot in 0..slots {
            offsets[slot + 1] += offsets[slot];
        }
        let mut next = offsets.clone();
        let mut partners = vec![0; self.partners.len()];
        for (target, run) in self.offsets.windows(2).enumerate() {
            for &partner in &self.partners[run[0] as usize..run[1] as usize] {
                partners[next[partner as usize] as usize] = target as u32;
                next[partner as usize] += 1;
            }
        }
        Self { offsets, partners }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposing_keeps_the_pairs_and_their_order() {
        let list = NearPairs { offsets: vec![0, 2, 2, 5], partners: vec![1, 2, 0, 1, 2] };
        let turned = list.transposed();
        assert_eq!(turned.offsets, [0, 1, 3, 5]);
        assert_eq!(turned.partners, [2, 0, 2, 0, 2]);
        let back = turned.transposed();
        assert_eq!((back.offsets, back.partners), (list.offsets, list.partners));
    }
}
