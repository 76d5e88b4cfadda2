//! Backends: where light is computed.

use crate::errors::{OrRaise, invalid};
use crate::work;
use antirad::backend::{self, BackendChoice};
use antirad::gpu::{DeviceInfo, DeviceOptions, GpuError, list_devices};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Mutex, PoisonError};

/// Where light is computed: on the CPU, or by kernels on a Vulkan device. Several engines and threads may share one.
///
/// Args:
///     kind: "cpu"; "vulkan", on whatever Vulkan device there is; or "auto", on a GPU if there is one, or on the device that
///         is named, otherwise on the CPU. Where it is "auto", the environment variable ANTIRAD_BACKEND decides.
///     device: Number of the Vulkan device in `devices()`, or a part of its name; by default the environment variable
///         ANTIRAD_DEVICE, else the first usable device, GPUs before CPUs.
///     memory_budget: Bytes that all arrays together may take; by default what the driver leaves to this process, and on
///         the CPU three quarters of the system's memory.
///     validation: Whether to check every call of Vulkan with the validation layer; by default whether ANTIRAD_VALIDATION
///         is 1.
///
/// Raises:
///     DeviceError: There is no such device, or it lacks something that antirad needs.
///     ValueError: There is no such backend.
#[pyclass(frozen, module = "antirad")]
pub struct Backend {
    pub inner: backend::Backend,
}

/// The backends of everything that is given none, by what its scene asks for.
static USUAL: Mutex<Vec<(BackendChoice, backend::Backend)>> = Mutex::new(Vec::new());

/// The backend of an argument, or the one that all such calls for scenes of the same choice share.
pub fn chosen(py: Python<'_>, given: Option<&Backend>, choice: BackendChoice) -> PyResult<backend::Backend> {
    match given {
        Some(given) => Ok(given.inner.clone()),
        None => work::run(py, None, move |_| usual(choice))?.or_raise(),
    }
}

fn usual(choice: BackendChoice) -> Result<backend::Backend, GpuError> {
    let mut known = USUAL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, found)) = known.iter().find(|(of, _)| *of == choice) {
        return Ok(found.clone());
    }
    let options = DeviceOptions::default();
    let kind = backend::Backend::chosen(Some(choice), &options);
    let same = known.iter().find(|(_, open)| open.kind() == kind).map(|(_, open)| open.clone());
    let found = same.map_or_else(|| backend::Backend::open(Some(kind.into()), &options), Ok)?;
    known.push((choice, found.clone()));
    Ok(found)
}

#[pymethods]
impl Backend {
    #[new]
    #[pyo3(signature = (kind="auto", *, device=None, memory_budget=None, validation=None))]
    fn new(
        py: Python<'_>,
        kind: &str,
        device: Option<String>,
        memory_budget: Option<u64>,
        validation: Option<bool>,
    ) -> PyResult<Self> {
        let choice: BackendChoice = kind.parse().map_err(invalid)?;
        let options = DeviceOptions::asked(&device, memory_budget);
        let validation = validation.unwrap_or(options.validation);
        let open = move |_: &_| backend::Backend::open(Some(choice), &options.validation(validation));
        Ok(Self { inner: work::run(py, None, open)?.or_raise()? })
    }

    /// "cpu" or "vulkan".
    #[getter]
    fn kind(&self) -> String {
        self.inner.kind().to_string()
    }

    /// Name of the Vulkan device, as reported by its driver, or model of the CPU.
    #[getter]
    fn device(&self) -> &str {
        self.inner.device_name()
    }

    /// Driver of the device and its version; of the CPU the vector instructions that are used.
    #[getter]
    fn driver(&self) -> &str {
        self.inner.driver()
    }

    /// Threads of this process that compute.
    #[getter]
    fn threads(&self) -> usize {
        self.inner.threads()
    }

    /// Properties of the Vulkan device, as in `devices()`; None on the CPU.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.inner.vulkan().map(|device| properties(py, device.info(), &[])).transpose()
    }

    /// Memory, in bytes: `budget` of all arrays together, `in_use` now, and at the `peak`.
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
        self.inner.vulkan().map(|device| device.validation_messages()).unwrap_or_default()
    }

    fn __repr__(&self) -> String {
        format!("Backend({:?}, device={:?})", self.kind(), self.device())
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
