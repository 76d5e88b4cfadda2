//! The devices of this machine: their properties, what they lack, and the choice among them.

use std::ffi::CStr;

use ash::{ext, khr, vk};

use super::Result;
use super::error::{During, GpuError};
use super::info::{DeviceInfo, DeviceKind, Enabled, ListedDevice};
use super::instance::Instance;
use antirad_base::usage::ALIGN;

/// Vulkan 1.2: the SPIR-V 1.5 that the kernels are compiled to.
pub(super) const API_VERSION: u32 = vk::API_VERSION_1_2;

/// The devices of this machine, best first: an index into this list selects a device.
///
/// # Errors
/// Fails if there is no Vulkan driver, or if a call into it fails.
pub fn list_devices() -> Result<Vec<ListedDevice>> {
    let instance = Instance::new(false)?;
    let found = survey(&instance)?;
    Ok(found.into_iter().map(|Candidate { listed, .. }| listed).collect())
}

/// A physical device with what is needed to open it.
pub(super) struct Candidate {
    pub(super) physical: vk::PhysicalDevice,
    pub(super) listed: ListedDevice,
    pub(super) extensions: Vec<vk::ExtensionProperties>,
    pub(super) queue_family: u32,
    pub(super) timestamp_bits: u32,
}

pub(super) fn no_driver() -> GpuError {
    GpuError::NoDevice {
        wanted: "any selector".into(),
        found: "none; install a Vulkan driver (`apt install mesa-vulkan-drivers` brings a CPU device)".into(),
    }
}

pub(super) fn has_extension(extensions: &[vk::ExtensionProperties], name: &CStr) -> bool {
    extensions.iter().any(|extension| extension.extension_name_as_c_str() == Ok(name))
}

pub(super) fn survey(instance: &Instance) -> Result<Vec<Candidate>> {
    // SAFETY: the instance is alive.
    let devices = unsafe { instance.raw().enumerate_physical_devices() }
        .during("listing the devices of", "instance")?;
    let mut found = Vec::with_capacity(devices.len());
    for physical in devices {
        found.push(Candidate::new(instance, physical, None)?);
    }
    // Stable: devices of one kind stay in the driver's order.
    found.sort_by_key(|candidate| candidate.listed.info.kind);
    for (index, candidate) in found.iter_mut().enumerate() {
        candidate.listed.info.index = index;
    }
    Ok(found)
}

/// The device that `selector` names (an index, or a piece of the name, ignoring case), or the best usable
/// one.
pub(super) fn choose(mut found: Vec<Candidate>, selector: Option<&str>) -> Result<Candidate> {
    let position = match selector {
        None => found.iter().position(|candidate| candidate.listed.missing.is_empty()).or(
            // If all lack something, the error says what the best one lacks.
            (!found.is_empty()).then_some(0),
        ),
        Some(text) => match text.trim().parse::<usize>() {
            Ok(index) => (index < found.len()).then_some(index),
            Err(_) => {
                let part = text.trim().to_lowercase();
                let matches =
                    |candidate: &Candidate| candidate.listed.info.name.to_lowercase().contains(&part);
                found.iter().position(matches)
            }
        },
    };
    let Some(position) = position else {
        let Some(selector) = selector else {
            return Err(no_driver());
        };
        let names = found.iter().map(|Candidate { listed: ListedDevice { info, .. }, .. }| {
            format!("{} \"{}\"", info.index, info.name)
        });
        let names: Vec<_> = names.collect();
        let found = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        return Err(GpuError::NoDevice { wanted: format!("\"{selector}\""), found });
    };
    let candidate = found.swap_remove(position);
    candidate.usable()?;
    Ok(candidate)
}

/// Uniform buffer range that kernels need; common devices offer at least this.
pub const UNIFORM_BYTES: u32 = 1 << 16;

/// Most storage buffers that one of our kernels binds; Vulkan promises 4.
pub const STORAGE_BUFFERS: u32 = 11;
/// Lanes of the largest workgroup of our kernels; Vulkan promises 128.
pub const WORKGROUP_LANES: u32 = 256;

impl Candidate {
    /// `queue_family`: the one to examine, else the first that supports compute.
    pub(super) fn new(
        instance: &Instance,
        physical: vk::PhysicalDevice,
        queue_family: Option<u32>,
    ) -> Result<Self> {
        let raw = instance.raw();
        // SAFETY: `physical` is a device of this living instance, here and in the queries below.
        let core = unsafe { raw.get_physical_device_properties(physical) };
        let name = core.device_name_as_c_str().unwrap_or(c"unnamed").to_string_lossy().into_owned();
        // SAFETY: as above.
        let extensions = unsafe { raw.enumerate_device_extension_properties(physical) }
            .during("listing the extensions of", &name)?;
        // SAFETY: as above.
        let families = unsafe { raw.get_physical_device_queue_family_properties(physical) };

        let mut missing = Vec::new();
        let computes = |family: &vk::QueueFamilyProperties| {
            family.queue_count > 0 && family.queue_flags.contains(vk::QueueFlags::COMPUTE)
        };
        let chosen = match queue_family {
            Some(index) => families.get(index as usize).filter(|family| computes(family)).map(|_| index),
            None => families.iter().position(computes).and_then(|index| u32::try_from(index).ok()),
        };
        if chosen.is_none() {
            missing.push("a compute queue".to_owned());
        }
        let queue_family = chosen.unwrap_or_default();
        let timestamp_bits =
            families.get(queue_family as usize).map_or(0, |family| family.timestamp_valid_bits);

        let mut info = from_core(&core, name);
        info.heap_bytes = largest_heap(instance, physical).1;
        if core.api_version < API_VERSION {
            missing.push(format!("Vulkan 1.2 (it has {})", info.api_version));
        } else {
            missing.extend(from_extended(instance, physical, &extensions, &mut info));
        }
        if core.limits.max_uniform_buffer_range < UNIFORM_BYTES {
            missing.push(format!("uniform buffers of {UNIFORM_BYTES} bytes"));
        }
        if info.max_storage_buffers < STORAGE_BUFFERS {
            missing.push(format!("{STORAGE_BUFFERS} storage buffers in a kernel"));
        }
        if info.max_workgroup_invocations < WORKGROUP_LANES {
            missing.push(format!("workgroups of {WORKGROUP_LANES} lanes"));
        }
        if info.uniform_buffer_alignment > ALIGN {
            // A violation of the specification.
            missing.push(format!("uniform buffers at multiples of {ALIGN} bytes"));
        }
        if timestamp_bits == 0 {
            info.timestamp_period_ns = 0.0;
        }
        let listed = ListedDevice { info, missing };
        Ok(Self { physical, listed, extensions, queue_family, timestamp_bits })
    }

    pub(super) fn usable(&self) -> Result<()> {
        let ListedDevice { info, missing } = &self.listed;
        if missing.is_empty() {
            return Ok(());
        }
        Err(GpuError::MissingFeature { device: info.name.clone(), features: missing.join(", ") })
    }
}

/// Properties that every Vulkan device reports.
fn from_core(core: &vk::PhysicalDeviceProperties, name: String) -> DeviceInfo {
    let limits = &core.limits;
    let version = core.api_version;
    DeviceInfo {
        name,
        kind: match core.device_type {
            vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::Discrete,
            vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::Integrated,
            vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::Virtual,
            vk::PhysicalDeviceType::CPU => DeviceKind::Cpu,
            _ => DeviceKind::Other,
        },
        api_version: format!(
            "{}.{}.{}",
            vk::api_version_major(version),
            vk::api_version_minor(version),
            vk::api_version_patch(version)
        ),
        max_storage_buffer_range: u64::from(limits.max_storage_buffer_range),
        storage_buffer_alignment: limits.min_storage_buffer_offset_alignment.max(1),
        uniform_buffer_alignment: limits.min_uniform_buffer_offset_alignment.max(1),
        max_uniform_buffer_range: u64::from(limits.max_uniform_buffer_range),
        max_storage_buffers: limits
            .max_per_stage_descriptor_storage_buffers
            .min(limits.max_descriptor_set_storage_buffers),
        max_push_bytes: limits.max_push_constants_size,
        max_workgroup_invocations: limits.max_compute_work_group_invocations,
        max_workgroup_count: limits.max_compute_work_group_count,
        shared_memory_bytes: limits.max_compute_shared_memory_size,
        timestamp_period_ns: limits.timestamp_period,
        ..DeviceInfo::default()
    }
}

/// Adds what a device of Vulkan 1.2 reports; returns what it lacks.
fn from_extended(
    instance: &Instance,
    physical: vk::PhysicalDevice,
    extensions: &[vk::ExtensionProperties],
    info: &mut DeviceInfo,
) -> Vec<String> {
    let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut allocation = vk::PhysicalDeviceMaintenance3Properties::default();
    let mut made = vk::PhysicalDeviceMaintenance4Properties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default()
        .push_next(&mut subgroup)
        .push_next(&mut driver)
        .push_next(&mut allocation);
    if has_extension(extensions, khr::maintenance4::NAME) {
        properties = properties.push_next(&mut made);
    }
    let mut told = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default();
    let mut layout = vk::PhysicalDeviceScalarBlockLayoutFeatures::default();
    let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut layout);
    if has_extension(extensions, khr::pipeline_executable_properties::NAME) {
        features = features.push_next(&mut told);
    }
    // SAFETY: a device of at least Vulkan 1.2; the chained structures belong to it or to extensions that it lists.
    let core = unsafe {
        instance.raw().get_physical_device_properties2(physical, &mut properties);
        instance.raw().get_physical_device_features2(physical, &mut features);
        features.features
    };

    let text = |text: Result<&CStr, _>| text.unwrap_or_default().to_string_lossy().into_owned();
    info.driver = format!(
        "{} {}",
        text(driver.driver_name_as_c_str().map_err(|_| ())),
        text(driver.driver_info_as_c_str().map_err(|_| ()))
    );
    info.max_allocation = allocation.max_memory_allocation_size;
    info.max_buffer = Some(made.max_buffer_size).filter(|bytes| *bytes > 0);
    info.subgroup_size = subgroup.subgroup_size;
    info.enabled = Enabled {
        float64: core.shader_float64 == vk::TRUE,
        debug_utils: instance.debug_utils(),
        statistics: told.pipeline_executable_info == vk::TRUE,
    };
    info.available_bytes = available_bytes(instance, physical, extensions);
    let needs = [(layout.scalar_block_layout == vk::TRUE, "scalarBlockLayout")];
    needs.into_iter().filter(|(there, _)| !there).map(|(_, what)| what.to_owned()).collect()
}

/// Index and size of the largest device-local heap.
fn largest_heap(instance: &Instance, physical: vk::PhysicalDevice) -> (usize, u64) {
    // SAFETY: `physical` is a device of this living instance.
    let memory = unsafe { instance.raw().get_physical_device_memory_properties(physical) };
    let local = memory.memory_heaps_as_slice().iter().enumerate();
    local
        .filter(|(_, heap)| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL))
        .map(|(index, heap)| (index, heap.size))
        .max_by_key(|(_, size)| *size)
        .unwrap_or_default()
}

fn available_bytes(
    instance: &Instance,
    physical: vk::PhysicalDevice,
    extensions: &[vk::ExtensionProperties],
) -> Option<u64> {
    if !has_extension(extensions, ext::memory_budget::NAME) {
        return None;
    }
    let (heap, size) = largest_heap(instance, physical);
    let mut budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
    let mut memory = vk::PhysicalDeviceMemoryProperties2::default().push_next(&mut budget);
    // SAFETY: the device lists the extension that the chained structure belongs to.
    unsafe { instance.raw().get_physical_device_memory_properties2(physical, &mut memory) };
    Some(left_of(size, budget.heap_budget[heap], budget.heap_usage[heap]))
}

/// What is left to this process of a heap, from its size, the process's budget of it, and what of that is in use.
fn left_of(size: u64, budget: u64, usage: u64) -> u64 {
    // Usage may exceed the budget when other programs take memory.
    budget.saturating_sub(usage).min(size)
}

#[cfg(test)]
mod tests {
    use super::left_of;

    #[test]
    fn what_is_left_of_a_heap() {
        assert_eq!(left_of(1000, 900, 100), 800);
        assert_eq!(left_of(1000, 900, 950), 0);
        // Some drivers tell budgets beyond the heap.
        assert_eq!(left_of(1000, 5000, 100), 1000);
    }
}
