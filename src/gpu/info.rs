//! What a plan has to know of a device.

use crate::options::setters;

/// In the order of preference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum DeviceKind {
    /// A card with memory of its own.
    Discrete,
    /// Shares memory with the CPU.
    Integrated,
    /// Given to a virtual machine.
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

/// Optional capabilities that are switched on in a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Enabled {
    /// `shaderFloat64`: precision "f64" needs it.
    pub float64: bool,
    /// `subgroupSizeControl` of VK_EXT_subgroup_size_control: far kernels are as wide as subgroups.
    pub subgroup_size_control: bool,
    /// The instance extension VK_EXT_debug_utils: objects get names.
    pub debug_utils: bool,
}

setters!(Enabled { float64: bool, subgroup_size_control: bool, debug_utils: bool });

/// What a plan has to know of a device. Sizes in bytes.
#[derive(Clone, Debug, Default)]
pub struct DeviceInfo {
    /// Position in [`list_devices`](super::list_devices); 0 for an embedder's device.
    pub index: usize,
    /// As the driver says it.
    pub name: String,
    /// What sort of hardware it is.
    pub kind: DeviceKind,
    /// Name and version.
    pub driver: String,
    /// The newest version of Vulkan it knows: "1.3.255".
    pub api_version: String,
    /// What a kernel sees of a storage buffer at most.
    pub max_storage_buffer_range: u64,
    /// The largest piece of memory the driver gives at once.
    pub max_allocation: u64,
    /// The largest device-local heap.
    pub heap_bytes: u64,
    /// What VK_EXT_memory_budget leaves to this process, where there is that extension.
    pub available_bytes: Option<u64>,
    /// Of offsets of storage buffers: a power of two, 256 at most.
    pub storage_buffer_alignment: u64,
    /// Of offsets of uniform buffers. At most [`ALIGN`](super::ALIGN), which batches demand on every device.
    pub uniform_buffer_alignment: u64,
    /// What a kernel sees of a uniform buffer at most.
    pub max_uniform_buffer_range: u64,
    /// Storage buffers that one kernel can bind.
    pub max_storage_buffers: u32,
    /// Bytes of push constants that a kernel can have; at least [`MAX_PUSH_BYTES`](super::MAX_PUSH_BYTES) on every device.
    pub max_push_bytes: u32,
    /// Lanes of a subgroup, where a kernel does not ask for another size.
    pub subgroup_size: u32,
    /// Smallest and largest size that a kernel can require; both `subgroup_size` where it has no choice.
    pub subgroup_size_range: (u32, u32),
    /// Lanes of a workgroup at most.
    pub max_workgroup_invocations: u32,
    /// Workgroups of a dispatch along x, y and z at most.
    pub max_workgroup_count: [u32; 3],
    /// Memory that the lanes of a workgroup share, at most.
    pub shared_memory_bytes: u32,
    /// Nanoseconds a tick; 0: the device keeps no time and every timing is zero.
    pub timestamp_period_ns: f32,
    /// What the device can do; of a [`Device`](super::Device): what is switched on.
    pub enabled: Enabled,
}

/// A device, with all that keeps it from being used (nothing: it can be used).
#[derive(Clone, Debug)]
pub struct ListedDevice {
    /// What the device is.
    pub info: DeviceInfo,
    /// What it lacks, in words; empty where it can be used.
    pub missing: Vec<String>,
}
