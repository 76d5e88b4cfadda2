//! The errors of this layer: one line each, with the remedy.

use ash::prelude::VkResult;
use ash::vk;

use antirad_base::usage::{Bytes, OverBudget};

/// An error of the Vulkan loader or of the allocator.
type Source = Box<dyn std::error::Error + Send + Sync>;

/// An error of this layer. The message names the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// A watch stopped the work before a kernel was compiled: see [`Device::with_watch`](super::Device::with_watch).
    #[error("interrupted")]
    Interrupted,
    /// The Vulkan loader cannot be loaded.
    #[error(
        "no Vulkan loader: {0}; install one (`apt install libvulkan1 mesa-vulkan-drivers` also brings a CPU device)"
    )]
    NoLoader(#[source] Source),
    /// No device matches the selector, or there is none at all.
    #[error("no Vulkan device matches {wanted}; available: {found}")]
    NoDevice {
        /// The selector.
        wanted: String,
        /// Positions and names of the devices of this machine.
        found: String,
    },
    /// The device cannot run the kernels, or not in the requested precision.
    #[error("device \"{device}\" lacks {features}; choose another one (ANTIRAD_DEVICE) or update its driver")]
    MissingFeature {
        /// Name of the device.
        device: String,
        /// The features that it lacks.
        features: String,
    },
    /// Validation is requested but not installed.
    #[error(
        "validation is requested but {0} is missing; install it (`apt install vulkan-validationlayers`) or unset ANTIRAD_VALIDATION"
    )]
    NoValidation(&'static str),
    /// The memory budget does not hold another buffer.
    #[error(transparent)]
    OverBudget(#[from] OverBudget),
    /// The driver has no memory left, whatever the budget says.
    #[error("the driver refused {bytes} for \"{label}\": {source}; close other programs or lower the budget")]
    Allocation {
        /// Label of the buffer.
        label: String,
        /// Requested size.
        bytes: Bytes,
        /// The allocator's error.
        source: Source,
    },
    /// A buffer, or the range of it that is bound, is larger than a kernel can bind.
    #[error("buffer \"{label}\" of {bytes} exceeds the device's limit of {limit}; split it into pages")]
    #[doc(hidden)]
    BufferTooLarge {
        /// Label of the buffer.
        label: String,
        /// Requested size.
        bytes: Bytes,
        /// The device's limit.
        limit: Bytes,
    },
    /// A slice or a transfer goes beyond the end of its buffer.
    #[error("bytes {offset}..{offset}+{bytes} are outside \"{label}\", which has {size} bytes")]
    #[doc(hidden)]
    OutOfRange {
        /// Label of the buffer.
        label: String,
        /// Offset in the buffer, bytes.
        offset: u64,
        /// Length of the slice or transfer, bytes.
        bytes: u64,
        /// Size of the buffer, bytes.
        size: u64,
    },
    /// A slice, copy or fill is not aligned.
    #[error("offset {offset} or length {bytes} in \"{label}\" is not a multiple of {alignment} bytes")]
    #[doc(hidden)]
    Misaligned {
        /// Label of the buffer.
        label: String,
        /// Offset in the buffer, bytes.
        offset: u64,
        /// Length of the slice, copy or fill, bytes; 0 where only the offset matters.
        bytes: u64,
        /// The required alignment, bytes.
        alignment: u64,
    },
    /// Source and target of a copy overlap.
    #[error("a copy within \"{label}\" overlaps itself; copy through another buffer")]
    #[doc(hidden)]
    Overlap {
        /// Label of the buffer.
        label: String,
    },
    /// An object was made on another device than the one that uses it.
    #[error("\"{label}\" belongs to another device; create it on the one that uses it")]
    #[doc(hidden)]
    OtherDevice {
        /// Label of the buffer, or name of the kernel.
        label: String,
    },
    /// A dispatch does not fit its kernel.
    #[error("kernel \"{kernel}\" got {given} {what}, it takes {wanted}")]
    #[doc(hidden)]
    WrongArguments {
        /// Name of the kernel.
        kernel: &'static str,
        /// What is counted: buffers, or bytes of push constants.
        what: &'static str,
        /// Number in the dispatch.
        given: usize,
        /// Number that the kernel takes.
        wanted: usize,
    },
    /// The push constants of a kernel are too long, or their length is not a multiple of 4.
    #[error(
        "kernel \"{kernel}\" has {bytes} bytes of push constants; the limit is {limit}, in multiples of 4: move some to a buffer"
    )]
    #[doc(hidden)]
    PushTooLarge {
        /// Name of the kernel.
        kernel: &'static str,
        /// Length of the push constants.
        bytes: u32,
        /// The device's limit, bytes.
        limit: u32,
    },
    /// A kernel binds more buffers than the device allows.
    #[error("kernel \"{kernel}\" binds {bindings} buffers, the device takes {limit}; merge arrays")]
    #[doc(hidden)]
    TooManyBindings {
        /// Name of the kernel.
        kernel: &'static str,
        /// Storage and uniform buffers together.
        bindings: u32,
        /// The device's limit.
        limit: u32,
    },
    /// A dispatch has more workgroups along an axis than the device allows.
    #[error(
        "kernel \"{kernel}\": {groups:?} workgroups exceed the device's limit of {limit:?}; split the dispatch"
    )]
    #[doc(hidden)]
    TooManyGroups {
        /// Name of the kernel.
        kernel: &'static str,
        /// Workgroups along x, y and z.
        groups: [u32; 3],
        /// The device's limits along x, y and z.
        limit: [u32; 3],
    },
    /// The device did not respond. Nothing is submitted to it from then on.
    #[error("the device did not respond for {seconds} s and is no longer used; make the dispatches shorter")]
    Timeout {
        /// How long the host waited, s.
        seconds: u64,
    },
    /// The device failed, or the driver reset it. Holds what was being done.
    #[error(
        "the device was lost while {0}: most often a dispatch ran into the system's GPU watchdog; make the dispatches shorter"
    )]
    DeviceLost(String),
    /// A call into the driver failed in another way.
    #[error("the driver failed while {what}: {result}")]
    Vulkan {
        /// What was being done.
        what: String,
        /// What the driver returned.
        result: String,
    },
    /// Messages of the validation layer.
    #[error("Vulkan validation: {}", .0.join("; "))]
    Validation(Vec<String>),
}

impl GpuError {
    /// Whether the same calls may succeed at another time or on another device: the driver failed, or other programs
    /// hold its memory.
    pub fn may_pass(&self) -> bool {
        matches!(
            self,
            Self::DeviceLost(_)
                | Self::Timeout { .. }
                | Self::Allocation { .. }
                | Self::Vulkan { .. }
                | Self::Interrupted
        )
    }
}

/// Adds to the error of a driver call what was being done.
pub(super) trait During<T> {
    /// `action` completes "the driver failed while …", `label` is what it was done to.
    fn during(self, action: &str, label: &str) -> Result<T, GpuError>;
}

impl<T> During<T> for VkResult<T> {
    fn during(self, action: &str, label: &str) -> Result<T, GpuError> {
        self.map_err(|result| {
            let what = format!("{action} \"{label}\"");
            match result {
                vk::Result::ERROR_DEVICE_LOST => GpuError::DeviceLost(what),
                result => GpuError::Vulkan { what, result: result.to_string() },
            }
        })
    }
}
