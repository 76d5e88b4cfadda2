//! The progress bar of a solve: on a terminal, with a time left; elsewhere nothing.

use indicatif::{ProgressBar, ProgressStyle};

/// Steps of the whole bar.
const STEPS: u64 = 1000;

/// Progress of a solve by the logarithm of its residual, which falls by about the same factor with every pass; within
/// a pass by pairs.
#[derive(Clone)]
pub struct SolveBar {
    bar: ProgressBar,
    tolerance: f64,
}

impl SolveBar {
    /// A bar that is hidden where standard error is no terminal, or `quiet`.
    pub fn new(tolerance: f64, quiet: bool) -> Self {
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(STEPS) };
        if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {elapsed} gone, {eta} left") {
            bar.set_style(style.progress_chars("=> "));
        }
        Self { bar, tolerance }
    }

    /// After `passes` passes, which reached `residual`, and `share` of the next one (0 to 1).
    pub fn show(&self, passes: u32, residual: f64, share: f64) {
        let done = if passes == 0 { 0.0 } else { (residual.ln() / self.tolerance.ln()).clamp(0.0, 1.0) };
        // The first passes say little of the rate: ten of them are usual.
        let step = if passes < 2 { 0.1 } else { done / f64::from(passes - 1) };
        self.bar.set_position(((done + share * step).min(1.0) * STEPS as f64) as u64);
        self.bar.set_message(match passes {
            0 => "first pass".to_owned(),
            _ => format!("pass {}, residual {residual:.1e} of {:.0e}", passes + 1, self.tolerance),
        });
    }

    /// Takes the bar off the terminal.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
