//! What the host computes itself where the device is a CPU: its drivers read memory lane by lane, which takes several times
//! as long as what a compiler makes of the same loops. The same results but for rounding; `None` where the memory is not
//! shared.
#![allow(clippy::needless_range_loop, reason = "of loops over lanes by index compilers make vectors")]

mod close;
mod close_adjoint;
mod close_derivative;
pub mod clusters;
pub mod derivative;
mod exchanged;
pub mod far;
pub mod far_adjoint;
mod far_derivative;
pub mod lobes;
pub mod near_matrix;
mod pairs;
mod pieces;
mod real;
mod taps;
pub mod vectors;
pub mod volumes;

use rayon::ThreadPool;
use std::sync::OnceLock;

/// On threads of their own: others could take up work that waits for the device, which waits for this.
fn on_threads<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    static THREADS: OnceLock<Option<ThreadPool>> = OnceLock::new();
    let new = || rayon::ThreadPoolBuilder::new().thread_name(|k| format!("on-host-{k}")).build().ok();
    match THREADS.get_or_init(new) {
        Some(threads) => threads.install(work),
        // The system gives no more threads.
        None => work(),
    }
}
