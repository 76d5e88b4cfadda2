//! Dispatches that are submitted together: short enough to be interrupted and not to trigger the watchdog of a graphics driver, long enough
//! that the overhead of submissions is negligible. Never changes a result.

use crate::transport::TransportError;
use crate::transport::pace::Pace;
use crate::transport::watch::Progress;
use antirad_gpu::{Batch, Device, GpuError};

/// Workgroups along one axis that every device supports.
pub const MOST_GROUPS: u32 = 65_535;

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

/// What is recorded in a pass, and who is told of it.
pub struct PassMonitor {
    pub progress: Progress,
    /// What is recorded and not yet executed.
    recorded: Recorded,
    /// Whether work may wait for what comes next: nothing is read in between.
    defers: bool,
}

impl PassMonitor {
    pub fn new(defers: bool) -> Self {
        Self { progress: Progress::default(), recorded: Recorded::default(), defers }
    }

    /// A pass over `total` pairs begins.
    pub fn begin(&mut self, total: u64) {
        self.progress.begin(total);
    }

    /// Work on `pairs` pairs has ended, or is recorded.
    ///
    /// # Errors
    /// Fails with [`TransportError::Interrupted`] if the callback stops the pass.
    pub fn done(&mut self, pairs: u64) -> Result<(), TransportError> {
        self.progress.done(pairs)
    }

    /// All that was recorded has been executed, in this time.
    ///
    /// # Errors
    /// Fails with [`TransportError::Interrupted`] if the callback stops the pass.
    pub fn executed(&mut self, seconds: f64) -> Result<(), TransportError> {
        self.recorded.learn(seconds);
        self.done(0)
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
    ///
    /// # Errors
    /// Fails if `record` or the device does, or if the callback stops the pass.
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
    ///
    /// # Errors
    /// Fails if the device does, or if the callback stops the pass.
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
    use crate::transport::pace::TARGET;

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
}
