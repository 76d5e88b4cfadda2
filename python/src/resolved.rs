//! What a scene leaves open, decided once.

use crate::arrays::{self, Array, Numbers};
use crate::errors::OrRaise;
use crate::scene::Scene;
use crate::work;
use antirad::plan::GradientRequest;
use antirad::resolve::{self, ResolveOptions};
use antirad::scene::VisibilityChoice;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;

/// A scene with nothing left to decide: what `Scene.resolved` returns.
#[pyclass(frozen, module = "antirad")]
pub struct Resolved {
    inner: resolve::Resolved,
}

#[pymethods]
impl Resolved {
    /// The scene as the command line solves it: its triangles are parts of those given, and its settings are all stated.
    #[getter]
    fn scene(&self) -> Scene {
        Scene::of(self.inner.scene.clone())
    }

    /// What was decided: (setting, value, reason) each.
    #[getter]
    fn decisions(&self) -> Vec<Decided> {
        decided(&self.inner)
    }

    /// Per triangle of `scene`, the index of the given one that it is a part of, int64.
    #[getter]
    fn parents<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::indices(py, &self.inner.cut.parents().collect::<Vec<u32>>())
    }

    /// Means over the given triangles, (N, 3), of values of the triangles of `scene`, such as irradiance.
    ///
    /// Args:
    ///     values: Of each triangle of `scene`, (M, 3).
    fn on_given<'py>(&self, py: Python<'py>, values: Numbers) -> PyResult<Array<'py>> {
        let values = arrays::triples("values", &values, Some(self.inner.scene.triangles.len()))?;
        arrays::rows(py, self.inner.on_given(&values))
    }

    fn __repr__(&self) -> String {
        let lines: Vec<String> = self.inner.decisions.iter().map(ToString::to_string).collect();
        lines.join("\n")
    }
}

/// (setting, value, reason)
pub type Decided = (&'static str, String, String);

pub fn decided(resolved: &resolve::Resolved) -> Vec<Decided> {
    resolved.decisions.iter().map(|of| (of.setting, of.value.clone(), of.why.clone())).collect()
}

/// Says it where derivatives by positions make visibility another one than the scene states.
pub fn warn_of_visibility(
    py: Python<'_>,
    scene: &antirad::scene::Scene,
    gradients: GradientRequest,
) -> PyResult<()> {
    if gradients.positions && scene.settings.visibility == VisibilityChoice::Explicit {
        let category = py.get_type::<PyUserWarning>();
        let message =
            c"positions are differentiated, of which rays have no derivatives yet: visibility is implicit";
        PyErr::warn(py, &category, message, 1)?;
    }
    Ok(())
}

/// Resolves a scene. `cut`: whether its triangles may be cut.
pub fn resolved(py: Python<'_>, scene: &Scene, cut: bool) -> PyResult<Resolved> {
    let scene = scene.inner.clone();
    let options = ResolveOptions::default().cut(cut);
    let inner = work::run(py, None, move |_| resolve::resolve(&scene, &options))?.or_raise()?;
    Ok(Resolved { inner })
}
