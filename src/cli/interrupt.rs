//! Ctrl-C: work stops at the next dispatch, and nothing half-written stays behind.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

/// How long work that watches the signal itself has to end by itself.
const GRACE: Duration = Duration::from_millis(400);

/// Set by the first Ctrl-C (or SIGTERM); a second one ends the process on the spot.
#[derive(Clone, Default)]
pub struct Interrupt {
    set: Arc<AtomicBool>,
    /// By SIGTERM.
    terminated: Arc<AtomicBool>,
}

impl Interrupt {
    /// Catches the signals of this process.
    pub fn catch() -> Self {
        let interrupt = Self::default();
        let flag = interrupt.set.clone();
        let handler = move || {
            if flag.swap(true, Ordering::SeqCst) {
                std::process::exit(super::EXIT_INTERRUPTED.into());
            }
        };
        if let Err(error) = ctrlc::set_handler(handler) {
            tracing::warn!("Ctrl-C will end the program at once: {error}");
        }
        // After the handler above, which it calls: that one cannot tell the signals apart.
        #[cfg(unix)]
        if let Err(error) =
            signal_hook::flag::register(signal_hook::consts::SIGTERM, interrupt.terminated.clone())
        {
            tracing::debug!("SIGTERM will look like Ctrl-C: {error}");
        }
        interrupt
    }

    /// Whether the signal came.
    pub fn is_set(&self) -> bool {
        self.set.load(Ordering::SeqCst)
    }

    /// The exit code that shells expect after the signal.
    pub fn exit_code(&self) -> u8 {
        if self.terminated.load(Ordering::SeqCst) { super::EXIT_TERMINATED } else { super::EXIT_INTERRUPTED }
    }

    /// Does work that is not all interruptible by itself. Soon after the signal the process ends; so the work must not write
    /// anything.
    pub fn while_computing<T>(&self, work: impl FnOnce() -> T) -> T {
        let (done, finished) = std::sync::mpsc::channel::<()>();
        let interrupt = self.clone();
        let watch = move || {
            while finished.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout) {
                // What can stop by itself is given the time to.
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

    /// For the callbacks of long work.
    pub fn flow(&self) -> ControlFlow<()> {
        if self.is_set() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
