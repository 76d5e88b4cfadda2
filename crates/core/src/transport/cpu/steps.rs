//! Work in steps of a fraction of a second, between which it can be interrupted, and the profile of it.

use super::super::pace::Pace;
use super::super::shape::Shape;
use super::super::watch::{PassCallback, Progress, TransportError};
use super::super::work::NEAR_COST;
use crate::backend::Cpu;
use std::ops::Range;
use std::time::Instant;

/// An operator over pairs of triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Far pairs, point to point.
    Far,
    /// Close pairs, piece by piece.
    Near,
    FarAdjoint,
    NearAdjoint,
    FarDerivative,
    NearDerivative,
}

impl Kernel {
    fn name(self) -> &'static str {
        match self {
            Self::Far => "far",
            Self::Near => "near",
            Self::FarAdjoint => "far_adjoint",
            Self::NearAdjoint => "near_adjoint",
            Self::FarDerivative => "far_derivative",
            Self::NearDerivative => "near_derivative",
        }
    }

    fn is_near(self) -> bool {
        matches!(self, Self::Near | Self::NearAdjoint | Self::NearDerivative)
    }
}

/// Measured rates, and who is told of progress.
pub struct Steps {
    cpu: Cpu,
    progress: Progress,
    paces: Vec<((Kernel, Shape), Pace)>,
}

impl Steps {
    pub fn new(cpu: &Cpu) -> Self {
        Self { cpu: cpu.clone(), progress: Progress::default(), paces: Vec::new() }
    }

    pub fn set_callback(&mut self, callback: Option<PassCallback>) {
        self.progress.callback = callback;
    }

    /// A pass over `total` pairs begins.
    pub fn begin(&mut self, total: u64) {
        self.progress.begin(total);
    }

    /// Pairs are done, or need not be.
    ///
    /// # Errors
    /// Fails with [`TransportError::Interrupted`] if the callback stops the pass.
    pub fn done(&mut self, pairs: u64) -> Result<(), TransportError> {
        self.progress.done(pairs)
    }

    /// Does the work of blocks of targets, of so many pairs each.
    ///
    /// # Errors
    /// Fails with [`TransportError::Interrupted`] if the callback stops the pass.
    pub fn over(
        &mut self,
        (kernel, shape): (Kernel, Shape),
        blocks: Range<u32>,
        pairs: impl Fn(u32) -> u64,
        mut work: impl FnMut(Range<u32>),
    ) -> Result<(), TransportError> {
        let pace = self.pace(kernel, shape);
        let cost = if kernel.is_near() { NEAR_COST } else { 1 };
        let mut begin = blocks.start;
        while begin < blocks.end {
            let affordable = pace.pairs();
            let mut taken = 0;
            let fits = |block: &u32| {
                let more = pairs(*block);
                let fits = taken == 0 || taken + more <= affordable;
                taken += if fits { more } else { 0 };
                fits
            };
            let end = begin + (begin..blocks.end).take_while(fits).count() as u32;
            if taken > 0 {
                let start = Instant::now();
                work(begin..end);
                let seconds = start.elapsed().as_secs_f64();
                pace.learn(pace.load(taken), seconds);
                self.cpu.record(kernel.name(), shape.name(), seconds, taken);
                self.progress.done(taken * cost)?;
            }
            begin = end;
        }
        Ok(())
    }

    /// Does some work as a whole.
    pub fn timed<R>(&self, kernel: &'static str, shape: &str, items: u64, work: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = work();
        self.cpu.record(kernel, shape, start.elapsed().as_secs_f64(), items);
        result
    }

    fn pace(&mut self, kernel: Kernel, shape: Shape) -> Pace {
        let known = self.paces.iter().find(|(of, _)| *of == (kernel, shape));
        if let Some((_, pace)) = known {
            return pace.clone();
        }
        // Pairs per second of one slow core.
        let pace = Pace::new(if kernel.is_near() { 1e6 } else { 5e7 });
        self.paces.push(((kernel, shape), pace.clone()));
        pace
    }
}
