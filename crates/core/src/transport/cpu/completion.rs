//! What ranks compute in shares, completed: each sends its own, and receives those of all others.

use crate::plan::Plan;
use antirad_base::ranks::{RankError, Ranks};
use bytemuck::Pod;
use std::ops::Range;

/// Allgathers values: each rank has computed those of its share of indices, and all have the whole
/// afterwards. `count`: values of each index, from that of `first` on. All ranks call it.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn complete<T: Pod>(
    ranks: &Ranks,
    values: &mut [T],
    (first, count): (u32, usize),
    shares: &[Range<u32>],
) -> Result<(), RankError> {
    if ranks.count() == 1 {
        return Ok(());
    }
    for (root, share) in shares.iter().enumerate().filter(|(_, share)| !share.is_empty()) {
        let own = &mut values[(share.start - first) as usize * count..][..share.len() * count];
        ranks.broadcast(root, bytemuck::cast_slice_mut(own))?;
    }
    Ok(())
}

/// Allgathers an array with `count` values of each slot. All ranks call it.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn complete_slots<T: Pod>(
    ranks: &Ranks,
    plan: &Plan,
    values: &mut [T],
    count: usize,
) -> Result<(), RankError> {
    let groups = 0..plan.layout.groups.len();
    groups.into_iter().try_for_each(|g| complete(ranks, values, (0, count), &plan.slots_by_rank(g)))
}
