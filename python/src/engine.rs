//! The engine: a planned scene on a backend.

use crate::arrays::{self, Array, Numbers};
use crate::backend::{self, Backend};
use crate::errors::{OrRaise, Raise, invalid, word};
use crate::plan::{Plan, limited, request};
use crate::resolved::{Decided, decided, warn_of_visibility};
use crate::scene::{Camera, Scene};
use crate::work::{self, Report, callback};
use antirad::glam::DVec3;
use antirad::image::{PictureOptions, Rasterizer};
use antirad::output::single;
use antirad::plan::{GradientRequest, PlanOptions};
use antirad::render::SceneGradient;
use antirad::render::{Light, Reflections, Shading};
use antirad::resolve::{ResolveOptions, Resolved, resolve};
use antirad::{Cotangent, EngineError, SolveParams};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::sync::{Arc, Mutex, PoisonError};

/// A planned scene on a backend: resolved as `Scene.resolved` and the command line resolve it. What it takes and returns belongs to the triangles of
/// the given scene.
///
/// Args:
///     scene: The scene.
///     backend: By default the one that all such calls share, of the kind that the settings of the scene name.
///     memory_budget: Bytes of the backend's memory that it may take, at most. If the solver's vectors do not fit on a Vulkan
///         device, they stay in host memory, with the same result.
///     gradients: Kinds of derivatives to plan for: "emission", "diffuse", "albedo", "specular", "power", "vertices",
///         "camera".
///     cut: Whether triangles may be cut where light varies within them.
///
/// Raises:
///     PlanError: The plan exceeds the budget; the message has the number of bytes that would do.
///     DeviceError: There is no device, or it failed.
#[pyclass(frozen, module = "antirad")]
pub struct Engine {
    /// Shared with the thread that works with it.
    inner: Arc<Mutex<State>>,
    backend: antirad::backend::Backend,
    gradients: GradientRequest,
}

struct State {
    engine: antirad::Engine,
    resolved: Resolved,
    /// Made with the first picture.
    rasterizer: Option<Rasterizer>,
}

impl Engine {
    /// Runs work with the engine, without the GIL.
    fn with<T: Send + 'static>(
        &self,
        py: Python<'_>,
        progress: Option<Bound<'_, PyAny>>,
        work: impl FnOnce(&mut State, &work::Link<Result<T, PyErr>>) -> Result<T, PyErr> + Send + 'static,
    ) -> PyResult<T> {
        let inner = self.inner.clone();
        work::run(py, progress, move |link| {
            let mut state = inner.lock().unwrap_or_else(PoisonError::into_inner);
            work(&mut state, link)
        })?
    }
}

/// Calls `solve` with the callbacks of a solver, after every submission and every pass.
fn watched<T: Send + 'static, R>(
    engine: &mut antirad::Engine,
    link: &work::Link<T>,
    solve: impl FnOnce(&mut antirad::Engine, &mut antirad::solve::SolveProgress) -> R,
) -> R {
    let reached = Arc::new(Mutex::new((0, 1.0)));
    let (within, watch, report) = (reached.clone(), link.watch(), link.reporter());
    let at = |reached: &Mutex<(u32, f64)>| *reached.lock().unwrap_or_else(PoisonError::into_inner);
    engine.set_pass_callback(Some(Box::new(move |done, total| {
        let (passes, residual) = at(&within);
        report(Report::Solve(passes, residual, done as f64 / total.max(1) as f64));
        watch()
    })));
    let report = link.reporter();
    let result = solve(engine, &mut |passes, residual| {
        *reached.lock().unwrap_or_else(PoisonError::into_inner) = (passes, residual);
        report(Report::Solve(passes, residual, 0.0));
        link.flow()
    });
    engine.set_pass_callback(None);
    result
}

fn params(scene: &antirad::scene::Scene, tolerance: Option<f64>, max_passes: Option<u32>) -> SolveParams {
    let usual = SolveParams::from(&scene.settings);
    usual.tolerance(tolerance.unwrap_or(usual.tolerance)).max_passes(max_passes.unwrap_or(usual.max_passes))
}

#[pymethods]
impl Engine {
    #[new]
    #[pyo3(signature = (scene, *, backend=None, memory_budget=None, gradients=vec![], cut=true),
        text_signature = "(scene, *, backend=None, memory_budget=None, gradients=(), cut=True)")]
    fn new(
        py: Python<'_>,
        scene: &Scene,
        backend: Option<&Backend>,
        memory_budget: Option<u64>,
        gradients: Vec<String>,
        cut: bool,
    ) -> PyResult<Self> {
        let backend = backend::chosen(py, backend, scene.inner.settings.backend)?;
        let gradients = request(&gradients)?;
        warn_of_visibility(py, &scene.inner, gradients)?;
        let (on, given) = (backend.clone(), scene.inner.clone());
        let state = work::run(py, None, move |_| {
            let resolved = resolve(&given, &ResolveOptions::default().cut(cut).moves(gradients.into()))?;
            let options = limited(PlanOptions::of(&on), memory_budget).gradients(gradients);
            let engine = antirad::Engine::builder(&on, &resolved.scene).options(options).build()?;
            Ok::<_, EngineError>(State { engine, resolved, rasterizer: None })
        })?
        .or_raise()?;
        Ok(Self { inner: Arc::new(Mutex::new(state)), backend, gradients })
    }

    /// The plan that it executes.
    #[getter]
    fn plan(&self, py: Python<'_>) -> PyResult<Plan> {
        Ok(Plan::of(self.with(py, None, |state, _| Ok(state.engine.plan().clone()))?))
    }

    /// What the scene left open, as it was decided: (setting, value, reason) each.
    #[getter]
    fn decisions(&self, py: Python<'_>) -> PyResult<Vec<Decided>> {
        self.with(py, None, |state, _| Ok(decided(&state.resolved)))
    }

    /// The backend that it runs on.
    #[getter]
    fn backend(&self) -> Backend {
        Backend { inner: self.backend.clone() }
    }

    /// Solves for the light of the scene.
    ///
    /// Args:
    ///     tolerance: Relative residual at which to stop; by default that of the scene.
    ///     max_passes: Passes after which to give up; by default those of the scene.
    ///     start: A solution of a similar scene to start from.
    ///     progress: Called with the number of passes, the relative residual and the share of the current pass, several
    ///         times per second; or True for a bar of tqdm. An exception from it ends the solve.
    ///
    /// Raises:
    ///     SolveError: The solve diverged or did not converge; the message says what to do.
    ///     KeyboardInterrupt: Ctrl-C.
    #[pyo3(signature = (*, tolerance=None, max_passes=None, start=None, progress=None))]
    fn solve(
        &self,
        py: Python<'_>,
        tolerance: Option<f64>,
        max_passes: Option<u32>,
        start: Option<&Solution>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Solution> {
        let wanted = tolerance.unwrap_or(1e-4);
        let progress = callback(py, progress, "solve_bar", wanted)?;
        let start = start.map(|start| start.inner.clone());
        let solution = self.with(py, progress, move |state, link| {
            let params = params(&state.resolved.scene, tolerance, max_passes);
            let from = start.as_deref();
            let solution = watched(&mut state.engine, link, |engine, progress| {
                engine.solve_from(from, &params, progress)
            })
            .map_err(|error| error.without_best())
            .or_raise()?;
            let irradiance = Arc::new(state.resolved.cut.on_given(&solution.irradiance));
            let radiosity = Arc::new(state.resolved.cut.on_given(&solution.radiosity));
            Ok(Solution { inner: Arc::new(solution), irradiance, radiosity })
        })?;
        Ok(solution)
    }

    /// Replaces the materials by those of a scene with the same triangles. Earlier solutions can then only be a `start`.
    ///
    /// Raises:
    ///     Error: The scene has other triangles, or lobes or colours that were not planned.
    fn set_materials(&self, py: Python<'_>, scene: &Scene) -> PyResult<()> {
        let scene = scene.inner.clone();
        self.with(py, None, move |state, _| {
            if scene.triangles.len() != state.resolved.cut.given() {
                return Err(invalid("the scene has other triangles than the engine's"));
            }
            let resolved = &mut state.resolved;
            let scene =
                antirad::scene::Scene { settings: resolved.scene.settings, ..resolved.cut.apply(&scene) };
            state.engine.set_materials(&scene).or_raise()?;
            resolved.scene = scene;
            Ok(())
        })
    }

    /// Radiance of the front of each triangle towards a point, float64 (T, 3), W/(m² sr); zero for triangles that face away.
    ///
    /// Args:
    ///     solution: A solution of this engine.
    ///     position: The point, metres.
    fn face_colours<'py>(
        &self,
        py: Python<'py>,
        solution: &Solution,
        position: [f64; 3],
    ) -> PyResult<Array<'py>> {
        let solution = solution.inner.clone();
        let colours = self.with(py, None, move |state, _| {
            let colours = state.engine.face_colours(&solution, position.into()).or_raise()?;
            Ok(state.resolved.cut.on_given(&colours))
        })?;
        arrays::rows(py, colours)
    }

    /// The picture that a camera takes, float32 (height, width, 3): linear RGB, rows from the top, W/(m² sr).
    ///
    /// Args:
    ///     solution: A solution of this engine.
    ///     camera: The camera; by default the only one of the scene.
    ///     supersample: Samples along each side of a pixel, a power of two.
    ///     shading: "gathered" (direct light at each visible point, indirect light interpolated) or "face" (one colour per
    ///         triangle).
    ///     reflections: What glossy faces mirror of other faces in gathered pictures: by "rays" from each visible point, as
    ///         many as it takes; by "fixed-rays", the same number from each, as differentiable renderers of materials see
    ///         it; or out of direction "bins", as those of vertices and cameras do.
    #[pyo3(signature = (solution, camera=None, *, supersample=8, shading="gathered", reflections="rays"))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        solution: &Solution,
        camera: Option<&Camera>,
        supersample: u32,
        shading: &str,
        reflections: &str,
    ) -> PyResult<Array<'py>> {
        let solution = solution.inner.clone();
        let camera = camera.cloned();
        let shading: Shading = word("shading", shading)?;
        let reflections: Reflections = word("reflections", reflections)?;
        let options = PictureOptions::default().supersample(supersample);
        let picture = self.with(py, None, move |state, _| {
            let camera = match camera {
                Some(camera) => camera.inner,
                None => Scene::of(state.resolved.scene.clone()).camera(None)?.inner,
            };
            let colours = single(&state.engine.face_colours(&solution, camera.position).or_raise()?);
            let cameras = std::slice::from_ref(&camera);
            let light = (shading == Shading::Gathered).then(|| {
                Light::new(&mut state.engine, &solution, &state.resolved.scene, cameras, reflections)
            });
            let light = light.transpose().or_raise()?;
            let rasterizer = match state.rasterizer.take() {
                Some(rasterizer) => rasterizer,
                None => Rasterizer::new(state.engine.backend()).or_raise()?,
            };
            let rasterizer = state.rasterizer.insert(rasterizer);
            let picture = match light {
                Some(light) => rasterizer
                    .coverage(&state.resolved.scene, &camera, supersample)
                    .and_then(|coverage| light.picture(0, &coverage)),
                None => rasterizer.render(&state.resolved.scene, &camera, &colours, &options),
            };
            picture.or_raise()
        })?;
        let rgb = picture.pixels.iter().map(|&[r, g, b, _]| [r, g, b]).collect();
        arrays::picture(py, rgb, picture.width)
    }

    /// Derivatives of a loss by the scene, exact for the discretised model: one adjoint solve.
    ///
    /// Args:
    ///     solution: A solution of this engine.
    ///     irradiance: Derivative of the loss by `solution.irradiance`, (T, 3).
    ///     radiosity: Derivative of the loss by `solution.radiosity`, (T, 3).
    ///     colours: Positions of cameras, metres, each with the derivative of the loss by `face_colours` there, (T, 3).
    ///     tolerance: Relative residual at which to stop; by default that of the scene.
    ///     max_passes: Passes after which to give up; by default those of the scene.
    ///     progress: As in `solve`.
    ///
    /// Returns:
    ///     Derivatives of the kinds that were planned, by the material of each triangle as if no two shared one.
    ///
    /// Raises:
    ///     Error: No gradients were planned, or the solution is not this engine's.
    ///     ValueError: An array has the wrong shape.
    #[pyo3(signature = (solution, *, irradiance=None, radiosity=None, colours=vec![], tolerance=None, max_passes=None,
        progress=None),
        text_signature = "($self, solution, *, irradiance=None, radiosity=None, colours=(), tolerance=None, \
        max_passes=None, progress=None)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn backward(
        &self,
        py: Python<'_>,
        solution: &Solution,
        irradiance: Option<Numbers>,
        radiosity: Option<Numbers>,
        colours: Vec<([f64; 3], Numbers)>,
        tolerance: Option<f64>,
        max_passes: Option<u32>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Gradients> {
        let count = Some(solution.irradiance.len());
        let rows = |what, values: Option<Numbers>| {
            values.map(|values| arrays::vectors(what, &values, count)).transpose()
        };
        let (irradiance, radiosity) = (rows("irradiance", irradiance)?, rows("radiosity", radiosity)?);
        let colours = colours.into_iter().map(|(position, values)| {
            PyResult::Ok((DVec3::from(position), arrays::vectors("colours", &values, count)?))
        });
        let colours = colours.collect::<PyResult<Vec<_>>>()?;
        let progress = callback(py, progress, "solve_bar", tolerance.unwrap_or(1e-4))?;
        let (solution, request) = (solution.inner.clone(), self.gradients);
        let gradients = self.with(py, progress, move |state, link| {
            let params = params(&state.resolved.scene, tolerance, max_passes);
            let on_parts = |by: Vec<DVec3>| state.resolved.cut.on_parts(&by);
            let mut cotangent =
                Cotangent::default().irradiance(irradiance.map(on_parts)).radiosity(radiosity.map(on_parts));
            cotangent.colours.extend(colours.into_iter().map(|(position, by)| (position, on_parts(by))));
            let gradients = watched(&mut state.engine, link, |engine, progress| {
                engine.backward_with(&solution, &cotangent, request, &params, progress)
            });
            Ok(SceneGradient::from(gradients.map_err(Raise::raise)?).by_given(&state.resolved.cut))
        })?;
        Gradients::of(py, gradients, &[])
    }
}

/// The light of a scene. Holds memory of the backend until it is deleted.
#[pyclass(frozen, module = "antirad")]
pub struct Solution {
    inner: Arc<antirad::Solution>,
    /// Means over the given triangles.
    irradiance: Arc<Vec<[f64; 3]>>,
    radiosity: Arc<Vec<[f64; 3]>>,
}

#[pymethods]
impl Solution {
    /// Irradiance of the front of each triangle, its mean over it, float64 (T, 3), W/m². Not to be written to.
    #[getter]
    fn irradiance<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::of_solution(py, &self.irradiance)
    }

    /// Emitted and reflected power per area of each triangle, float64 (T, 3), W/m². Not to be written to.
    #[getter]
    fn radiosity<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::of_solution(py, &self.radiosity)
    }

    /// Passes (applications of the transport) that the solve took.
    #[getter]
    fn passes(&self) -> u32 {
        self.inner.info.passes
    }

    /// Relative residual after each pass.
    #[getter]
    fn residuals(&self) -> Vec<f64> {
        self.inner.info.residuals.clone()
    }

    /// Estimate of the spectral radius of the transport; from 1 on light is created, and the solution is not physical.
    #[getter]
    fn spectral_radius(&self) -> Option<f64> {
        self.inner.info.spectral_radius
    }

    /// Power that is `emitted`, `absorbed` by fronts, and `escaped`, RGB, W; with explicit visibility also what falls `on_backs`, and what is
    /// `unaccounted` for.
    #[getter]
    fn energy<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let energy = PyDict::new(py);
        let antirad::Energy { emitted, absorbed, on_backs, escaped, unaccounted } = self.inner.energy;
        for (name, rgb) in [("emitted", emitted), ("absorbed", absorbed), ("escaped", escaped)] {
            energy.set_item(name, <(f64, f64, f64)>::from(rgb))?;
        }
        if let Some(on_backs) = on_backs {
            energy.set_item("on_backs", <(f64, f64, f64)>::from(on_backs))?;
            energy.set_item("unaccounted", <(f64, f64, f64)>::from(unaccounted))?;
        }
        Ok(energy)
    }

    /// Number of triangles with negative irradiance, and the lowest, W/m²: antiradiance may subtract slightly too much.
    #[getter]
    fn negative(&self) -> (usize, f64) {
        (self.inner.negative.triangles, self.inner.negative.minimum)
    }

    fn __repr__(&self) -> String {
        let info = &self.inner.info;
        let residual = info.residuals.last().copied().unwrap_or(0.0);
        format!("<Solution: {} passes to {residual:.1e}>", info.passes)
    }
}

/// Derivatives of a loss. What was not asked for is None.
#[pyclass(frozen, module = "antirad", get_all)]
pub struct Gradients {
    /// By emitted radiance, float64 (T, 3) or (M, 3), per W/(m² sr).
    emission: Option<Py<PyAny>>,
    /// By the irradiance of each sun, float64 (S, 3), per W/m²; with those by emission.
    suns: Option<Py<PyAny>>,
    /// By the albedo ρ, float64 (T, 3) or (M, 3).
    albedo: Option<Py<PyAny>>,
    /// By the specular constant σ, float64 (T, 3) or (M, 3).
    specular: Option<Py<PyAny>>,
    /// By the diffuse constant δ, float64 (T,) or (M,).
    diffuse: Option<Py<PyAny>>,
    /// By the power p, float64 (T,) or (M,).
    power: Option<Py<PyAny>>,
    /// By the positions of vertices, float64 (V, 3), per metre.
    vertices: Option<Py<PyAny>>,
    /// By position and target, per metre, and up of each camera, float64 (n, 3, 3).
    camera: Option<Py<PyAny>>,
    /// By the texels of each texture, a list of float64 (rows, columns, 3).
    textures: Option<Py<PyAny>>,
}

impl Gradients {
    /// `columns`: those of each texture.
    pub fn of(py: Python<'_>, gradient: SceneGradient, columns: &[u32]) -> PyResult<Self> {
        let SceneGradient { emission, suns, diffuse, albedo, specular, power, positions, cameras, texels } =
            gradient;
        let rows =
            |of: Option<Vec<DVec3>>| of.map(|of| PyResult::Ok(arrays::points(py, of)?.unbind())).transpose();
        let numbers =
            |of: Option<Vec<f64>>| of.map(|of| PyResult::Ok(arrays::vector(py, of)?.unbind())).transpose();
        let cameras = cameras.map(|cameras| {
            let count = cameras.len();
            let flat = cameras
                .into_iter()
                .flat_map(|camera| [camera.position, camera.target, camera.up].map(Into::into))
                .collect();
            let flat: Vec<[f64; 3]> = flat;
            PyResult::Ok(arrays::array(py, flat.into_flattened(), &[count, 3, 3])?.unbind())
        });
        Ok(Self {
            emission: rows(emission)?,
            suns: rows(suns)?,
            albedo: rows(albedo)?,
            specular: rows(specular)?,
            diffuse: numbers(diffuse)?,
            power: numbers(power)?,
            vertices: rows(positions)?,
            camera: cameras.transpose()?,
            textures: if columns.is_empty() { None } else { Some(textures(py, texels, columns)?) },
        })
    }
}

#[pymethods]
impl Gradients {
    /// From derivatives per triangle to derivatives per material of a scene: sums over the triangles of each.
    ///
    /// Raises:
    ///     ValueError: They are not per triangle of this scene.
    fn by_material(&self, py: Python<'_>, scene: &Scene) -> PyResult<Self> {
        let count = scene.inner.triangles.len();
        let rows = |what, of: &Option<Py<PyAny>>| {
            let values = of.as_ref().map(|of| of.bind(py).extract::<Numbers>());
            values.map(|values| arrays::vectors(what, &values?, Some(count))).transpose()
        };
        let numbers = |what, of: &Option<Py<PyAny>>| {
            let values = of.as_ref().map(|of| of.bind(py).extract::<Numbers>());
            values.map(|values| arrays::scalars(what, &values?, count)).transpose()
        };
        let per_triangle = SceneGradient {
            emission: rows("emission", &self.emission)?,
            suns: None,
            albedo: rows("albedo", &self.albedo)?,
            specular: rows("specular", &self.specular)?,
            diffuse: numbers("diffuse", &self.diffuse)?,
            power: numbers("power", &self.power)?,
            positions: None,
            cameras: None,
            texels: None,
        };
        let sums = Self::of(py, per_triangle.by_material(&scene.inner), &[])?;
        let (suns, vertices, camera) = (&self.suns, &self.vertices, &self.camera);
        Ok(Self {
            suns: suns.as_ref().map(|of| of.clone_ref(py)),
            vertices: vertices.as_ref().map(|of| of.clone_ref(py)),
            camera: camera.as_ref().map(|of| of.clone_ref(py)),
            textures: self.textures.as_ref().map(|of| of.clone_ref(py)),
            ..sums
        })
    }

    fn __repr__(&self) -> String {
        let kinds = [
            ("emission", self.emission.is_some()),
            ("albedo", self.albedo.is_some()),
            ("specular", self.specular.is_some()),
            ("diffuse", self.diffuse.is_some()),
            ("power", self.power.is_some()),
            ("vertices", self.vertices.is_some()),
            ("camera", self.camera.is_some()),
            ("textures", self.textures.is_some()),
        ];
        let names: Vec<&str> = kinds.into_iter().filter(|(_, there)| *there).map(|(name, _)| name).collect();
        format!("<Gradients by {}>", names.join(", "))
    }
}

/// Derivatives by the texels of textures with so many columns.
fn textures(py: Python<'_>, texels: Option<Vec<Vec<DVec3>>>, columns: &[u32]) -> PyResult<Py<PyAny>> {
    let of = |(texels, columns): (Vec<DVec3>, &u32)| {
        arrays::picture::<f64>(py, texels.into_iter().map(Into::into).collect(), *columns)
    };
    let arrays = texels.unwrap_or_default().into_iter().zip(columns).map(of).collect::<PyResult<Vec<_>>>()?;
    Ok(PyList::new(py, arrays)?.into_any().unbind())
}

/// Refuses what is not a power of two early, where only the picture would.
pub fn check_supersample(supersample: u32) -> PyResult<()> {
    match supersample.is_power_of_two() && supersample <= antirad::image::MAX_SUPERSAMPLE {
        true => Ok(()),
        false => Err(invalid(antirad::image::ImageError::Supersample(supersample))),
    }
}
