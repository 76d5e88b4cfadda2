//! How much work to submit at once: short enough to be interrupted and not to trigger the watchdog of a graphics
//! driver, long enough that the overhead of submissions is negligible. Never changes a result.

use super::watch::{PassMonitor, TransportError};
use crate::gpu::{Batch, Device, GpuError};

/// Seconds a submission should take.
const TARGET: f64 = 0.15;
/// Workgroups along one axis that every device supports.
pub const MOST_GROUPS: u32 = 65_535;
/// Part of that which the first submission takes if the rate is guessed right: a GPU of a phone may be that much slower, and its
/// watchdog must not bite before the rate is known.
const FIRST: f64 = 1.0 / 16.0;
/// Largest growth from one submission to the next, since rates are noisy.
const GROWTH: f64 = 4.0;

/// The measured rate of one kernel.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    pairs_per_submission: f64,
}

impl Pace {
    /// Starts with a low estimate of the rate, in pairs per second.
    pub fn new(rate: f64) -> Self {
        Self { pairs_per_submission: rate * TARGET * FIRST }
    }

    /// Pairs to submit next.
    pub fn pairs(&self) -> u64 {
        self.pairs_per_submission.max(1.0) as u64
    }

    /// How many of `items` of `pairs` pairs each to dispatch at once: in parts of equal size, so that no short one
    /// remains.
    pub fn share(&self, items: u32, pairs: u64) -> u32 {
        let affordable = (self.pairs() / pairs.max(1)).clamp(1, u64::from(MOST_GROUPS)) as u32;
        items.div_ceil(items.div_ceil(affordable).max(1)).max(1)
    }

    /// Updates the rate from a submission.
    pub fn learn(&mut self, pairs: u64, seconds: f64) {
        if pairs > 0 && seconds > 0.0 {
            let wanted = pairs as f64 * TARGET / seconds;
            let small = pairs < self.pairs() / 2;
            // The time of a short submission is mostly overhead.
            let highest = if small { self.pairs_per_submission } else { self.pairs_per_submission * GROWTH };
            let lowest = if small { self.pairs_per_submission } else { 1.0 };
            self.pairs_per_submission = wanted.clamp(lowest, highest);
        }
    }
}

/// Dispatches of one kernel not yet submitted: those too short to be submitted alone are submitted together.
pub struct Bundle<'a, 'b> {
    device: &'b Device,
    pace: &'b mut Pace,
    monitor: &'b mut PassMonitor,
    batch: Option<Batch<'a>>,
    /// Pairs recorded, and the pairs to report to the callback.
    pairs: u64,
    shown: u64,
}

impl<'a, 'b> Bundle<'a, 'b> {
    pub fn new(device: &'b Device, pace: &'b mut Pace, monitor: &'b mut PassMonitor) -> Self {
        Self { device, pace, monitor, batch: None, pairs: 0, shown: 0 }
    }

    /// [`Pace::share`] at the current rate.
    pub fn share(&self, items: u32, pairs: u64) -> u32 {
        self.pace.share(items, pairs)
    }

    /// Pairs to submit next.
    pub fn affordable(&self) -> u64 {
        self.pace.pairs()
    }

    /// Records a dispatch of `pairs` pairs, reported to the callback as `shown`. First submits the earlier ones if
    /// all together would be too many.
    pub fn add(
        &mut self,
        pairs: u64,
        shown: u64,
        record: impl FnOnce(&mut Batch<'a>) -> Result<(), GpuError>,
    ) -> Result<(), TransportError> {
        if self.pairs + pairs > self.pace.pairs() {
            self.submit()?;
        }
        let batch = match &mut self.batch {
            Some(batch) => batch,
            None => self.batch.insert(self.device.batch()?),
        };
        record(batch)?;
        self.pairs += pairs;
        self.shown += shown;
        Ok(())
    }

    /// Reports pairs that needed no dispatch.
    pub fn done_elsewhere(&mut self, shown: u64) -> Result<(), TransportError> {
        self.monitor.done(shown)
    }

    /// Submits the recorded dispatches and waits for them.
    pub fn submit(&mut self) -> Result<(), TransportError> {
        if let Some(batch) = self.batch.take() {
            let seconds = batch.submit()?.wall_seconds;
            self.pace.learn(std::mem::take(&mut self.pairs), seconds);
            self.monitor.done(std::mem::take(&mut self.shown))?;
        }
        Ok(())
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
    fn shares_are_equal() {
        let pace = Pace::new(1000.0 / (TARGET * FIRST));
        let shares = [(100, 10), (101, 10), (250, 10), (5, 5000)];
        assert_eq!(shares.map(|(items, pairs)| pace.share(items, pairs)), [100, 51, 84, 1]);
    }

    #[test]
    fn short_submissions_teach_nothing() {
        let mut pace = Pace::new(1e8);
        let before = pace.pairs();
        pace.learn(1000, 1e-3);
        assert_eq!(pace.pairs(), before);
    }
}
