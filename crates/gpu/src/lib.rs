//! Vulkan compute: devices, memory under a budget, buffers, pipelines, dispatches and their timing. It knows nothing of
//! light.
//!
//! The calls are safe as far as the host can check them: ranges, alignments, limits and lifetimes. What a kernel
//! reads and writes inside its buffers is the kernel's own responsibility.
#![warn(missing_docs)]
#![allow(unsafe_code, reason = "calls into Vulkan; only in this layer, each with its safety argument")]

mod buffer;
mod calls;
mod commands;
mod device;
pub mod embed;
mod error;
mod info;
mod instance;
mod kernel_cache;
mod memory;
mod pipeline;
mod recorder;
mod shader;
mod statistics;
mod survey;
mod transfer;
mod validation;
mod vectorised;

pub use antirad_base::usage::{ALIGN, Bytes, LabelReport, MemoryReport, OverBudget, ProfileRow, rounded};
pub use buffer::{Buffer, BufferKind, BufferSlice};
pub use commands::{Batch, BatchTiming};
pub use device::{Device, DeviceOptions};
pub use error::GpuError;
pub use info::{DeviceInfo, DeviceKind, Enabled, ListedDevice};
pub use pipeline::{Bindings, MAX_PUSH_BYTES, Pipeline};
pub use shader::Shader;
pub use statistics::KernelStatistics;
pub use survey::UNIFORM_BYTES;
pub use survey::{STORAGE_BUFFERS, WORKGROUP_LANES, list_devices};
pub use vectorised::{vector_instructions, vectorised};

pub use transfer::{STAGING_CHUNK, staging_bytes};
pub use validation::ValidationLog;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The result of calls into this layer.
pub type Result<T, E = GpuError> = std::result::Result<T, E>;

/// Ignores poisoning: a thread that panics while it holds a lock leaves counters and lists intact.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
