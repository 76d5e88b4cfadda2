//! Vulkan compute: devices, memory under a budget, buffers, pipelines, dispatches and their timing. It knows nothing of
//! light.
//!
//! ```no_run
//! use antirad::gpu::{Buffer, BufferKind, Device, DeviceOptions, Pipeline};
//! use antirad::scene::Precision;
//! use antirad::shaders;
//!
//! # fn main() -> Result<(), antirad::gpu::GpuError> {
//! let device = Device::new(&DeviceOptions::default())?;
//! let x = Buffer::new(&device, "x", 4096, BufferKind::Storage)?;
//! let y = Buffer::new(&device, "y", 4096, BufferKind::Storage)?;
//! device.upload_slice(&x, 0, &[1.0f32; 1024])?;
//! device.upload_slice(&y, 0, &[2.0f32; 1024])?;
//!
//! let combine = Pipeline::new(&device, shaders::COMBINE.of(Precision::F32), 2, 12, &[])?;
//! let (count, a, b) = (1024u32, 3.0f32, 1.0f32);
//! let push = [count.to_ne_bytes(), a.to_ne_bytes(), b.to_ne_bytes()].concat();
//! let mut batch = device.batch()?;
//! batch.dispatch(&combine, "1024", &[x.whole(), y.whole()], &push, [16, 1, 1])?;
//! batch.submit()?;
//! assert_eq!(device.download_slice::<f32>(&y, 0, 1)?, [5.0]);
//! # Ok(())
//! # }
//! ```
//!
//! The calls are safe as far as the host can check them: ranges, alignments, limits and lifetimes. What a kernel
//! reads and writes inside its buffers is the kernel's own responsibility.
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

pub use crate::usage::{ALIGN, Bytes, LabelReport, MemoryReport, OverBudget, ProfileRow, rounded};
pub use buffer::{Buffer, BufferKind, BufferSlice};
pub use commands::{Batch, BatchTiming};
pub use device::{Device, DeviceOptions};
pub use error::GpuError;
pub use info::{DeviceInfo, DeviceKind, Enabled, ListedDevice};
pub use pipeline::{Bindings, MAX_PUSH_BYTES, Pipeline};
pub use shader::Shader;
pub use statistics::KernelStatistics;
pub(crate) use survey::UNIFORM_BYTES;
pub use survey::{STORAGE_BUFFERS, WORKGROUP_LANES, list_devices};
pub(crate) use vectorised::{vector_instructions, vectorised};

pub use transfer::{STAGING_CHUNK, staging_bytes};
pub use validation::ValidationLog;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The result of calls into this layer.
pub type Result<T, E = GpuError> = std::result::Result<T, E>;

/// Ignores poisoning: a thread that panics while it holds a lock leaves counters and lists intact.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
