//! Devices.

use crate::errors::OrRaise;
use crate::work;
use antirad::gpu::{self, DeviceInfo, DeviceOptions, GpuError, list_devices};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Mutex, PoisonError};

/// A Vulkan device, opened for compute. Several engines and threads may share one.
///
/// Args:
///     selector: Its number in `devices()` or a part of its name; by default the environment variable ANTIRAD_DEVICE,
///         else the first usable device, GPUs before CPUs.
///     memory_budget: Bytes that all buffers together may take; by default what the driver leaves to this process.
///     validation: Whether to check every call with the Vulkan validation layer; by default whether ANTIRAD_VALIDATION
///         is 1.
///
/// Raises:
///     DeviceError: There is no such device, or it lacks something that antirad needs.
#[pyclass(frozen, module = "antirad")]
pub struct Device {
    pub inner: gpu::Device,
}

/// The device of everything that is given none.
static USUAL: Mutex<Option<gpu::Device>> = Mutex::new(None);

/// The device of an argument, or the one that all such calls share.
pub fn chosen(py: Python<'_>, device: Option<&Device>) -> PyResult<gpu::Device> {
    if let Some(device) = device {
        return Ok(device.inner.clone());
    }
    work::run(py, None, |_| {
        let mut usual = USUAL.lock().unwrap_or_else(PoisonError::into_inner);
        match &*usual {
            Some(device) => Ok(device.clone()),
            None => Ok::<_, GpuError>(usual.insert(gpu::Device::new(&DeviceOptions::default())?).clone()),
        }
    })?
    .or_raise()
}

#[pymethods]
impl Device {
    #[new]
    #[pyo3(signature = (selector=None, *, memory_budget=None, validation=None))]
    fn new(
        py: Python<'_>,
        selector: Option<String>,
        memory_budget: Option<u64>,
        validation: Option<bool>,
    ) -> PyResult<Self> {
        let options = DeviceOptions::asked(&selector, memory_budget);
        let validation = validation.unwrap_or(options.validation);
        let open = move |_: &_| gpu::Device::new(&options.validation(validation));
        Ok(Self { inner: work::run(py, None, open)?.or_raise()? })
    }

    /// Name, as reported by the driver.
    #[getter]
    fn name(&self) -> String {
        self.inner.info().name.clone()
    }

    /// Its properties, as in `devices()`.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        properties(py, self.inner.info(), &[])
    }

    /// Memory, in bytes: `budget` of all buffers together, `in_use` now, and at the `peak`.
    #[getter]
    fn memory<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let report = self.inner.memory();
        let memory = PyDict::new(py);
        memory.set_item("budget", report.budget)?;
        memory.set_item("in_use", report.in_use)?;
        memory.set_item("peak", report.peak)?;
        Ok(memory)
    }

    /// Messages of the validation layer so far; empty without validation.
    #[getter]
    fn validation_messages(&self) -> Vec<String> {
        self.inner.validation_messages()
    }

    fn __repr__(&self) -> String {
        format!("Device({:?})", self.inner.info().name)
    }
}

/// The Vulkan devices of this machine, best first.
///
/// Returns:
///     A dictionary for each: `index`, `name`, `kind`, `driver`, `api_version`, `heap_bytes` (memory on the device),
///     `max_buffer` (the largest buffer that a kernel sees, bytes), `float64` (whether precision "f64" is possible) and
///     `missing` (what antirad needs and it lacks, in words; empty if it can be used).
///
/// Raises:
///     DeviceError: There is no Vulkan loader.
#[pyfunction]
pub fn devices(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let devices = work::run(py, None, |_| list_devices())?.or_raise()?;
    devices.iter().map(|device| properties(py, &device.info, &device.missing)).collect()
}

fn properties<'py>(py: Python<'py>, info: &DeviceInfo, missing: &[String]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("index", info.index)?;
    dict.set_item("name", &info.name)?;
    dict.set_item("kind", info.kind.to_string())?;
    dict.set_item("driver", &info.driver)?;
    dict.set_item("api_version", &info.api_version)?;
    dict.set_item("heap_bytes", info.heap_bytes)?;
    dict.set_item("max_buffer", info.largest_buffer())?;
    dict.set_item("float64", info.enabled.float64)?;
    dict.set_item("missing", missing)?;
    Ok(dict)
}
