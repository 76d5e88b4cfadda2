//! The progress bar of a solve: on a terminal, with a time left; elsewhere nothing.

use indicatif::{ProgressBar, ProgressStyle};
use std::ops::Range;

/// Steps of the whole bar.
const STEPS: u64 = 1000;

/// Progress of a solve by the logarithm of its residual, which falls by about the same factor with every pass; within
/// a pass by pairs.
#[derive(Clone)]
pub struct SolveBar {
    bar: ProgressBar,
    tolerance: f64,
    /// What is solved, if it is one of several solves.
    name: Option<String>,
    /// Of the whole bar, 0 to 1.
    range: Range<f64>,
}

impl SolveBar {
    /// A bar that is hidden where standard error is no terminal, or `quiet`.
    pub fn new(tolerance: f64, quiet: bool) -> Self {
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(STEPS) };
        if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {elapsed} gone, {eta} left") {
            bar.set_style(style.progress_chars("=> "));
        }
        Self { bar, tolerance, name: None, range: 0.0..1.0 }
    }

    /// For one of several solves, which goes on over a part of the same bar (0 to 1).
    pub fn part(&self, tolerance: f64, name: &str, range: Range<f64>) -> Self {
        Self { bar: self.bar.clone(), tolerance, name: Some(name.to_owned()), range }
    }

    /// After `passes` passes, which reached `residual`, and `share` of the next one (0 to 1).
    pub fn show(&self, passes: u32, residual: f64, share: f64) {
        let done = if passes == 0 { 0.0 } else { (residual.ln() / self.tolerance.ln()).clamp(0.0, 1.0) };
        // The first passes say little of the rate: ten of them are usual.
        let step = if passes < 2 { 0.1 } else { done / f64::from(passes - 1) };
        let done = self.range.start + (self.range.end - self.range.start) * (done + share * step).min(1.0);
        self.bar.set_position((done * STEPS as f64) as u64);
        let pass = match passes {
            0 => "first pass".to_owned(),
            _ => format!("pass {}, residual {residual:.1e} of {:.0e}", passes + 1, self.tolerance),
        };
        self.bar.set_message(match &self.name {
            Some(name) => format!("{name}: {pass}"),
            None => pass,
        });
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_solves_move_one_bar_on() {
        let whole = SolveBar::new(1e-4, true);
        let first = whole.part(1e-2, "first", 0.0..0.25);
        let second = whole.part(1e-4, "second", 0.25..1.0);
        let mut before = 0;
        for (bar, passes, residual, share) in [
            (&first, 1, 0.1, 0.5),
            (&first, 2, 1e-2, 0.0),
            (&second, 0, 1.0, 0.0),
            (&second, 0, 1.0, 0.9),
            (&second, 3, 1e-2, 0.0),
            (&second, 5, 1e-5, 0.0),
        ] {
            bar.show(passes, residual, share);
            assert!(whole.bar.position() >= before, "{} after {before}", whole.bar.position());
            before = whole.bar.position();
        }
        assert_eq!(before, STEPS);
    }
}
