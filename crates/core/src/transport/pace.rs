//! How much work to do at once: short enough to be interrupted and not to trigger the watchdog of a graphics
//! driver, long enough that the overhead of submissions is negligible. Never changes a result.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Seconds a submission should take.
pub const TARGET: f64 = 0.15;
/// Most items at once: as many workgroups as every device supports along one axis.
const MOST_ITEMS: u32 = 65_535;
/// Fraction of [`TARGET`] that the first submission takes if the rate is guessed right. A GPU of a phone may
/// be that much slower, and its watchdog must not bite before the rate is known.
const FIRST: f64 = 1.0 / 16.0;
/// Largest growth from one submission to the next, since rates are noisy.
const GROWTH: f64 = 4.0;

/// The measured rate of one kernel. Clones share it.
#[derive(Clone, Debug)]
pub struct Pace(Arc<AtomicU64>);

impl Pace {
    /// Starts with a low estimate of the rate, in pairs per second.
    pub fn new(rate: f64) -> Self {
        Self(Arc::new(AtomicU64::new((rate * TARGET * FIRST).to_bits())))
    }

    fn pairs_per_submission(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed)).max(1.0)
    }

    /// Pairs to submit next.
    pub fn pairs(&self) -> u64 {
        self.pairs_per_submission() as u64
    }

    /// `pairs` as a fraction of what one submission takes.
    pub fn load(&self, pairs: u64) -> f64 {
        pairs as f64 / self.pairs_per_submission()
    }

    /// How many of `items`, of `pairs` pairs each, to dispatch at once: in ranges of equal size, so that no
    /// short one remains.
    pub fn share(&self, items: u32, pairs: u64) -> u32 {
        let affordable = (self.pairs() / pairs.max(1)).clamp(1, u64::from(MOST_ITEMS)) as u32;
        items.div_ceil(items.div_ceil(affordable).max(1)).max(1)
    }

    /// Updates the rate from the time of what was believed to be `load` submissions.
    pub fn learn(&self, load: f64, seconds: f64) {
        if load > 0.0 && seconds > 0.0 {
            let now = self.pairs_per_submission();
            let wanted = now * load * TARGET / seconds;
            // The time of a small submission is mostly overhead, unless it is long.
            let small = load < 0.5;
            let highest = if small { now } else { now * GROWTH };
            let lowest = if small && seconds <= TARGET { now } else { 1.0 };
            self.0.store(wanted.clamp(lowest, highest).to_bits(), Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settles_at_the_target() {
        let pace = Pace::new(1e6);
        for _ in 0..20 {
            let pairs = pace.pairs();
            pace.learn(pace.load(pairs), pairs as f64 / 5e8);
        }
        assert!((pace.pairs() as f64 / 5e8 - TARGET).abs() <= 0.01);
    }

    #[test]
    fn shares_are_equal() {
        let pace = Pace::new(1000.0 / (TARGET * FIRST));
        let shares = [(100, 10), (101, 10), (250, 10), (5, 5000)];
        assert_eq!(shares.map(|(items, pairs)| pace.share(items, pairs)), [100, 51, 84, 1]);
    }

    #[test]
    fn short_submissions_teach_nothing_unless_they_are_slow() {
        let pace = Pace::new(1e8);
        let before = pace.pairs();
        pace.learn(pace.load(1000), 1e-3);
        assert_eq!(pace.pairs(), before);
        pace.learn(pace.load(1000), 10.0);
        assert!(pace.pairs() < before);
    }
}
