//! Signals that end the work: it stops at the next dispatch and leaves no half-written file.

use crate::Watch;
use signal_hook::consts::SIGINT;
use std::io;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;
#[cfg(unix)]
use std::time::Instant;

/// Grace period of work that watches the signal itself.
const GRACE: Duration = Duration::from_millis(400);
/// Signals within this time count as one: `timeout` signals its child and then the child's process group.
#[cfg(unix)]
const REPEAT: Duration = Duration::from_secs(2);

/// Set by the first Ctrl-C, SIGTERM or SIGHUP. Another one, two seconds later or more, ends the
/// process at once.
#[derive(Clone, Default)]
pub struct Interrupt {
    /// Number of the first signal; 0 if there was none.
    signal: Arc<AtomicUsize>,
}

impl Interrupt {
    /// Catches the signals of this process.
    pub fn catch() -> Self {
        let interrupt = Self::default();
        if let Err(error) = interrupt.listen() {
            tracing::warn!("Ctrl-C will end the program at once: {error}");
        }
        interrupt
    }

    #[cfg(unix)]
    fn listen(&self) -> io::Result<()> {
        use signal_hook::consts::{SIGHUP, SIGTERM};
        // Under `nohup` a process ignores the end of its terminal.
        let hangup = (!ignored(SIGHUP)).then_some(SIGHUP);
        let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM].into_iter().chain(hangup))?;
        let first = self.signal.clone();
        let handle = move || {
            let mut repeats = Repeats::default();
            for signal in signals.forever() {
                let number = signal.unsigned_abs() as usize;
                if repeats.insist(Instant::now()) {
                    std::process::exit(exit_code(number).into());
                }
                let _ = first.compare_exchange(0, number, Ordering::SeqCst, Ordering::SeqCst);
            }
        };
        std::thread::Builder::new().name(String::from("signals")).spawn(handle).map(drop)
    }

    #[cfg(not(unix))]
    fn listen(&self) -> io::Result<()> {
        use signal_hook::flag;
        let again = Arc::default();
        // In this order: the first Ctrl-C finds the flag clear, and sets it.
        flag::register_conditional_shutdown(SIGINT, super::EXIT_INTERRUPTED.into(), Arc::clone(&again))?;
        flag::register(SIGINT, again)?;
        flag::register_usize(SIGINT, self.signal.clone(), SIGINT.unsigned_abs() as usize).map(drop)
    }

    /// Whether a signal has arrived.
    pub fn is_set(&self) -> bool {
        self.signal.load(Ordering::SeqCst) != 0
    }

    /// The exit code that shells expect after the signal; after Ctrl-C if there was none.
    pub fn exit_code(&self) -> u8 {
        match self.signal.load(Ordering::SeqCst) {
            0 => super::EXIT_INTERRUPTED,
            number => exit_code(number),
        }
    }

    /// Runs work that does not check for interruption everywhere. The process ends soon after a signal, so the work
    /// must not write anything.
    pub fn while_computing<T>(&self, work: impl FnOnce() -> T) -> T {
        let (done, finished) = std::sync::mpsc::channel::<()>();
        let interrupt = self.clone();
        let watch = move || {
            while finished.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout) {
                // Work that can stop by itself gets the time to do so.
                if interrupt.is_set() && finished.recv_timeout(GRACE) == Err(RecvTimeoutError::Timeout) {
                    eprintln!("antirad: interrupted; nothing was written");
                    std::process::exit(interrupt.exit_code().into());
                }
            }
        };
        std::thread::spawn(watch);
        let result = work();
        drop(done);
        result
    }

    /// For what is asked now and then during long work.
    pub fn watch(&self) -> Watch {
        let asked = self.clone();
        Arc::new(move || asked.flow())
    }

    /// For the callbacks of long work.
    pub fn flow(&self) -> ControlFlow<()> {
        if self.is_set() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

fn exit_code(signal: usize) -> u8 {
    u8::try_from(128 + signal).unwrap_or(super::EXIT_INTERRUPTED)
}

/// Whether this process was started to ignore a signal; false if unknown.
#[cfg(unix)]
fn ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Distinguishes a repeated signal from one sent to insist.
#[cfg(unix)]
#[derive(Default)]
struct Repeats {
    first: Option<Instant>,
}

#[cfg(unix)]
impl Repeats {
    /// Whether a signal that comes now means that the process is to end at once.
    fn insist(&mut self, now: Instant) -> bool {
        now.duration_since(*self.first.get_or_insert(now)) >= REPEAT
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn signals_close_together_are_one() {
        let start = Instant::now();
        let mut repeats = Repeats::default();
        let mut insists = |ms| repeats.insist(start + Duration::from_millis(ms));
        for ms in [0, 1, 700, 1999] {
            assert!(!insists(ms), "after {ms} ms");
        }
        assert!(insists(2000) && insists(60_000));
    }
}
