//! How much work to give the device at a time: dispatches short enough to be interrupted and not to trip the watchdog
//! of a graphics driver, long enough that their number costs nothing. Never changes a result.

/// Seconds a dispatch should take.
const TARGET: f64 = 0.15;
/// A dispatch may grow by this much over the one before: rates are noisy.
const GROWTH: f64 = 4.0;

/// The measured rate of one kernel.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    pairs_per_dispatch: f64,
}

impl Pace {
    /// With a first guess of the rate in pairs per second, on the low side.
    pub fn new(rate: f64) -> Self {
        Self { pairs_per_dispatch: rate * TARGET }
    }

    /// Pairs to dispatch next.
    pub fn pairs(&self) -> u64 {
        self.pairs_per_dispatch.max(1.0) as u64
    }

    /// Learns from a dispatch.
    pub fn learn(&mut self, pairs: u64, seconds: f64) {
        if pairs > 0 && seconds > 0.0 {
            let wanted = pairs as f64 * TARGET / seconds;
            let small = pairs < self.pairs() / 2;
            // A short dispatch says little: mostly what starting one costs.
            let highest = if small { self.pairs_per_dispatch } else { self.pairs_per_dispatch * GROWTH };
            let lowest = if small { self.pairs_per_dispatch } else { 1.0 };
            self.pairs_per_dispatch = wanted.clamp(lowest, highest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settles_at_the_target() {
        let mut pace = Pace::new(1e6);
        for _ in 0..20 {
            let pairs = pace.pairs();
            pace.learn(pairs, pairs as f64 / 5e8);
        }
        assert!((pace.pairs() as f64 / 5e8 - TARGET).abs() <= 0.01);
    }

    #[test]
    fn short_dispatches_teach_nothing() {
        let mut pace = Pace::new(1e8);
        let before = pace.pairs();
        pace.learn(1000, 1e-3);
        assert_eq!(pace.pairs(), before);
    }
}
