//! What pictures leave undetermined.

use crate::arrays::{self, Array};
use crate::backend::{self, Backend};
use crate::engine::check_supersample;
use crate::errors::{OrRaise, Raise, invalid};
use crate::scene::Scene;
use crate::work::{self, Report, callback};
use antirad::ambiguity::{DirectLight, Given, Interval, Polytope, Views};
use antirad::image::Rasterizer;
use pyo3::prelude::*;

/// Which other emissions would give the same pictures of a diffuse scene.
#[pyclass(frozen, module = "antirad")]
pub struct Ambiguity {
    seen: Vec<bool>,
    unseen: Vec<u32>,
    least: Vec<[f64; 3]>,
    most: Vec<[f64; 3]>,
    determination: Vec<f64>,
}

#[pymethods]
impl Ambiguity {
    /// Whether any camera sees it, per triangle, bool (T,).
    #[getter]
    fn seen<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::vector(py, self.seen.clone())
    }

    /// The triangles that no camera sees, int64 (U,). Each adds a dimension, per channel, to the space of emissions that
    /// give the same pictures.
    #[getter]
    fn unseen<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::indices(py, &self.unseen)
    }

    /// The least emission of each of these in any explanation of the pictures, float64 (U, 3), W/(m² sr).
    #[getter]
    fn least<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::rows(py, self.least.clone())
    }

    /// The largest, likewise; infinite where no seen triangle receives its light.
    #[getter]
    fn most<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::rows(py, self.most.clone())
    }

    /// How far the pictures determine the emission of each triangle, float64 (T,): 1 fully, 0 not at all, nan without area.
    #[getter]
    fn determination<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::vector(py, self.determination.clone())
    }

    fn __repr__(&self) -> String {
        format!("<Ambiguity: {} of {} triangles unseen>", self.unseen.len(), self.seen.len())
    }
}

/// Finds which other emissions would give the same pictures of a diffuse scene.
///
/// Args:
///     scene: The scene, with one emission that explains the pictures.
///     views: Names of the cameras that took them; by default all.
///     noise: Allowed difference of visible radiance, relative to its mean, from 0 to below 1.
///     supersample: Samples along each side of a pixel.
///     backend: By default the one that all such calls share, of the kind that the settings of the scene name.
///     progress: Called with the number of unseen triangles done and all of them, as each takes a third of a solve; or
///         True for a bar of tqdm.
///
/// Raises:
///     ValueError: A material that is in use is glossy, or there is no such camera.
///     KeyboardInterrupt: Ctrl-C.
#[pyfunction]
#[pyo3(signature = (scene, *, views=None, noise=1e-3, supersample=8, backend=None, progress=None))]
pub fn ambiguity(
    py: Python<'_>,
    scene: &Scene,
    views: Option<Vec<String>>,
    noise: f64,
    supersample: u32,
    backend: Option<&Backend>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Ambiguity> {
    check_supersample(supersample)?;
    if !(0.0..1.0).contains(&noise) {
        return Err(invalid(format!("noise = {noise}; it must lie from 0 to below 1")));
    }
    let cameras = scene.chosen(views)?;
    let scene = scene.inner.clone();
    let triangles = scene.triangles.len();
    if let Some(glossy) = (0..triangles).map(|i| scene.material(i)).find(|m| m.is_glossy()) {
        return Err(invalid(format!("material {:?} is glossy; this is for diffuse scenes", glossy.name)));
    }
    let backend = backend::chosen(py, backend, scene.settings.backend)?;
    let progress = callback(py, progress, "steps_bar", "unseen triangles")?;
    work::run(py, progress, move |link| {
        let rasterizer = Rasterizer::new(&backend).or_raise()?;
        let cameras: Vec<_> = cameras.iter().collect();
        let views = Views::new(&rasterizer, &scene, &cameras, supersample).or_raise()?;
        let unseen = views.unseen(&scene);
        let mut direct = DirectLight::new(&backend, &scene, &link.watch()).or_raise()?;
        let report = link.reporter();
        let light =
            direct.columns(&unseen, &mut |done| report(Report::Steps(done, unseen.len()))).or_raise()?;
        let areas: Vec<f64> = (0..triangles).map(|i| scene.area_vector(i).length()).collect();
        let channel = |channel: usize| {
            let pick = |of: &dyn Fn(usize) -> [f64; 3]| -> Vec<f64> {
                (0..triangles).map(|i| of(i)[channel]).collect()
            };
            let albedo = pick(&|i| scene.material(i).diffuse_albedo());
            let emission = pick(&|i| scene.material(i).emission);
            Polytope::new(&Given {
                direct: &light,
                albedo: &albedo,
                emission: &emission,
                areas: &areas,
                seen: &views.seen,
                unseen: &unseen,
                noise,
            })
            .map_err(Raise::raise)
        };
        let channels = [channel(0)?, channel(1)?, channel(2)?];
        let intervals = channels.each_ref().map(Polytope::unseen_intervals);
        let ends = |end: fn(&Interval) -> f64| {
            (0..unseen.len()).map(|k| intervals.each_ref().map(|of| end(&of[k]))).collect()
        };
        let shares = channels.each_ref().map(Polytope::determination);
        let mean = |i: usize| shares.iter().map(|of| of[i]).sum::<f64>() / shares.len() as f64;
        Ok(Ambiguity {
            least: ends(|interval| interval.least),
            most: ends(|interval| interval.most.unwrap_or(f64::INFINITY)),
            determination: (0..triangles).map(mean).collect(),
            seen: views.seen,
            unseen: unseen.iter().map(|&i| i as u32).collect(),
        })
    })?
}
