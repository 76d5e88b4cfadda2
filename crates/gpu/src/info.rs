//! Properties of a device that a plan depends on.

use antirad_base::setters;

/// Kinds of devices, in order of preference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum DeviceKind {
    /// A GPU with memory of its own.
    Discrete,
    /// Shares memory with the CPU.
    Integrated,
    /// A GPU given to a virtual machine.
    Virtual,
    /// A driver that computes on the CPU (lavapipe).
    Cpu,
    /// The driver does not say.
    #[default]
    Other,
}

impl std::fmt::Display for DeviceKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Cpu => "CPU",
            Self::Other => "other",
        })
    }
}

/// Optional capabilities that are enabled on a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Enabled {
    /// `shaderFloat64`: precision "f64" needs it.
    pub float64: bool,
    /// The instance extension VK_EXT_debug_utils: objects get names.
    pub debug_utils: bool,
    /// `pipelineExecutableInfo` of VK_KHR_pipeline_executable_properties: the driver tells of kernels as it compiles them.
    pub statistics: bool,
}

setters!(Enabled { float64: bool, debug_utils: bool, statistics: bool });

/// Properties of a device that a plan depends on. Sizes in bytes.
#[derive(Clone, Debug, Default)]
pub struct DeviceInfo {
    /// Index in [`list_devices`](super::list_devices); 0 for an embedder's device.
    pub index: usize,
    /// Name, as reported by the driver.
    pub name: String,
    /// Kind of hardware.
    pub kind: DeviceKind,
    /// Name and version of the driver.
    pub driver: String,
    /// Newest version of Vulkan that it supports, e.g. "1.3.255".
    pub api_version: String,
    /// Largest range of a storage buffer that a kernel can bind.
    #[doc(hidden)]
    pub max_storage_buffer_range: u64,
    /// Largest single allocation.
    #[doc(hidden)]
    pub max_allocation: u64,
    /// Largest buffer that can be made, where the device says so (VK_KHR_maintenance4).
    #[doc(hidden)]
    pub max_buffer: Option<u64>,
    /// The largest device-local heap.
    pub heap_bytes: u64,
    /// What VK_EXT_memory_budget leaves to this process, if the extension is supported.
    #[doc(hidden)]
    pub available_bytes: Option<u64>,
    /// Required alignment of storage buffer offsets: a power of two, 256 at most.
    #[doc(hidden)]
    pub storage_buffer_alignment: u64,
    /// Required alignment of uniform buffer offsets. At most [`ALIGN`](super::ALIGN), which batches always require.
    #[doc(hidden)]
    pub uniform_buffer_alignment: u64,
    /// Largest range of a uniform buffer that a kernel can bind.
    #[doc(hidden)]
    pub max_uniform_buffer_range: u64,
    /// Maximum number of storage buffers that one kernel can bind.
    #[doc(hidden)]
    pub max_storage_buffers: u32,
    /// Bytes of push constants that a kernel can have; at least [`MAX_PUSH_BYTES`](super::MAX_PUSH_BYTES) on every
    /// device.
    #[doc(hidden)]
    pub max_push_bytes: u32,
    /// Lanes of a subgroup. Kernels work with any number; their workgroups are as wide.
    #[doc(hidden)]
    pub subgroup_size: u32,
    /// Maximum number of lanes of a workgroup.
    #[doc(hidden)]
    pub max_workgroup_invocations: u32,
    /// Maximum number of workgroups of a dispatch along x, y and z.
    #[doc(hidden)]
    pub max_workgroup_count: [u32; 3],
    /// Maximum memory that the lanes of a workgroup can share.
    #[doc(hidden)]
    pub shared_memory_bytes: u32,
    /// Nanoseconds per tick; 0 if the device has no timestamps, so that every timing is zero.
    #[doc(hidden)]
    pub timestamp_period_ns: f32,
    /// Supported capabilities; of a [`Device`](super::Device), those enabled.
    pub enabled: Enabled,
}

impl DeviceInfo {
    /// Bytes of the largest buffer that can be made, has memory, and can be bound to a kernel as a whole.
    #[doc(hidden)]
    pub fn largest_buffer(&self) -> u64 {
        let bound = self.max_storage_buffer_range.min(self.max_allocation);
        self.max_buffer.map_or(bound, |made| made.min(bound))
    }
}

/// A device, and what keeps it from being used.
#[derive(Clone, Debug)]
pub struct ListedDevice {
    /// Properties of the device.
    pub info: DeviceInfo,
    /// What it lacks, in words; empty if it can be used.
    pub missing: Vec<String>,
}
