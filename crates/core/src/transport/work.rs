//! Numbers of pairs, for the estimate of the remaining time.

use crate::plan::{Group, Plan};

/// Cost of a close pair in point-to-point pairs.
pub const NEAR_COST: u64 = 100;

/// Pairs of two groups, point to point.
pub fn far_pairs(plan: &Plan, one: &Group, other: &Group) -> u64 {
    let tiles = one.tiles.len() as u64 * other.tiles.len() as u64;
    tiles * u64::from(plan.layout.tile * plan.layout.tile)
}

/// Pairs of a whole pass, forwards or of the adjoint, weighted by cost. `evaluated`: whether close pairs are evaluated even where they are
/// kept.
pub fn pairs(plan: &Plan, evaluated: bool) -> u64 {
    let slots = u64::from(plan.layout.slots());
    slots * slots
        + match plan.near_field_matrix() {
            Some(kept) if !evaluated => kept.forward.columns.len() as u64,
            _ => plan.interactions().by_receiver.near.partners.len() as u64 * NEAR_COST,
        }
}
