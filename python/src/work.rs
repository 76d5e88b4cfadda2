//! Long work beside the interpreter: it runs on a thread of its own while the calling one waits without the GIL, handles
//! signals and reports progress.

use antirad::Watch;
use antirad::fit::Record;
use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Time between looks for signals.
const LOOK: Duration = Duration::from_millis(50);
/// Time that interrupted work has to end. What takes longer ends by itself, and nobody waits for it.
const GRACE: Duration = Duration::from_millis(600);

/// What a progress callback is called with.
#[derive(Clone, Copy, Debug)]
pub enum Report {
    /// Passes done, relative residual, share of the current pass.
    Solve(u32, f64, f64),
    /// Iteration of a fit.
    Fit(Record),
    /// Steps done, and of how many.
    Steps(usize, usize),
}

impl Report {
    fn call(self, callback: &Bound<PyAny>) -> PyResult<()> {
        match self {
            Self::Solve(passes, residual, share) => callback.call1((passes, residual, share)),
            Self::Fit(record) => callback.call1((record_dict(callback.py(), &record)?,)),
            Self::Steps(done, total) => callback.call1((done, total)),
        }
        .map(drop)
    }
}

/// An iteration of a fit as a dictionary.
pub fn record_dict<'py>(py: Python<'py>, record: &Record) -> PyResult<Bound<'py, PyDict>> {
    let Record { iteration, loss, gradient, step, evaluations, passes, first_stage } = *record;
    let dict = PyDict::new(py);
    dict.set_item("iteration", iteration)?;
    dict.set_item("loss", loss)?;
    dict.set_item("gradient", gradient)?;
    dict.set_item("step", step)?;
    dict.set_item("evaluations", evaluations)?;
    dict.set_item("passes", passes)?;
    dict.set_item("first_stage", first_stage)?;
    Ok(dict)
}

enum Event<T> {
    Report(Report),
    Done(T),
}

/// The side of the thread that works.
pub struct Link<T> {
    stop: Arc<AtomicBool>,
    events: Sender<Event<T>>,
}

impl<T: Send + 'static> Link<T> {
    /// `Break` once the work is no longer wanted.
    pub fn flow(&self) -> ControlFlow<()> {
        flow(&self.stop)
    }

    /// The same for the library.
    pub fn watch(&self) -> Watch {
        let stop = self.stop.clone();
        Arc::new(move || flow(&stop))
    }

    /// A function that reports progress, from any thread.
    pub fn reporter(&self) -> impl Fn(Report) + Send + Clone + 'static {
        // Nobody listens to abandoned work.
        let events = self.events.clone();
        move |report| drop(events.send(Event::Report(report)))
    }
}

fn flow(stop: &AtomicBool) -> ControlFlow<()> {
    if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// Runs `work` and returns its result; the exception of a signal's handler (KeyboardInterrupt) or of the callback ends it
/// earlier. Such work stops at the next look at its [`Link`]; if that takes long it goes on for nothing, in the background.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    callback: Option<Bound<'_, PyAny>>,
    work: impl FnOnce(&Link<T>) -> T + Send + 'static,
) -> PyResult<T> {
    let (sender, events) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let link = Link { stop: stop.clone(), events: sender.clone() };
    let worker = thread::Builder::new().name(String::from("antirad")).spawn(move || {
        let result = work(&link);
        drop(sender.send(Event::Done(result)));
    })?;
    // `Receiver` may move to another thread but not be shared, which `detach` asks for.
    let events = Mutex::new(events);
    loop {
        let interrupted = match py.detach(|| receive(&events, LOOK)) {
            Ok(Event::Done(result)) => return Ok(result),
            Ok(Event::Report(report)) => callback.as_ref().map_or(Ok(()), |callback| report.call(callback)),
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => match worker.join() {
                Err(panic) => resume_unwind(panic),
                Ok(()) => unreachable!("a worker sends its result"),
            },
        }
        .and_then(|()| py.check_signals());
        if let Err(exception) = interrupted {
            stop.store(true, Ordering::Relaxed);
            py.detach(|| {
                let end = Instant::now() + GRACE;
                while let Ok(Event::Report(_)) =
                    receive(&events, end.saturating_duration_since(Instant::now()))
                {}
            });
            return Err(exception);
        }
    }
}

fn receive<T>(events: &Mutex<Receiver<T>>, within: Duration) -> Result<T, RecvTimeoutError> {
    events.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(within)
}

/// A progress callback from an argument: a callable, `True` for a bar of tqdm, or nothing. `bar`: the name of the function
/// of `antirad._progress` that makes the bar, and its argument.
pub fn callback<'py>(
    py: Python<'py>,
    asked: Option<Bound<'py, PyAny>>,
    bar: &str,
    argument: impl IntoPyObjectExt<'py>,
) -> PyResult<Option<Bound<'py, PyAny>>> {
    match asked {
        Some(asked) if asked.is_callable() => Ok(Some(asked)),
        Some(asked) if asked.is_truthy()? => {
            let argument = argument.into_bound_py_any(py)?;
            Ok(Some(py.import("antirad._progress")?.call_method1(bar, (argument,))?))
        }
        _ => Ok(None),
    }
}
