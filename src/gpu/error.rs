//! Everything that can go wrong on the way to a device and on it: one line each, with the way out.

use ash::prelude::VkResult;
use ash::vk;

use super::memory::Bytes;

/// What the loader or the allocator say.
type Source = Box<dyn std::error::Error + Send + Sync>;

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    #[error(
        "no Vulkan loader: {0}; install one (`apt install libvulkan1 mesa-vulkan-drivers` also brings a CPU device)"
    )]
    NoLoader(#[source] Source),
    #[error("no Vulkan device matches {wanted}; there is: {found}")]
    NoDevice { wanted: String, found: String },
    #[error("device \"{device}\" lacks {features}; choose another one (ANTIRAD_DEVICE) or update its driver")]
    MissingFeature { device: String, features: String },
    #[error(
        "validation is asked for but {0} is not there; install it (`apt install vulkan-validationlayers`) or unset ANTIRAD_VALIDATION"
    )]
    NoValidation(&'static str),
    #[error(
        "\"{label}\" needs {requested}, but {in_use} of the budget of {budget} are in use; raise the budget or reduce the job"
    )]
    OverBudget { label: String, requested: Bytes, in_use: Bytes, budget: Bytes },
    #[error("the driver refused {bytes} for \"{label}\": {source}; close other programs or lower the budget")]
    Allocation { label: String, bytes: Bytes, source: Source },
    #[error("buffer \"{label}\" of {bytes} is above the device's limit of {limit}; split it into pages")]
    BufferTooLarge { label: String, bytes: Bytes, limit: Bytes },
    #[error("bytes {offset}..{offset}+{bytes} are outside of \"{label}\", which has {size} bytes")]
    OutOfRange { label: String, offset: u64, bytes: u64, size: u64 },
    #[error("offset {offset} or length {bytes} in \"{label}\" is not a multiple of {alignment} bytes")]
    Misaligned { label: String, offset: u64, bytes: u64, alignment: u64 },
    #[error("a copy inside of \"{label}\" overlaps itself; copy through another buffer")]
    Overlap { label: String },
    #[error("\"{label}\" belongs to another device; create it on the one that uses it")]
    OtherDevice { label: String },
    #[error("kernel \"{kernel}\" got {given} {what}, it takes {wanted}")]
    WrongArguments { kernel: &'static str, what: &'static str, given: usize, wanted: usize },
    #[error(
        "kernel \"{kernel}\" has {bytes} bytes of push constants; the limit is {limit}, in multiples of 4: move some to a buffer"
    )]
    PushTooLarge { kernel: &'static str, bytes: u32, limit: u32 },
    #[error("kernel \"{kernel}\" binds {bindings} buffers, the device takes {limit}; put arrays together")]
    TooManyBindings { kernel: &'static str, bindings: u32, limit: u32 },
    #[error("kernel \"{kernel}\" needs subgroups of {wanted} lanes, the device offers {offered}")]
    SubgroupSize { kernel: &'static str, wanted: u32, offered: String },
    #[error(
        "kernel \"{kernel}\": {groups:?} workgroups are above the device's limit of {limit:?}; split the dispatch"
    )]
    TooManyGroups { kernel: &'static str, groups: [u32; 3], limit: [u32; 3] },
    #[error("the device did not answer for {seconds} s and is given up; make the dispatches shorter")]
    Timeout { seconds: u64 },
    #[error(
        "the device was lost while {0}: most often a dispatch ran into the system's GPU watchdog; make the dispatches shorter"
    )]
    DeviceLost(String),
    #[error("the driver failed while {what}: {result}")]
    Vulkan { what: String, result: String },
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
