//! How much of the work each of several ranks does.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// The weight of the largest budget: coarse, so that the little that other programs hold of one device moves no work.
const MOST: u64 = 16;

/// How much of the work each rank does, in proportion to whole numbers, so that all of them cut it alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RankWeights(&'static [u32]);

impl RankWeights {
    /// Equal weights: all ranks do the same amount of work.
    pub const EVEN: Self = Self(&[]);

    /// One weight for each rank, in their order.
    pub fn new(weights: &[u32]) -> Self {
        /// Options are copied freely, and a process meets few weights: each list is made once and stays.
        static KNOWN: Mutex<BTreeSet<&'static [u32]>> = Mutex::new(BTreeSet::new());
        if weights.windows(2).all(|pair| pair[0] == pair[1]) && weights.first() != Some(&0) {
            return Self::EVEN;
        }
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = known.get(weights).copied().unwrap_or_else(|| Box::leak(weights.into()));
        known.insert(kept);
        Self(kept)
    }

    /// Weights in proportion to the memory budgets of the ranks' devices, to a sixteenth of the largest. None
    /// does nothing.
    pub fn of_budgets(budgets: &[u64]) -> Self {
        let largest = budgets.iter().copied().max().unwrap_or(0).max(1);
        let weight = |&budget: &u64| {
            let sixteenths = u128::from(budget) * u128::from(2 * MOST) / u128::from(largest);
            sixteenths.div_ceil(2).max(1) as u32
        };
        Self::new(&budgets.iter().map(weight).collect::<Vec<_>>())
    }

    /// Whether there is one above zero for each of some ranks.
    pub(super) fn serve(self, ranks: u32) -> bool {
        self.0.is_empty() || self.0.len() == ranks as usize && !self.0.contains(&0)
    }

    /// The weights of all ranks.
    pub(super) fn of_all(self, ranks: u32) -> Vec<u32> {
        if self.0.is_empty() { vec![1; ranks as usize] } else { self.0.to_vec() }
    }

    /// What a rank does of some work.
    pub(super) fn share(self, work: u64, rank: u32, ranks: u32) -> u64 {
        let weights = self.of_all(ranks);
        let all: u128 = weights.iter().map(|&weight| u128::from(weight)).sum();
        (u128::from(work) * u128::from(weights[rank as usize]) / all) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_follow_budgets_and_not_what_other_programs_hold() {
        const GIB: u64 = 1 << 30;
        let of = |budgets: &[u64]| RankWeights::of_budgets(budgets).of_all(budgets.len() as u32);
        assert_eq!(RankWeights::of_budgets(&[GIB; 3]), RankWeights::EVEN);
        assert_eq!(RankWeights::of_budgets(&[GIB, GIB - GIB / 50]), RankWeights::EVEN);
        assert_eq!(of(&[8 * GIB, 4 * GIB, 24 * GIB]), [5, 3, 16]);
        assert_eq!(of(&[u64::MAX, u64::MAX / 2 + 1, 0]), [16, 8, 1]);
        // A full device each.
        assert_eq!(RankWeights::of_budgets(&[0, 0]), RankWeights::EVEN);
    }

    #[test]
    fn equal_weights_are_kept_once() {
        let [one, other] = [0; 2].map(|_| RankWeights::new(&[1, 3]));
        assert!(std::ptr::eq(one.0, other.0));
        assert_ne!(one, RankWeights::new(&[3, 1]));
        assert_eq!([0, 1].map(|rank| one.share(100, rank, 2)), [25, 75]);
        assert_eq!(RankWeights::EVEN.share(100, 2, 3), 33);
        assert!(one.serve(2) && !one.serve(3) && RankWeights::EVEN.serve(3));
        assert!(!RankWeights::new(&[0, 1]).serve(2) && !RankWeights::new(&[0, 0]).serve(2));
    }
}
