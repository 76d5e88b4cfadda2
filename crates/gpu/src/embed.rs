//! Use of a device that the embedding program opened.

use ash::vk;

/// The Vulkan bindings whose handles this API takes, in the version it uses.
pub use ash;

use super::Result;
use super::device::{Device, Logical};
use super::info::Enabled;
use super::instance::Instance;
use super::survey::Candidate;

/// A Vulkan 1.2 device that the embedder opened and continues to own. It must have been created with the feature
/// `scalarBlockLayout`.
#[derive(Clone)]
pub struct RawDevice {
    /// The loaded Vulkan library.
    pub entry: ash::Entry,
    /// The instance from which the device was opened.
    pub instance: ash::Instance,
    /// The physical device.
    pub physical_device: vk::PhysicalDevice,
    /// The logical device.
    pub device: ash::Device,
    /// Family of `queue`; it must support compute.
    pub queue_family: u32,
    /// The queue to which all work is submitted.
    pub queue: vk::Queue,
    /// The optional features and extensions that `device` was created with; `Enabled::default()` for none.
    pub enabled: Enabled,
    /// Budget of all buffers, bytes, as for [`DeviceOptions`](super::DeviceOptions::memory_budget).
    pub memory_budget: Option<u64>,
}

impl Device {
    /// Uses an embedder's device. Dropping the result, with the last of its clones and of what was made from it,
    /// destroys only what this library made.
    ///
    /// # Safety
    /// - The handles are alive, belong together, and outlive the result and all that is made from it.
    /// - The device was created for Vulkan 1.2, with `scalarBlockLayout` and with `enabled`.
    /// - Nobody else uses `queue` during a call into this library.
    ///
    /// # Errors
    /// Fails if the device lacks a required feature, or if a call into it fails.
    pub unsafe fn from_raw(raw: RawDevice) -> Result<Self> {
        let RawDevice { entry, instance, physical_device, device, queue_family, queue, .. } = raw;
        let instance = Instance::borrowed(entry, instance, raw.enabled.debug_utils);
        let candidate = Candidate::new(&instance, physical_device, Some(queue_family))?;
        candidate.usable()?;
        let logical = Logical { raw: device, validates: false, owned: false };
        Self::assemble(instance, logical, candidate, queue, raw.enabled, raw.memory_budget, None)
    }
}
