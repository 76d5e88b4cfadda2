//! What will come out wrong, and the mesh refined there.

use crate::arrays::{self, Array};
use crate::errors::OrRaise;
use crate::plan::from_json;
use crate::scene::Scene;
use crate::work;
use antirad::plan::{Plan, PlanOptions};
use antirad::warnings::{self, RefineOptions, Warnings};
use pyo3::prelude::*;

/// Something that makes a result less accurate, with the triangles to blame. Printed, it says all of this.
#[pyclass(frozen, module = "antirad")]
pub struct Warning {
    inner: warnings::Warning,
}

#[pymethods]
impl Warning {
    /// What it is about, such as "coarse blockers".
    #[getter]
    fn kind(&self) -> &'static str {
        self.inner.kind.name()
    }

    /// Share of all light that it may change, 0 to 1; estimated from the geometry unless the scene was solved.
    #[getter]
    fn effect(&self) -> f64 {
        self.inner.effect.share
    }

    /// What is wrong, in a sentence.
    #[getter]
    fn message(&self) -> &str {
        &self.inner.message
    }

    /// What to do about it.
    #[getter]
    fn remedy(&self) -> &str {
        &self.inner.remedy
    }

    /// All triangles concerned, the worst first, int64.
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::indices(py, &self.inner.triangles)
    }

    /// Their share of the scene's area, 0 to 1.
    #[getter]
    fn area_share(&self) -> f64 {
        self.inner.area_share
    }

    /// The quantity that ranks the triangles, with its unit.
    #[getter]
    fn measure(&self) -> &'static str {
        self.inner.measure
    }

    /// The worst triangles: dictionaries with `triangle`, `place`, `value`, `other` and `other_place`.
    #[getter]
    fn worst<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        from_json(py, &self.inner.worst)
    }

    fn __str__(&self) -> String {
        self.inner.to_string()
    }

    fn __repr__(&self) -> String {
        format!("<Warning: {}, {} triangles>", self.inner.kind.name(), self.inner.count)
    }
}

fn listed(warnings: Warnings) -> Vec<Warning> {
    warnings.list.into_iter().map(|inner| Warning { inner }).collect()
}

/// Lists what of a scene will come out wrong, without solving it.
///
/// Raises:
///     SceneError: The scene is invalid.
#[pyfunction]
pub fn check(py: Python<'_>, scene: &Scene) -> PyResult<Vec<Warning>> {
    let scene = scene.inner.clone();
    let warnings = work::run(py, None, move |_| {
        let plan = Plan::new(&scene, &PlanOptions::default().boundless(), &scene.settings)?;
        Ok::<_, antirad::plan::PlanError>(Warnings::with_shadows(&scene, &plan))
    })?;
    Ok(listed(warnings.or_raise()?))
}

/// What `refine` returns.
#[pyclass(frozen, module = "antirad")]
pub struct Refined {
    scene: Scene,
    inner: warnings::Refined,
}

#[pymethods]
impl Refined {
    /// The finer scene.
    #[getter]
    fn scene(&self) -> Scene {
        self.scene.clone()
    }

    /// Per new triangle, the index of the old one that it is a part of, int64.
    #[getter]
    fn parents<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::indices(py, &self.inner.parents)
    }

    /// Rounds of cutting.
    #[getter]
    fn rounds(&self) -> u32 {
        self.inner.rounds
    }

    /// Whether the limit on triangles prevented further cuts.
    #[getter]
    fn full(&self) -> bool {
        self.inner.full
    }

    /// Warnings of the given scene.
    #[getter]
    fn before(&self) -> Vec<Warning> {
        listed(self.inner.before.clone())
    }

    /// Warnings of the finer scene.
    #[getter]
    fn after(&self) -> Vec<Warning> {
        listed(self.inner.after.clone())
    }

    fn __repr__(&self) -> String {
        let (count, rounds) = (self.inner.parents.len(), self.inner.rounds);
        format!("<Refined: {count} triangles after {rounds} rounds>")
    }
}

/// Cuts triangles into four where `check` finds them too large, the worst first.
///
/// Args:
///     scene: The scene.
///     max_triangles: Largest number of triangles of the finer scene.
///     levels: Largest number of times that a triangle is cut.
///
/// Raises:
///     PlanError: The scene already has that many triangles.
#[pyfunction]
#[pyo3(signature = (scene, *, max_triangles=100_000, levels=4))]
pub fn refine(py: Python<'_>, scene: &Scene, max_triangles: usize, levels: u32) -> PyResult<Refined> {
    let mut finer = (*scene.inner).clone();
    let options = RefineOptions::default().max_triangles(max_triangles).levels(levels);
    let refined = work::run(py, None, move |_| {
        warnings::refine(&mut finer, &PlanOptions::default(), &options).map(|refined| (finer, refined))
    })?;
    let (finer, inner) = refined.or_raise()?;
    Ok(Refined { scene: Scene::of(finer), inner })
}
