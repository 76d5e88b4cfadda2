//! Pictures of a scene as a differentiable function of its values.

use crate::arrays::{self, Array, Numbers};
use crate::backend::{self, Backend};
use crate::engine::{Gradients, check_supersample};
use crate::errors::{OrRaise, Raise, invalid, word};
use crate::plan::request;
use crate::resolved::warn_of_visibility;
use crate::scene::{Scene, Values};
use crate::textures::{Size, Textures};
use crate::work;
use antirad::Watch;
use antirad::fit::{EngineRenderer, Renderer as _};
use antirad::glam::DVec3;
use antirad::plan::GradientRequest;
use antirad::render::Shading;
use antirad::scene::{self, Camera};
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};

/// Pictures of a scene as a function of emission, materials, vertices and cameras, with its derivatives: what
/// `antirad.torch` and `antirad.jax` are made of.
///
/// Args:
///     scene: The scene; values that are not given to `pictures` are its own.
///     views: Names of the cameras that take pictures; by default all of the scene.
///     gradients: Kinds of derivatives that `pull_back` computes: "emission", "diffuse", "albedo", "specular", "power",
///         "vertices", "camera".
///     supersample: Samples along each side of a pixel, a power of two.
///     shading: "gathered" (direct light at each visible point, indirect light interpolated) or "face" (one colour per
///         triangle), which derivatives by "camera" require.
///     textures: Meshes whose albedo is a texture, which `pictures` takes: name, rows and columns of each. A mesh without texture
///         coordinates gets those of an atlas.
///     backend: By default the one that all such calls share, of the kind that the settings of the scene name.
///
/// Raises:
///     DeviceError: There is no device, or it failed.
#[pyclass(frozen, module = "antirad")]
pub struct Renderer {
    base: Arc<scene::Scene>,
    textures: Textures,
    cameras: Vec<Camera>,
    gradients: GradientRequest,
    inner: Arc<Mutex<State>>,
}

struct State {
    renderer: EngineRenderer,
    /// What the running call asks whether to go on.
    watch: Arc<Mutex<Watch>>,
    /// The point of the latest pictures.
    latest: Option<Point>,
}

/// What pictures are a function of.
#[derive(Clone)]
struct Point {
    /// Its cameras are those of the views.
    scene: scene::Scene,
}

impl Point {
    fn is(&self, other: &Self) -> bool {
        self.scene.materials == other.scene.materials
            && self.scene.vertices == other.scene.vertices
            && self.scene.cameras == other.scene.cameras
            && self.scene.patterns.same_texels(&other.scene.patterns)
    }
}

impl State {
    fn pictures(&mut self, point: &Point) -> PyResult<Vec<Vec<DVec3>>> {
        self.latest = None;
        let pictures = self.renderer.pictures(&point.scene).or_raise()?;
        self.latest = Some(point.clone());
        Ok(pictures)
    }
}

impl Renderer {
    fn point(&self, values: &Values, camera: Option<&Numbers>, textures: &[Numbers]) -> PyResult<Point> {
        let mut scene = values.applied(&self.base)?;
        scene.cameras = self.moved(camera)?;
        if values.vertices.is_some() {
            // Triangles without area are found anew.
            let mut moved = scene::Scene { materials: self.base.materials.clone(), ..scene.clone() };
            moved.check(false).or_raise()?;
            scene.degenerate = moved.degenerate;
        }
        let scene = self.textures.applied(scene, textures)?;
        // Light is linear in emission, so that differences of scenes can be rendered, too.
        let positive = scene.materials.iter().all(|m| m.emission.iter().all(|&e| e >= 0.0));
        if positive {
            scene.validate().or_raise()?;
        }
        Ok(Point { scene })
    }

    /// The cameras at positions and targets (n, 2, 3), or (2, 3) for one; or with up (n, 3, 3), or (3, 3).
    fn moved(&self, camera: Option<&Numbers>) -> PyResult<Vec<Camera>> {
        let mut cameras = self.cameras.clone();
        if let Some(camera) = camera {
            let count = cameras.len();
            let vectors = match &camera.shape[..] {
                [n, vectors @ (2 | 3), 3] if *n == count => *vectors,
                [vectors @ (2 | 3), 3] if count == 1 => *vectors,
                shape => {
                    let shape = arrays::shown(shape);
                    return Err(invalid(format!(
                        "camera has the shape {shape}; it must be ({count}, 2, 3): position and target of each, or \
                         ({count}, 3, 3): with up"
                    )));
                }
            };
            for (camera, values) in cameras.iter_mut().zip(camera.values.chunks(3 * vectors)) {
                camera.position = DVec3::from_slice(values);
                camera.target = DVec3::from_slice(&values[3..]);
                if vectors == 3 {
                    camera.up = DVec3::from_slice(&values[6..]);
                }
                camera.check().or_raise()?;
            }
        }
        Ok(cameras)
    }

    fn with<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut State) -> PyResult<T> + Send + 'static,
    ) -> PyResult<T> {
        let inner = self.inner.clone();
        work::run(py, None, move |link| {
            let mut state = inner.lock().unwrap_or_else(PoisonError::into_inner);
            *state.watch.lock().unwrap_or_else(PoisonError::into_inner) = link.watch();
            work(&mut state)
        })?
    }
}

#[pymethods]
impl Renderer {
    #[new]
    #[pyo3(signature = (scene, *, views=None, gradients=vec![], supersample=8, shading="gathered", textures=vec![],
        backend=None),
        text_signature = "(scene, *, views=None, gradients=(), supersample=8, shading='gathered', textures=(), backend=None)")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn new(
        py: Python<'_>,
        scene: &Scene,
        views: Option<Vec<String>>,
        gradients: Vec<String>,
        supersample: u32,
        shading: &str,
        textures: Vec<Size>,
        backend: Option<&Backend>,
    ) -> PyResult<Self> {
        check_supersample(supersample)?;
        let shading: Shading = word("shading", shading)?;
        let cameras = scene.chosen(views)?;
        let textures = Textures::new(&scene.inner, &textures)?;
        let paintings = textures.paintings();
        let gradients = request(&gradients)?;
        warn_of_visibility(py, &scene.inner, gradients)?;
        // Derivatives by texels are made of those by albedo.
        let gradients = gradients.albedo(gradients.albedo || !paintings.is_empty());
        let backend = backend::chosen(py, backend, scene.inner.settings.backend)?;
        let mut planning = textures.scene().clone();
        if gradients.lobes() {
            // Lobes that may appear.
            for material in &mut planning.materials {
                material.specular = material.specular.map(|sigma| sigma.max(1e-6));
            }
        }
        let watch: Arc<Mutex<Watch>> = Arc::new(Mutex::new(Arc::new(|| ControlFlow::Continue(()))));
        planning.cameras.clone_from(&cameras);
        let asked = watch.clone();
        let renderer = work::run(py, None, move |_| {
            let watch: Watch = Arc::new(move || {
                let watch = asked.lock().unwrap_or_else(PoisonError::into_inner).clone();
                watch()
            });
            EngineRenderer::new(&backend, planning, supersample, gradients, watch)
                .map(|renderer| renderer.shading(shading).independent().paintings(paintings))
        })?
        .or_raise()?;
        let state = State { renderer, watch, latest: None };
        Ok(Self {
            base: scene.inner.clone(),
            textures,
            cameras,
            gradients,
            inner: Arc::new(Mutex::new(state)),
        })
    }

    /// One picture per view, float64 (height, width, 3): linear RGB, rows from the top, W/(m² sr).
    ///
    /// Args:
    ///     emission: Emitted radiance of each material, (M, 3), W/(m² sr). It may be negative: pictures are linear in it.
    ///     albedo: ρ of each material, (M, 3).
    ///     specular: σ of each material, (M, 3). The lobes must be the scene's, or "specular" among the gradients.
    ///     diffuse: δ of each material, (M,).
    ///     power: p of each material, (M,).
    ///     vertices: Positions, (V, 3), metres.
    ///     camera: Position and target of each view, (n, 2, 3), or (2, 3) for one, metres; or with up, (n, 3, 3) or (3, 3).
    ///     textures: Albedo ρ of the texels of each texture, (rows, columns, 3), in place of that of the materials of its mesh.
    ///
    /// Raises:
    ///     ValueError: An array has the wrong shape.
    ///     SceneError: The values are no valid scene.
    ///     SolveError: The scene has no solution.
    #[pyo3(signature = (*, emission=None, albedo=None, specular=None, diffuse=None, power=None, vertices=None, camera=None,
        textures=vec![]), text_signature = "($self, *, emission=None, albedo=None, specular=None, diffuse=None, power=None, \
        vertices=None, camera=None, textures=())")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn pictures<'py>(
        &self,
        py: Python<'py>,
        emission: Option<Numbers>,
        albedo: Option<Numbers>,
        specular: Option<Numbers>,
        diffuse: Option<Numbers>,
        power: Option<Numbers>,
        vertices: Option<Numbers>,
        camera: Option<Numbers>,
        textures: Vec<Numbers>,
    ) -> PyResult<Vec<Array<'py>>> {
        let values = Values { vertices, emission, albedo, specular, diffuse, power };
        let point = self.point(&values, camera.as_ref(), &textures)?;
        let pictures = self.with(py, move |state| state.pictures(&point))?;
        let views = pictures.into_iter().zip(&self.cameras);
        let rgb = |pixels: Vec<DVec3>| pixels.into_iter().map(Into::into).collect();
        views.map(|(pixels, camera)| arrays::picture::<f64>(py, rgb(pixels), camera.width)).collect()
    }

    /// Derivatives of a loss by the values of the scene, from those by the pixels.
    ///
    /// Args:
    ///     by_pixels: Derivative of the loss by each picture, (height, width, 3) each.
    ///     emission, albedo, specular, diffuse, power, vertices, camera, textures: The point, as in `pictures`. If the latest pictures
    ///         are those of another one they are made again.
    ///
    /// Returns:
    ///     Derivatives of the planned kinds, by the values of each material.
    ///
    /// Raises:
    ///     ValueError: An array has the wrong shape, or no gradients are planned.
    ///     SolveError: The adjoint has no solution.
    #[pyo3(signature = (by_pixels, *, emission=None, albedo=None, specular=None, diffuse=None, power=None, vertices=None,
        camera=None, textures=vec![]), text_signature = "($self, by_pixels, *, emission=None, albedo=None, specular=None, \
        diffuse=None, power=None, vertices=None, camera=None, textures=())")]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn pull_back(
        &self,
        py: Python<'_>,
        by_pixels: Vec<Numbers>,
        emission: Option<Numbers>,
        albedo: Option<Numbers>,
        specular: Option<Numbers>,
        diffuse: Option<Numbers>,
        power: Option<Numbers>,
        vertices: Option<Numbers>,
        camera: Option<Numbers>,
        textures: Vec<Numbers>,
    ) -> PyResult<Gradients> {
        if !self.gradients.any() {
            return Err(invalid("no derivatives are planned; name them in Renderer(gradients=[...])"));
        }
        if by_pixels.len() != self.cameras.len() {
            let (given, wanted) = (by_pixels.len(), self.cameras.len());
            return Err(invalid(format!("by_pixels has {given} pictures; it must have {wanted}")));
        }
        let views = by_pixels.iter().zip(&self.cameras);
        let by_pixels: Vec<Vec<DVec3>> = views
            .map(|(numbers, camera)| arrays::pixels("by_pixels", numbers, camera.width, camera.height))
            .collect::<PyResult<_>>()?;
        let values = Values { vertices, emission, albedo, specular, diffuse, power };
        let point = self.point(&values, camera.as_ref(), &textures)?;
        let request = self.gradients;
        let gradient = self.with(py, move |state| {
            if !state.latest.as_ref().is_some_and(|latest| latest.is(&point)) {
                state.pictures(&point)?;
            }
            let pulled = state.renderer.pull_back(&by_pixels, request).map_err(Raise::raise)?;
            match pulled {
                Some(gradient) => Ok(gradient),
                None => unreachable!("the pictures are there"),
            }
        })?;
        Gradients::of(py, self.textures.pull_back(&self.base, gradient), &self.textures.columns())
    }

    /// Name, width and height of each view.
    #[getter]
    fn views(&self) -> Vec<(String, u32, u32)> {
        self.cameras.iter().map(|camera| (camera.name.clone(), camera.width, camera.height)).collect()
    }

    /// Passes (applications of the transport) so far.
    #[getter]
    fn passes(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |state| Ok(state.renderer.passes()))
    }
}
