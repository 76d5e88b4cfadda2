//! Pairs so close that they are integrated over pieces: O(N) of them.

use super::classes::{Class, reaches};
use super::tiles::{Layout, PADDING, PAIR_NEAR, TilePairs};
use crate::reference::Facet;
use rayon::prelude::*;

/// For each receiver slot the slots of its close sources, rising.
#[derive(Clone, Debug, Default)]
pub struct NearPairs {
    /// Where each slot's list starts; one entry more than there are slots.
    pub offsets: Vec<u32>,
    pub sources: Vec<u32>,
}

impl NearPairs {
    pub fn new(
        layout: &Layout,
        pairs: &TilePairs,
        facets: &[Facet],
        classes: &[Class],
        half_range: f64,
        tolerance: f64,
    ) -> Self {
        let tile = layout.tile as usize;
        let real = |slot: usize| Some(layout.order[slot]).filter(|&i| i != PADDING).map(|i| i as usize);
        let close = |j: usize, i: usize| {
            let (to, from) = (&facets[j], &facets[i]);
            i != j
                && (to.centroid - from.centroid).length_squared() < half_range * (to.extent + from.extent)
                && (reaches(from, to, 1.0, tolerance)
                    || classes[i].blocker && reaches(from, to, -1.0, tolerance))
        };
        let lists: Vec<Vec<u32>> = (0..layout.slots() as usize)
            .into_par_iter()
            .map(|slot| {
                let Some(j) = real(slot) else { return Vec::new() };
                let near = |&s: &u32| pairs.get((slot / tile) as u32, s) & PAIR_NEAR != 0;
                (0..layout.tiles())
                    .filter(near)
                    .flat_map(|s| s as usize * tile..(s as usize + 1) * tile)
                    .filter(|&source| real(source).is_some_and(|i| close(j, i)))
                    .map(|source| source as u32)
                    .collect()
            })
            .collect();
        let mut offsets = Vec::with_capacity(lists.len() + 1);
        offsets.push(0);
        for list in &lists {
            offsets.push(offsets.last().copied().unwrap_or(0) + list.len() as u32);
        }
        Self { offsets, sources: lists.concat() }
    }
}
