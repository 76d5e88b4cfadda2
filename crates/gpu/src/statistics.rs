//! What drivers tell of the kernels that they compile: registers, scratch memory, occupancy.

use ash::khr::pipeline_executable_properties;
use ash::vk;
use std::sync::Mutex;

use super::lock;

/// What the driver tells of a compiled kernel (VK_KHR_pipeline_executable_properties).
#[derive(Clone, Debug, PartialEq)]
pub struct KernelStatistics {
    /// The kernel's name.
    pub kernel: &'static str,
    /// Specialization of the kernel: constants and their values.
    pub specialization: Vec<(u32, u32)>,
    /// Values by the names that the driver gives them.
    pub values: Vec<(String, f64)>,
}

impl KernelStatistics {
    /// The value of a name.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.iter().find(|(known, _)| known == name).map(|(_, value)| *value)
    }
}

pub(super) struct Statistics {
    functions: pipeline_executable_properties::Device,
    rows: Mutex<Vec<KernelStatistics>>,
}

impl Statistics {
    /// The statistics of a device on which the extension is enabled; none yet.
    pub fn new(instance: &ash::Instance, device: &ash::Device) -> Self {
        Self {
            functions: pipeline_executable_properties::Device::new(instance, device),
            rows: Mutex::default(),
        }
    }

    /// Asks about a pipeline that was just made; what the driver does not tell is left out.
    pub fn ask(&self, pipeline: vk::Pipeline, kernel: &'static str, specialization: &[(u32, u32)]) {
        // A compute pipeline is one executable.
        let of = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline);
        // SAFETY: the pipeline is alive, and was made with the flag that the call requires.
        let told = unsafe { self.functions.get_pipeline_executable_statistics(&of) }.unwrap_or_default();
        let named = told.iter().map(|row| {
            let name = row.name_as_c_str().unwrap_or_default().to_string_lossy().into_owned();
            (name, value(row))
        });
        // Hashes measure nothing.
        let values = named.filter(|(name, _)| !name.to_lowercase().ends_with("hash")).collect();
        lock(&self.rows).push(KernelStatistics { kernel, specialization: specialization.to_vec(), values });
    }

    pub fn rows(&self) -> Vec<KernelStatistics> {
        let mut rows = lock(&self.rows).clone();
        rows.sort_by(|a, b| (a.kernel, &a.specialization).cmp(&(b.kernel, &b.specialization)));
        rows
    }
}

fn value(row: &vk::PipelineExecutableStatisticKHR) -> f64 {
    // SAFETY: the format says which of the values is set.
    unsafe {
        match row.format {
            vk::PipelineExecutableStatisticFormatKHR::BOOL32 => f64::from(row.value.b32),
            vk::PipelineExecutableStatisticFormatKHR::INT64 => row.value.i64 as f64,
            vk::PipelineExecutableStatisticFormatKHR::UINT64 => row.value.u64 as f64,
            _ => row.value.f64,
        }
    }
}
