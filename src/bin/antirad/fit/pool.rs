//! Several jobs at once, each with its part of the memory.

use antirad::backend::Backend;
use antirad::gpu::DeviceKind;
use std::str::FromStr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::Duration;

/// How many jobs run at once: `--parallel`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parallel {
    /// Enough jobs to keep host and device at work.
    Auto,
    /// This many at most.
    AtMost(usize),
}

impl FromStr for Parallel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            _ if text == "auto" => Ok(Self::Auto),
            Ok(jobs) if jobs > 0 => Ok(Self::AtMost(jobs)),
            _ => Err(String::from("expected auto, or a number of jobs from 1")),
        }
    }
}

/// Jobs at once on a GPU: while one is at work on the host, another uses the device.
const ON_A_GPU: usize = 2;

impl Parallel {
    /// Number of threads for `jobs` jobs on a backend.
    pub fn threads(self, jobs: usize, backend: &Backend) -> usize {
        self.threads_on(jobs, backend.vulkan().is_none_or(|device| device.info().kind == DeviceKind::Cpu))
    }

    fn threads_on(self, jobs: usize, cpu: bool) -> usize {
        let most = match self {
            Self::AtMost(most) => most,
            // A small job leaves cores idle between its steps: with three times as many jobs, 6 % of the time.
            Self::Auto if cpu => std::thread::available_parallelism().map_or(1, |cores| 3 * cores.get()),
            Self::Auto => ON_A_GPU,
        };
        most.min(jobs).max(1)
    }
}

/// Runs all `jobs` in threads, one for each of the `workers`, in order as threads become free. Calls `ended` in this
/// thread with index and result of each job, as soon as it has ended, together with those that ended while it was at work.
pub fn run<W: Send, J: Sync, R: Send>(
    workers: Vec<W>,
    jobs: &[J],
    work: impl Fn(&mut W, &J) -> R + Sync,
    mut ended: impl FnMut(Vec<(usize, R)>),
) {
    let next = AtomicUsize::new(0);
    let (send, results) = mpsc::channel();
    std::thread::scope(|scope| {
        for mut worker in workers {
            let (send, next, work) = (send.clone(), &next, &work);
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(job) = jobs.get(index) else { break };
                    if send.send((index, work(&mut worker, job))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(send);
        while let Ok(first) = results.recv() {
            ended(std::iter::once(first).chain(results.try_iter()).collect());
        }
    });
}

/// A memory budget that jobs share. They get their parts in the order in which they ask, so that small jobs do not keep
/// a large one waiting for ever.
pub struct Budget {
    total: u64,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    used: u64,
    /// Number of the next to ask, and of the next to be served.
    asked: u64,
    served: u64,
}

/// A part of a budget, given back when dropped.
pub struct Part<'a> {
    budget: &'a Budget,
    bytes: u64,
}

/// How often a waiting job looks whether to go on waiting.
const PERIOD: Duration = Duration::from_millis(100);

impl Budget {
    pub fn new(total: u64) -> Self {
        Self { total, state: Mutex::default(), changed: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until `bytes` are free, or all is if they are more than all. `None` once `cancelled` says so.
    pub fn take(&self, bytes: u64, cancelled: impl Fn() -> bool) -> Option<Part<'_>> {
        let bytes = bytes.min(self.total);
        let mut state = self.lock();
        let number = state.asked;
        state.asked += 1;
        while state.served != number || bytes > self.total - state.used {
            if cancelled() {
                // Those behind are to end as well, in whatever order they find out.
                return None;
            }
            let waited = self.changed.wait_timeout(state, PERIOD);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        state.served += 1;
        state.used += bytes;
        self.changed.notify_all();
        Some(Part { budget: self, bytes })
    }
}

impl Drop for Part<'_> {
    fn drop(&mut self) {
        self.budget.lock().used -= self.bytes;
        self.budget.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, AtomicU64};

    #[test]
    fn numbers_of_jobs() {
        assert_eq!("auto".parse(), Ok(Parallel::Auto));
        assert_eq!("3".parse(), Ok(Parallel::AtMost(3)));
        for text in ["", "0", "-1", "many", "1.5"] {
            assert!(text.parse::<Parallel>().is_err(), "{text}");
        }
        let (cpu, gpu) = (true, false);
        assert_eq!(Parallel::AtMost(3).threads_on(2, cpu), 2);
        assert_eq!(Parallel::AtMost(3).threads_on(9, gpu), 3);
        assert!(Parallel::Auto.threads_on(99, cpu) >= 2 && Parallel::Auto.threads_on(1, cpu) == 1);
        assert_eq!(Parallel::Auto.threads_on(99, gpu), 2);
    }

    #[test]
    fn every_job_runs_once_and_several_at_a_time() {
        let jobs: Vec<u64> = (0..100).collect();
        let (now, most) = (AtomicU64::new(0), AtomicU64::new(0));
        let mut results = vec![None; jobs.len()];
        let work = |done: &mut u64, job: &u64| {
            most.fetch_max(now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(1));
            now.fetch_sub(1, Ordering::SeqCst);
            *done += 1;
            2 * job
        };
        run(vec![0; 4], &jobs, work, |ended| {
            for (index, result) in ended {
                assert_eq!(results[index].replace(result), None);
            }
        });
        assert!(results.iter().zip(&jobs).all(|(result, job)| *result == Some(2 * job)), "{results:?}");
        assert!((2..=4).contains(&most.into_inner()));
    }

    /// What takes long after jobs, such as a page of all of them, is done once for those that have ended meanwhile.
    #[test]
    fn results_that_wait_come_together() {
        let (all, ended) = (AtomicU64::new(0), mpsc::channel());
        let work = |(): &mut (), (): &()| {
            all.fetch_add(1, Ordering::SeqCst);
        };
        run(vec![()], &[(); 50], work, |some| {
            ended.0.send(some.len()).expect("a receiver");
            // The last result is sent after its job is counted.
            while all.load(Ordering::SeqCst) < 50 {
                std::thread::yield_now();
            }
        });
        let calls: Vec<usize> = ended.1.try_iter().collect();
        assert_eq!(calls.iter().sum::<usize>(), 50);
        assert!(calls.len() <= 3, "{calls:?}");
    }

    /// Jobs of all sizes hold no more than the budget together, and all get their turn.
    #[test]
    fn parts_never_exceed_the_budget() {
        let budget = Budget::new(100);
        let (used, most) = (AtomicU64::new(0), AtomicU64::new(0));
        let sizes: Vec<u64> = (0..60).map(|k| [1, 40, 99, 100, 250][k % 5]).collect();
        let work = |(): &mut (), size: &u64| {
            let part = budget.take(*size, || false).expect("not cancelled");
            most.fetch_max(used.fetch_add(part.bytes, Ordering::SeqCst) + part.bytes, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(1));
            used.fetch_sub(part.bytes, Ordering::SeqCst);
        };
        let mut ended = 0;
        run(vec![(); 8], &sizes, work, |some| ended += some.len());
        assert_eq!((ended, most.into_inner(), budget.lock().used), (60, 100, 0));
    }

    /// A large job that waits is not overtaken by small ones that would fit.
    #[test]
    fn a_large_job_gets_its_turn() {
        let budget = Budget::new(100);
        let first = budget.take(50, || false).expect("free");
        let large_has_it = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let _part = budget.take(100, || false).expect("not cancelled");
                large_has_it.store(true, Ordering::SeqCst);
            });
            while budget.lock().asked < 2 {
                std::thread::yield_now();
            }
            scope.spawn(|| {
                let _part = budget.take(1, || false).expect("not cancelled");
                assert!(large_has_it.load(Ordering::SeqCst));
            });
            while budget.lock().asked < 3 {
                std::thread::yield_now();
            }
            drop(first);
        });
        let _held = budget.take(100, || false).expect("free");
        assert!(budget.take(1, || true).is_none());
    }
}
