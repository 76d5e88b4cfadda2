//! What a plan has to know of a device.

use crate::options::setters;

/// In the order of preference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum DeviceKind {
    Discrete,
    Integrated,
    Virtual,
    Cpu,
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
    pub name: String,
    pub kind: DeviceKind,
    pub driver: String,
    pub api_version: String,
    pub max_storage_buffer_range: u64,
    pub max_allocation: u64,
    /// The largest device-local heap.
    pub heap_bytes: u64,
    /// What VK_EXT_memory_budget leaves to this process, where there is that extension.
    pub available_bytes: Option<u64>,
    pub storage_buffer_alignment: u64,
    /// Of offsets of uniform buffers. At most [`ALIGN`](super::ALIGN), which batches demand on every device.
    pub uniform_buffer_alignment: u64,
    /// What a kernel sees of a uniform buffer at most.
    pub max_uniform_buffer_range: u64,
    /// Storage buffers that one kernel can bind.
    pub max_storage_buffers: u32,
    pub max_push_bytes: u32,
    pub subgroup_size: u32,
    /// Smallest and largest size that a kernel can require; both `subgroup_size` where it has no choice.
    pub subgroup_size_range: (u32, u32),
    pub max_workgroup_invocations: u32,
    pub max_workgroup_count: [u32; 3],
    pub shared_memory_bytes: u32,
    /// Nanoseconds a tick; 0: the device keeps no time and every timing is zero.
    pub timestamp_period_ns: f32,
    /// What the device can do; of a [`Device`](super::Device): what is switched on.
    pub enabled: Enabled,
}

/// A device, with all that keeps it from being used (nothing: it can be used).
#[derive(Clone, Debug)]
pub struct ListedDevice {
    pub info: DeviceInfo,
    pub missing: Vec<String>,
}
