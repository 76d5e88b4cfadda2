//! Plans.

use crate::backend::Backend;
use crate::errors::{OrRaise, invalid};
use crate::scene::Scene;
use crate::work;
use antirad::backend::BackendChoice;
use antirad::plan::{self, GradientRequest, PlanOptions};
use antirad::resolve::{ResolveOptions, resolve};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// What a solve takes, decided before a backend is touched. Printed, it tells classes, pairs, bytes and times.
#[pyclass(frozen, module = "antirad")]
pub struct Plan {
    inner: Arc<plan::Plan>,
}

/// Kinds of derivatives from their names.
pub fn request(kinds: &[String]) -> PyResult<GradientRequest> {
    kinds.iter().try_fold(GradientRequest::NOTHING, |request, kind| {
        Ok(match kind.as_str() {
            "emission" => request.emission(true),
            "diffuse" => request.diffuse(true),
            "albedo" => request.albedo(true),
            "specular" => request.specular(true),
            "power" => request.power(true),
            "vertices" => request.positions(true),
            "camera" => request.camera(true),
            other => {
                return Err(invalid(format!(
                    "there is no derivative by {other:?}; possible are emission, diffuse, albedo, specular, power, \
                     vertices and camera"
                )));
            }
        })
    })
}

/// Plans a solve of a scene, resolved as by `Engine`.
///
/// Args:
///     scene: The scene.
///     backend: Its limits are planned for; by default the CPU with 4 GiB, or where the settings of the scene name Vulkan the
///         limits of lavapipe (2 GiB, buffers of 128 MiB), without touching a device.
///     memory_budget: Bytes that all of it may take, at most.
///     gradients: Kinds of derivatives to plan for: "emission", "diffuse", "albedo", "specular", "power", "vertices",
///         "camera".
///     cut: Whether triangles may be cut where light varies within them.
///
/// Raises:
///     PlanError: The plan exceeds the budget; the message has the number of bytes that would do.
///     SceneError: The scene is invalid.
#[pyfunction(name = "plan")]
#[pyo3(signature = (scene, *, backend=None, memory_budget=None, gradients=vec![], cut=true),
    text_signature = "(scene, *, backend=None, memory_budget=None, gradients=(), cut=True)")]
pub fn plan_(
    py: Python<'_>,
    scene: &Scene,
    backend: Option<&Backend>,
    memory_budget: Option<u64>,
    gradients: Vec<String>,
    cut: bool,
) -> PyResult<Plan> {
    let gradients = request(&gradients)?;
    let options = match (backend, scene.inner.settings.backend) {
        (Some(backend), _) => PlanOptions::of(&backend.inner),
        (None, BackendChoice::Vulkan) => PlanOptions::lavapipe(),
        (None, _) => PlanOptions::default(),
    };
    let options = limited(options, memory_budget).gradients(gradients);
    let (scene, resolving) =
        (scene.inner.clone(), ResolveOptions::default().cut(cut).moves(gradients.into()));
    let made = work::run(py, None, move |_| {
        let scene = resolve(&scene, &resolving)?.scene;
        plan::Plan::new(&scene, &options, &scene.settings)
    })?;
    Ok(Plan { inner: Arc::new(made.or_raise()?) })
}

/// Options within a budget.
pub fn limited(options: PlanOptions, memory_budget: Option<u64>) -> PlanOptions {
    let budget = memory_budget.unwrap_or(u64::MAX).min(options.memory_budget);
    options.memory_budget(budget)
}

impl Plan {
    pub fn of(inner: plan::Plan) -> Self {
        Self { inner: Arc::new(inner) }
    }
}

#[pymethods]
impl Plan {
    /// Bytes of the backend's memory. Exactly these are allocated.
    #[getter]
    fn total_bytes(&self) -> u64 {
        self.inner.memory().total()
    }

    /// Bytes of the backend's memory by label.
    #[getter]
    fn bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let bytes = PyDict::new(py);
        for item in &self.inner.memory().items {
            bytes.set_item(&item.label, item.bytes)?;
        }
        Ok(bytes)
    }

    /// Bytes that all of it may take.
    #[getter]
    fn memory_budget(&self) -> u64 {
        self.inner.options().memory_budget
    }

    /// Everything that is printed, as a dictionary.
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let inner = self.inner.clone();
        let report = work::run(py, None, move |_| inner.report())?;
        from_json(py, &report)
    }

    fn __str__(&self, py: Python<'_>) -> PyResult<String> {
        let inner = self.inner.clone();
        work::run(py, None, move |_| inner.to_string())
    }

    fn __repr__(&self) -> String {
        format!("<Plan: {} triangles, {} bytes>", self.inner.facets().len(), self.total_bytes())
    }
}

/// A value of the library as dictionaries and lists.
pub fn from_json<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(invalid)?;
    py.import("json")?.call_method1("loads", (text,))
}
