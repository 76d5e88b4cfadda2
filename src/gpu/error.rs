//! Everything that can go wrong on the way to a device and on it: one line each, with the remedy.

use ash::prelude::VkResult;
use ash::vk;

use super::memory::Bytes;

/// What the loader or the allocator say.
type Source = Box<dyn std::error::Error + Send + Sync>;

/// Why something of this layer failed. The message says what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// The Vulkan loader cannot be loaded.
    #[error(
        "no Vulkan loader: {0}; install one (`apt install libvulkan1 mesa-vulkan-drivers` also brings a CPU device)"
    )]
    NoLoader(#[source] Source),
    /// No device matches the selector, or there is none at all.
    #[error("no Vulkan device matches {wanted}; there is: {found}")]
    NoDevice {
        /// What the caller asked for.
        wanted: String,
        /// Positions and names of the devices of this machine.
        found: String,
    },
    /// The device cannot run the kernels, or not in the precision that is asked for.
    #[error("device \"{device}\" lacks {features}; choose another one (ANTIRAD_DEVICE) or update its driver")]
    MissingFeature {
        /// Name of the device.
        device: String,
        /// What it lacks.
        features: String,
    },
    /// Validation is asked for and not installed.
    #[error(
        "validation is asked for but {0} is not there; install it (`apt install vulkan-validationlayers`) or unset ANTIRAD_VALIDATION"
    )]
    NoValidation(&'static str),
    /// The memory budget does not hold another buffer.
    #[error(
        "\"{label}\" needs {requested}, but {in_use} of the budget of {budget} are in use; raise the budget or reduce the job"
    )]
    OverBudget {
        /// Of the buffer.
        label: String,
        /// Size of the buffer.
        requested: Bytes,
        /// What all buffers take already.
        in_use: Bytes,
        /// What they may take.
        budget: Bytes,
    },
    /// The driver has no memory left, whatever the budget says.
    #[error("the driver refused {bytes} for \"{label}\": {source}; close other programs or lower the budget")]
    Allocation {
        /// Of the buffer.
        label: String,
        /// Size asked for.
        bytes: Bytes,
        /// What the allocator says.
        source: Source,
    },
    /// A buffer, or the part of it that is bound, is larger than kernels can see.
    #[error("buffer \"{label}\" of {bytes} is above the device's limit of {limit}; split it into pages")]
    BufferTooLarge {
        /// Of the buffer.
        label: String,
        /// Size asked for.
        bytes: Bytes,
        /// What the device allows.
        limit: Bytes,
    },
    /// A slice or a transfer goes beyond the end of its buffer.
    #[error("bytes {offset}..{offset}+{bytes} are outside of \"{label}\", which has {size} bytes")]
    OutOfRange {
        /// Of the buffer.
        label: String,
        /// Where it begins in the buffer, bytes.
        offset: u64,
        /// Its length.
        bytes: u64,
        /// Size of the buffer, bytes.
        size: u64,
    },
    /// A slice, copy or fill does not begin or end where it may.
    #[error("offset {offset} or length {bytes} in \"{label}\" is not a multiple of {alignment} bytes")]
    Misaligned {
        /// Of the buffer.
        label: String,
        /// Where it begins in the buffer, bytes.
        offset: u64,
        /// Its length; 0 where only the offset matters.
        bytes: u64,
        /// Multiples of so many bytes are allowed.
        alignment: u64,
    },
    /// Source and target of a copy overlap.
    #[error("a copy inside of \"{label}\" overlaps itself; copy through another buffer")]
    Overlap {
        /// Of the buffer.
        label: String,
    },
    /// An object was made on another device than the one that uses it.
    #[error("\"{label}\" belongs to another device; create it on the one that uses it")]
    OtherDevice {
        /// Of the buffer or kernel.
        label: String,
    },
    /// A dispatch does not fit its kernel.
    #[error("kernel \"{kernel}\" got {given} {what}, it takes {wanted}")]
    WrongArguments {
        /// Its name.
        kernel: &'static str,
        /// What was counted: buffers, or bytes of push constants.
        what: &'static str,
        /// How many the dispatch has.
        given: usize,
        /// How many the kernel takes.
        wanted: usize,
    },
    /// A kernel has too many push constants, or a length that is no multiple of 4.
    #[error(
        "kernel \"{kernel}\" has {bytes} bytes of push constants; the limit is {limit}, in multiples of 4: move some to a buffer"
    )]
    PushTooLarge {
        /// Its name.
        kernel: &'static str,
        /// Of the push constants.
        bytes: u32,
        /// What the device takes, bytes.
        limit: u32,
    },
    /// A kernel binds more buffers than the device allows.
    #[error("kernel \"{kernel}\" binds {bindings} buffers, the device takes {limit}; put arrays together")]
    TooManyBindings {
        /// Its name.
        kernel: &'static str,
        /// Storage and uniform buffers together.
        bindings: u32,
        /// What the device allows.
        limit: u32,
    },
    /// The device has no subgroups of the size that a kernel is written for.
    #[error("kernel \"{kernel}\" needs subgroups of {wanted} lanes, the device offers {offered}")]
    SubgroupSize {
        /// Its name.
        kernel: &'static str,
        /// Lanes that the kernel needs.
        wanted: u32,
        /// The sizes that the device has.
        offered: String,
    },
    /// A dispatch has more workgroups along an axis than the device allows.
    #[error(
        "kernel \"{kernel}\": {groups:?} workgroups are above the device's limit of {limit:?}; split the dispatch"
    )]
    TooManyGroups {
        /// Its name.
        kernel: &'static str,
        /// Along x, y and z.
        groups: [u32; 3],
        /// The same, of the device.
        limit: [u32; 3],
    },
    /// The device did not answer; from then on nothing is submitted to it.
    #[error("the device did not answer for {seconds} s and is given up; make the dispatches shorter")]
    Timeout {
        /// How long was waited.
        seconds: u64,
    },
    /// The device failed, or the driver reset it; it holds what was being done.
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
    /// What the validation layer found.
    #[error("Vulkan validation: {}", .0.join("; "))]
    Validation(Vec<String>),
}

/// Says in an error what was being done, for calls into the driver.
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
