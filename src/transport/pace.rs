//! How much work to submit at once: short enough to be interrupted and not to trigger the watchdog of a graphics
//! driver, long enough that the overhead of submissions is negligible. Never changes a result.

use super::watch::{PassMonitor, TransportError};
use crate::gpu::{Batch, Device, GpuError};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Seconds a submission should take.
const TARGET: f64 = 0.15;
/// Workgroups along one axis that every device supports.
pub const MOST_GROUPS: u32 = 65_535;
/// Part of that which the first submission takes if the rate is guessed right: a GPU of a phone may be that much slower, and its
/// watchdog must not bite before the rate is known.
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

    /// The part of a submission that so many pairs are.
    pub fn load(&self, pairs: u64) -> f64 {
        pairs as f64 / self.pairs_per_submission()
    }

    /// How many of `items` of `pairs` pairs each to dispatch at once: in parts of equal size, so that no short one
    /// remains.
    pub fn share(&self, items: u32, pairs: u64) -> u32 {
        let affordable = (self.pairs() / pairs.max(1)).clamp(1, u64::from(MOST_GROUPS)) as u32;
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

/// Work that is recorded and not yet executed, and whose rates are learnt when it is: all those of one submission alike.
#[derive(Default)]
pub struct Recorded(Vec<(Pace, f64)>);

impl Recorded {
    fn load(&self) -> f64 {
        self.0.iter().map(|(_, load)| load).sum()
    }

    pub fn learn(&mut self, seconds: f64) {
        let load = self.load();
        self.0.drain(..).for_each(|(pace, _)| pace.learn(load, seconds));
    }
}

/// Dispatches of one kernel not yet submitted: those too short to be submitted alone are submitted together, and where nothing is read
/// in between, with what the next kernels do.
pub struct Bundle<'b> {
    device: &'b Device,
    pace: Pace,
    monitor: &'b mut PassMonitor,
    batch: Option<Batch>,
    /// Pairs recorded, and the pairs to report to the callback.
    pairs: u64,
    shown: u64,
}

impl<'b> Bundle<'b> {
    pub fn new(device: &'b Device, pace: &Pace, monitor: &'b mut PassMonitor) -> Self {
        // What others have executed meanwhile is no longer to come.
        if !device.anything_waits() {
            monitor.recorded.0.clear();
        }
        Self { device, pace: pace.clone(), monitor, batch: None, pairs: 0, shown: 0 }
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
        record: impl FnOnce(&mut Batch) -> Result<(), GpuError>,
    ) -> Result<(), TransportError> {
        if self.monitor.recorded.load() + self.pace.load(self.pairs + pairs) > 1.0 {
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

    /// Submits what is recorded, that of earlier bundles too, and waits for it.
    fn submit(&mut self) -> Result<(), TransportError> {
        let seconds = match self.batch.take() {
            Some(batch) => batch.submit()?.wall_seconds,
            None => self.device.execute_waiting()?.wall_seconds,
        };
        self.recorded();
        self.monitor.executed(seconds)?;
        self.monitor.done(std::mem::take(&mut self.shown))
    }

    /// The last dispatch is recorded. Where all states are on the device the rest waits for what comes next.
    pub fn end(mut self) -> Result<(), TransportError> {
        if !self.monitor.defers {
            return self.submit();
        }
        if let Some(batch) = self.batch.take() {
            batch.defer()?;
            self.recorded();
            self.monitor.done(self.shown)?;
        }
        Ok(())
    }

    fn recorded(&mut self) {
        let load = self.pace.load(std::mem::take(&mut self.pairs));
        self.monitor.recorded.0.push((self.pace.clone(), load));
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

    /// Two kernels, one of which is believed to be faster than it is, the other slower.
    #[test]
    fn several_in_one_submission_settle_at_the_target() {
        let rates = [1e6, 3e9];
        let paces = [Pace::new(1e8), Pace::new(1e7)];
        let mut seconds = 0.0;
        for _ in 0..20 {
            let pairs = paces.each_ref().map(|pace| pace.pairs() / 2);
            let loads = pairs.iter().zip(&paces).map(|(&pairs, pace)| (pace.clone(), pace.load(pairs)));
            let mut recorded = Recorded(loads.collect());
            seconds = pairs.iter().zip(rates).map(|(&pairs, rate)| pairs as f64 / rate).sum();
            recorded.learn(seconds);
            assert!(recorded.0.is_empty());
        }
        assert!((seconds - TARGET).abs() <= 0.1 * TARGET, "{seconds}");
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
