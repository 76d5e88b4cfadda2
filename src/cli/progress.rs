//! Progress of long work: on a terminal a bar, or a spinner where the remaining work is unknown; elsewhere a line every
//! ten seconds.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::ops::Range;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Between two lines, and before the first.
const PERIOD: Duration = Duration::from_secs(10);

/// Shows that the host is at work, until dropped.
pub struct Working {
    bar: ProgressBar,
    lines: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Working {
    /// Shows `what` is being done, unless warnings are switched off.
    pub fn on(what: &'static str) -> Self {
        if !tracing::enabled!(tracing::Level::WARN) {
            return Self { bar: ProgressBar::hidden(), lines: None };
        }
        if !std::io::stderr().is_terminal() {
            return Self::every(PERIOD, move |gone| eprintln!("{what}: {} s", gone.as_secs()));
        }
        let bar = ProgressBar::new_spinner().with_message(what);
        if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}, {elapsed} elapsed") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self { bar, lines: None }
    }

    /// Calls `say` in every period with the time elapsed.
    fn every(period: Duration, say: impl Fn(Duration) + Send + 'static) -> Self {
        let (done, finished) = channel();
        let start = Instant::now();
        let lines = std::thread::spawn(move || {
            while finished.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
                say(start.elapsed());
            }
        });
        Self { bar: ProgressBar::hidden(), lines: Some((done, lines)) }
    }
}

impl Drop for Working {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
        if let Some((done, lines)) = self.lines.take() {
            drop(done);
            // Wait for the thread, so that no line follows.
            let _ = lines.join();
        }
    }
}

/// Decides when a line is due.
struct Lines {
    period: Duration,
    last: Instant,
}

impl Lines {
    /// `None` where a bar shows progress, or nothing shall.
    fn without_terminal(quiet: bool) -> Option<Self> {
        let lines = Self { period: PERIOD, last: Instant::now() };
        (!quiet && !std::io::stderr().is_terminal()).then_some(lines)
    }

    fn due(&mut self, now: Instant) -> bool {
        let due = now.duration_since(self.last) >= self.period;
        if due {
            self.last = now;
        }
        due
    }
}

/// A bar of a number of steps, unless `quiet`; invisible where standard error is no terminal.
fn bar(steps: u64, quiet: bool) -> ProgressBar {
    let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(steps) };
    if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {elapsed} elapsed, {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}

/// Progress of work in parts that take about the same time, in any number of threads.
pub struct PartsBar {
    bar: ProgressBar,
    /// Lines, where there is no terminal.
    lines: Option<Mutex<Lines>>,
    parts: u64,
}

impl PartsBar {
    /// A bar where standard error is a terminal, lines elsewhere, nothing if `quiet`.
    pub fn new(parts: u64, quiet: bool) -> Self {
        Self { bar: bar(parts, quiet), lines: Lines::without_terminal(quiet).map(Mutex::new), parts }
    }

    /// What the next parts belong to.
    pub fn begin(&self, what: &str) {
        self.bar.set_message(what.to_owned());
    }

    /// One more part is done.
    pub fn part_done(&self) {
        self.bar.inc(1);
        let due =
            |lines: &Mutex<Lines>| lines.lock().unwrap_or_else(PoisonError::into_inner).due(Instant::now());
        if self.lines.as_ref().is_some_and(due) {
            let percent = 100 * self.bar.position() / self.parts.max(1);
            eprintln!("{}: {percent} % done, {} s", self.bar.message(), self.bar.elapsed().as_secs());
        }
    }

    /// Removes the bar from the terminal.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// Steps of the whole bar.
const STEPS: u64 = 1000;

/// Progress of a solve by the logarithm of its residual, which falls by about the same factor with every pass; within
/// a pass by pairs.
#[derive(Clone)]
pub struct SolveBar {
    bar: ProgressBar,
    /// Lines, where there is no terminal.
    lines: Option<Arc<Mutex<Lines>>>,
    tolerance: f64,
    /// Name of the solve, if it is one of several.
    name: Option<String>,
    /// The part of the whole bar that this solve fills, 0 to 1.
    range: Range<f64>,
}

impl SolveBar {
    /// A bar where standard error is a terminal, lines elsewhere, nothing if `quiet`.
    pub fn new(tolerance: f64, quiet: bool) -> Self {
        let lines = Lines::without_terminal(quiet).map(|lines| Arc::new(Mutex::new(lines)));
        Self { bar: bar(STEPS, quiet), lines, tolerance, name: None, range: 0.0..1.0 }
    }

    /// For one of several solves, which covers a part of the same bar (0 to 1).
    pub fn part(&self, tolerance: f64, name: &str, range: Range<f64>) -> Self {
        let (bar, lines) = (self.bar.clone(), self.lines.clone());
        Self { bar, lines, tolerance, name: Some(name.to_owned()), range }
    }

    /// After `passes` passes, which reached `residual`, and `fraction` of the next one (0 to 1).
    pub fn show(&self, passes: u32, residual: f64, fraction: f64) {
        let done = if passes == 0 { 0.0 } else { (residual.ln() / self.tolerance.ln()).clamp(0.0, 1.0) };
        // The first passes say little about the rate; ten are typical.
        let step = if passes < 2 { 0.1 } else { done / f64::from(passes - 1) };
        let done = self.range.start + (self.range.end - self.range.start) * (done + fraction * step).min(1.0);
        self.bar.set_position((done * STEPS as f64) as u64);
        let pass = match passes {
            0 => "first pass".to_owned(),
            _ => format!("pass {}, residual {residual:.1e} of {:.0e}", passes + 1, self.tolerance),
        };
        let message = match &self.name {
            Some(name) => format!("{name}: {pass}"),
            None => pass,
        };
        let due = |lines: &Arc<Mutex<Lines>>| {
            lines.lock().unwrap_or_else(PoisonError::into_inner).due(Instant::now())
        };
        if self.lines.as_ref().is_some_and(due) {
            eprintln!("{message}: {:.0} % done, {} s", 100.0 * done, self.bar.elapsed().as_secs());
        }
        self.bar.set_message(message);
    }

    /// Removes the bar from the terminal.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_work_is_told_of_until_it_ends() {
        let (said, heard) = channel();
        let working = Working::every(Duration::from_millis(5), move |gone| {
            let _ = said.send(gone);
        });
        let times: Vec<Duration> = heard.iter().take(3).collect();
        assert!(times.is_sorted() && times[0] >= Duration::from_millis(5), "{times:?}");
        drop(working);
        heard.try_iter().for_each(drop);
        assert!(heard.recv().is_err(), "no line follows");
    }

    #[test]
    fn short_work_is_not_told_of() {
        let (said, heard) = channel();
        drop(Working::every(Duration::from_secs(3600), move |gone| {
            let _ = said.send(gone);
        }));
        assert!(heard.recv().is_err());
    }

    #[test]
    fn lines_come_once_a_period() {
        let start = Instant::now();
        let mut lines = Lines { period: Duration::from_secs(10), last: start };
        let due = [1, 9, 10, 11, 19, 20, 45, 46].map(|s| lines.due(start + Duration::from_secs(s)));
        assert_eq!(due, [false, false, true, false, false, true, true, false]);
    }

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
