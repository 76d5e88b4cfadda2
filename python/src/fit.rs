//! Fits of scenes to pictures.

use crate::arrays::{self, Array, Numbers, Triple};
use crate::backend::{self, Backend};
use crate::errors::{OrRaise, Raise, exceptions, invalid, word};
use crate::plan::from_json;
use crate::resolved::warn_of_visibility;
use crate::scene::{Camera, Scene};
use crate::work::{self, Report, callback, record_dict};
use antirad::fit::{
    self, EngineRenderer, FitError, FolderLock, Job, JobFile, LockError, Noise, OnCheckpoint, Photographs,
    Response, RunOptions, Settings, StopRule, USUAL_PIXELS,
};
use antirad::glam::DVec3;
use antirad::output::prepare_directory;
use antirad::scene::CameraSet;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// A quantity to fit, where, and within which bounds.
///
/// Args:
///     quantity: "emission", "albedo", "diffuse", "specular", "power", "position" or "camera" (position and rotation).
///     materials: Names of materials; triangles with both a material and a mesh listed are fitted. None: all.
///     meshes: Names of meshes. None: all.
///     cameras: Names of the cameras of targets, for "camera". None: all.
///     per: Which triangles share a value: "material", "mesh", "segment" (of `load_targets`) or "triangle"; or "texel", an albedo as a
///         texture for each mesh.
///     resolution: Columns and rows of such a texture; by default 64.
///     motion: How positions may change, or cameras together: "rigid", "translation", "scale" or "similarity"; positions also as
///         "vertices".
///     together: Whether the meshes move as one body, or the cameras of each set of photographs do.
///     lower: Lower bound, one number or three, in the unit of the quantity; for positions and cameras of the displacement,
///         metres.
///     upper: Upper bound.
///     initial: Initial value; by default the scene's.
///     max_rotation_degrees: Largest component of a rotation vector.
///     max_scale: Largest factor of size; its reciprocal is the smallest.
///
/// Raises:
///     ValueError: A word is unknown.
#[pyclass(frozen, module = "antirad", skip_from_py_object)]
#[derive(Clone)]
pub struct Fit {
    inner: fit::Fit,
}

#[pymethods]
impl Fit {
    #[new]
    #[pyo3(signature = (quantity, *, materials=None, meshes=None, cameras=None, per="material", resolution=None, motion="rigid",
        together=false, lower=None, upper=None, initial=None, max_rotation_degrees=None, max_scale=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn new(
        quantity: &str,
        materials: Option<Vec<String>>,
        meshes: Option<Vec<String>>,
        cameras: Option<Vec<String>>,
        per: &str,
        resolution: Option<u32>,
        motion: &str,
        together: bool,
        lower: Option<Triple>,
        upper: Option<Triple>,
        initial: Option<Triple>,
        max_rotation_degrees: Option<f64>,
        max_scale: Option<f64>,
    ) -> PyResult<Self> {
        let inner = fit::Fit::new(word("quantity", quantity)?)
            .materials(materials)
            .meshes(meshes)
            .cameras(cameras)
            .per(word("per", per)?)
            .resolution(resolution)
            .motion(word("motion", motion)?)
            .together(together)
            .lower(lower.map(Into::into))
            .upper(upper.map(Into::into))
            .initial(initial.map(Into::into))
            .max_rotation_degrees(max_rotation_degrees)
            .max_scale(max_scale);
        Ok(Self { inner })
    }

    fn __repr__(&self) -> String {
        format!("Fit({:?})", self.inner.quantity.word())
    }
}

/// A picture to be explained.
///
/// Args:
///     camera: The camera that took it.
///     picture: Linear RGB, (height, width, 3), W/(m² sr), rows from the top.
///     mask: Weight of each pixel, (height, width), 0 to 1; by default 1.
///     weight: Weight relative to other pictures.
///     noise: Shot and read noise: a channel v has the variance shot · v + read². The losses "huber" and "relative-l2" count for less
///         what it may have changed.
///
/// Raises:
///     ValueError: An array has the wrong shape, or a noise is negative or nothing.
///     PictureError: A pixel that counts is not finite, or none counts.
#[pyclass(frozen, module = "antirad", skip_from_py_object)]
#[derive(Clone)]
pub struct Target {
    inner: fit::Target,
}

#[pymethods]
impl Target {
    #[new]
    #[pyo3(signature = (camera, picture, *, mask=None, weight=1.0, noise=None))]
    fn new(
        camera: &Camera,
        picture: Numbers,
        mask: Option<Numbers>,
        weight: f64,
        noise: Option<(f64, f64)>,
    ) -> PyResult<Self> {
        let camera = camera.inner.clone();
        let pixels = arrays::pixels("picture", &picture, camera.width, camera.height)?;
        let mask = match mask {
            Some(mask) => {
                if *mask.shape != [camera.height as usize, camera.width as usize] {
                    return Err(invalid(format!(
                        "mask has the shape {}; it must be ({}, {})",
                        arrays::shown(&mask.shape),
                        camera.height,
                        camera.width
                    )));
                }
                Some(mask.values)
            }
            None => None,
        };
        let inner = fit::Target::new(camera, pixels, mask, weight).or_raise()?;
        Ok(Self { inner: fit::Target { noise: checked(noise)?, ..inner } })
    }

    /// The camera that took it.
    #[getter]
    fn camera(&self) -> Camera {
        Camera { inner: self.inner.camera.clone() }
    }

    /// The picture, float64 (height, width, 3), linear RGB, rows from the top: W/(m² sr), up to the exposure of a photograph.
    #[getter]
    fn picture<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        let pixels = self.inner.pixels.iter().map(|pixel| pixel.to_array()).collect();
        arrays::picture::<f64>(py, pixels, self.inner.camera.width)
    }

    fn __repr__(&self) -> String {
        format!("<Target of camera {:?}>", self.inner.camera.name)
    }
}

/// A noise, unless it is none.
fn checked(noise: Option<(f64, f64)>) -> PyResult<Option<Noise>> {
    let noise = noise.map(|(shot, read)| Noise { shot, read });
    noise.iter().try_for_each(Noise::check).map_err(invalid)?;
    Ok(noise)
}

/// An assumption about the scene, with its weight relative to the loss of the pictures.
#[pyclass(frozen, module = "antirad", skip_from_py_object)]
#[derive(Clone)]
pub struct Regulariser {
    inner: fit::Regulariser,
}

#[pymethods]
impl Regulariser {
    /// Neighbours on a mesh are alike in a quantity.
    #[staticmethod]
    fn smoothness(of: &str, weight: f64) -> PyResult<Self> {
        Ok(Self { inner: fit::Regulariser::Smoothness { of: word("of", of)?, weight } })
    }

    /// Meshes keep their shape.
    #[staticmethod]
    fn laplacian(weight: f64) -> Self {
        Self { inner: fit::Regulariser::Laplacian { weight } }
    }

    /// Few triangles emit.
    #[staticmethod]
    fn sparsity(weight: f64) -> Self {
        Self { inner: fit::Regulariser::Sparsity { weight } }
    }

    /// Textures are even but for edges.
    #[staticmethod]
    fn total_variation(weight: f64) -> Self {
        Self { inner: fit::Regulariser::TotalVariation { weight } }
    }

    /// A quantity stays near a value, one number or three; by default near its initial one. `names`: of which materials or meshes; by
    /// default of all that are fitted.
    #[staticmethod]
    #[pyo3(signature = (of, weight, value=None, names=None))]
    fn prior(of: &str, weight: f64, value: Option<Triple>, names: Option<Vec<String>>) -> PyResult<Self> {
        let value = value.map(Into::into);
        Ok(Self { inner: fit::Regulariser::Prior { of: word("of", of)?, names, value, weight } })
    }

    fn __repr__(&self) -> String {
        format!("<Regulariser: {}, weight {}>", self.inner.assumption(), self.inner.weight())
    }
}

/// What a fit found.
#[pyclass(frozen, module = "antirad")]
pub struct FitResult {
    inner: fit::Outcome,
    /// Width of each picture.
    widths: Vec<u32>,
    warnings: Vec<String>,
}

#[pymethods]
impl FitResult {
    /// The scene with the values found.
    #[getter]
    fn scene(&self) -> Scene {
        Scene::of(self.inner.scene.clone())
    }

    /// The values found: dictionaries with `quantity`, `of`, `unit`, `value`, `initial` and `at_bound`.
    #[getter]
    fn recovered<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        from_json(py, &self.inner.recovered)
    }

    /// One dictionary per iteration, the start first: `iteration`, `loss`, `gradient`, `step`, `evaluations`, `passes`, and
    /// `first_stage`: whether `progress` is told of the stage before the texels of textures.
    #[getter]
    fn history<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        self.inner.history.iter().map(|record| record_dict(py, record)).collect()
    }

    /// The final picture of each target, float64 (height, width, 3), W/(m² sr).
    #[getter]
    fn pictures<'py>(&self, py: Python<'py>) -> PyResult<Vec<Array<'py>>> {
        let pictures = self.inner.pictures.iter().zip(&self.widths);
        let rgb = |pixels: &Vec<DVec3>| pixels.iter().map(|pixel| pixel.to_array()).collect();
        pictures.map(|(pixels, &width)| arrays::picture::<f64>(py, rgb(pixels), width)).collect()
    }

    /// Final loss, regularisers included.
    #[getter]
    fn loss(&self) -> f64 {
        self.inner.loss
    }

    /// Why it ended, in words.
    #[getter]
    fn stop(&self) -> &'static str {
        self.inner.stop.reason()
    }

    /// Time of all runs together, s.
    #[getter]
    fn seconds(&self) -> f64 {
        self.inner.seconds
    }

    /// Warnings in whole sentences, such as of parameters that no picture shows.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    fn __repr__(&self) -> String {
        let iterations = self.inner.history.last().map_or(0, |record| record.iteration);
        format!("<FitResult: loss {:.3e} after {iterations} iterations>", self.inner.loss)
    }
}

/// Finds the values of a scene that explain pictures of it.
///
/// Args:
///     scene: The scene, with initial values.
///     targets: Pictures.
///     fits: What to find.
///     loss: "l2", "l1", "relative-l2", "log-l1" or "huber", which is that for photographs.
///     epsilon: ε of the last three losses, W/(m² sr); by default a hundredth of the mean picture, of "huber" a tenth.
///     regularisers: Assumptions.
///     optimiser: "auto", "quasi-newton" (L-BFGS-B), "adam" or "least-squares" (emission alone).
///     learning_rate: Of adam.
///     iterations: Largest number of iterations.
///     relative_decrease: Relative decrease of the loss over five iterations below which to stop.
///     seconds: Time limit, s.
///     supersample: Samples along each side of a pixel.
///     tolerance: Of solves; by default the scene's, but at most 1e-5.
///     checkpoints: Folder for checkpoints.
///     resume: Continue from a checkpoint there; otherwise one that is there is an error.
///     backend: By default the one that all such calls share, of the kind that the settings of the scene name.
///     progress: Called after each iteration with a dictionary as in `FitResult.history`; or True for a bar of tqdm. An
///         exception from it ends the fit.
///
/// Raises:
///     FitError: The arguments contradict each other, or the fit failed.
///     KeyboardInterrupt: Ctrl-C; with `checkpoints`, `resume=True` continues.
#[pyfunction(name = "fit")]
#[pyo3(signature = (scene, targets, fits, *, loss="l2", epsilon=None, regularisers=vec![], optimiser="auto",
    learning_rate=None, iterations=200, relative_decrease=1e-4, seconds=None, supersample=None, tolerance=None,
    checkpoints=None, resume=false, backend=None, progress=None),
    text_signature = "(scene, targets, fits, *, loss='l2', epsilon=None, regularisers=(), optimiser='auto', \
    learning_rate=None, iterations=200, relative_decrease=0.0001, seconds=None, supersample=None, tolerance=None, \
    checkpoints=None, resume=False, backend=None, progress=None)")]
#[expect(clippy::too_many_arguments, reason = "keyword arguments")]
pub fn fit_(
    py: Python<'_>,
    scene: &Scene,
    targets: Vec<PyRef<Target>>,
    fits: Vec<PyRef<Fit>>,
    loss: &str,
    epsilon: Option<f64>,
    regularisers: Vec<PyRef<Regulariser>>,
    optimiser: &str,
    learning_rate: Option<f64>,
    iterations: u32,
    relative_decrease: f64,
    seconds: Option<f64>,
    supersample: Option<u32>,
    tolerance: Option<f64>,
    checkpoints: Option<PathBuf>,
    resume: bool,
    backend: Option<&Backend>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<FitResult> {
    let fits = fits.iter().map(|fit| fit.inner.clone()).collect();
    let mut settings = Settings::new(fits)
        .loss(word("loss", loss)?)
        .epsilon(epsilon)
        .regularisers(regularisers.iter().map(|term| term.inner.clone()).collect())
        .optimiser(word("optimiser", optimiser)?)
        .tolerance(tolerance);
    if let Some(rate) = learning_rate {
        settings.adam = settings.adam.learning_rate(rate);
    }
    if let Some(supersample) = supersample {
        crate::engine::check_supersample(supersample)?;
        settings.supersample = supersample;
    }
    let stop = StopRule::default()
        .iterations(iterations)
        .relative_decrease(relative_decrease)
        .seconds(seconds.unwrap_or(f64::INFINITY));
    let targets = targets.iter().map(|target| target.inner.clone()).collect();
    let scene = (*scene.inner).clone();
    let name = scene.name.clone();
    let job = work::run(py, None, move |_| Job::new(name, scene, targets, settings))?.or_raise()?;
    run(py, job, RunOptions::default().stop(stop), (checkpoints, resume), backend, progress, Vec::new())
}

/// Runs a job file, as `antirad fit` does.
///
/// Args:
///     path: The file.
///     iterations: Largest number of iterations; by default that of the file.
///     checkpoints: Folder for checkpoints.
///     resume: Continue from a checkpoint there; otherwise one that is there is an error.
///     backend: By default the one that all such calls share, of the kind that the settings of the scene name.
///     progress: As in `fit`.
///
/// Raises:
///     SceneError: The file or its scene is invalid; the message names file, line and remedy.
///     FitError: The fit failed.
///     KeyboardInterrupt: Ctrl-C; with `checkpoints`, `resume=True` continues.
#[pyfunction]
#[pyo3(signature = (path, *, iterations=None, checkpoints=None, resume=false, backend=None, progress=None))]
pub fn fit_job(
    py: Python<'_>,
    path: PathBuf,
    iterations: Option<u32>,
    checkpoints: Option<PathBuf>,
    resume: bool,
    backend: Option<&Backend>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<FitResult> {
    let file = work::run(py, None, move |_| JobFile::load(&path))?.or_raise()?;
    let mut stop = file.stop;
    stop.iterations = iterations.unwrap_or(stop.iterations);
    let options = RunOptions::default().checkpoint_every(file.checkpoint_every).stop(stop);
    run(py, file.job, options, (checkpoints, resume), backend, progress, file.warnings)
}

fn run(
    py: Python<'_>,
    mut job: Job,
    options: RunOptions,
    (checkpoints, resume): (Option<PathBuf>, bool),
    backend: Option<&Backend>,
    progress: Option<Bound<'_, PyAny>>,
    mut warnings: Vec<String>,
) -> PyResult<FitResult> {
    let parameters = &job.problem().parameters;
    warn_of_visibility(py, parameters.base(), parameters.gradient_request())?;
    let choice = parameters.base().settings.backend;
    let backend = backend::chosen(py, backend, choice)?;
    let progress = callback(py, progress, "fit_bar", options.stop.iterations)?;
    let on_checkpoint = if resume { OnCheckpoint::Resume } else { OnCheckpoint::Refuse };
    let options = options.on_checkpoint(on_checkpoint).checkpoints(checkpoints.clone());
    let widths = job.problem().targets.iter().map(|target| target.camera.width).collect();
    let result = work::run(py, progress, move |link| {
        let _lock = match &checkpoints {
            Some(folder) => {
                prepare_directory(folder).or_raise()?;
                match FolderLock::take(folder) {
                    // Not every file system has locks.
                    Err(LockError::Unavailable { .. }) => None,
                    taken => Some(taken.map_err(FitError::from).or_raise()?),
                }
            }
            None => None,
        };
        let problem = job.problem();
        let parameters = &problem.parameters;
        let (planning, gradients) = (parameters.planning_scene(), parameters.gradient_request());
        let supersample = job.settings().supersample;
        let mut renderer = EngineRenderer::new(&backend, planning, supersample, gradients, link.watch())
            .or_raise()?
            .movable(parameters.movable())
            .paintings(parameters.paintings());
        job.estimate(&mut renderer).or_raise()?;
        let seen = renderer.seen().or_raise()?;
        warnings.extend(job.problem().parameters.unseen(&seen).iter().map(ToString::to_string));
        let report = link.reporter();
        let outcome = job.run(&mut renderer, &options, &mut |record, _| {
            report(Report::Fit(*record));
            link.flow()
        });
        match outcome {
            Ok(outcome) => Ok((outcome, warnings)),
            Err(error @ FitError::Interrupted { .. }) => {
                Err(exceptions::FitError::new_err(error.to_string()))
            }
            Err(error) => Err(error.raise()),
        }
    })?;
    let (inner, warnings) = result?;
    Ok(FitResult { inner, widths, warnings })
}

/// The cameras of a set of photographs: centred pinholes with the horizontal fields of view and the sizes of their lenses.
///
/// Args:
///     path: A transforms.json (NeRF, Blender, instant-ngp, nerfstudio), or the folder of a COLMAP model.
///
/// Raises:
///     SceneError: The set cannot be read; the message names the frame.
#[pyfunction]
pub fn load_cameras(py: Python<'_>, path: PathBuf) -> PyResult<Vec<Camera>> {
    let cameras = work::run(py, None, move |_| {
        let photographs = Photographs::new(CameraSet::read(&path)?);
        photographs.set.frames.iter().map(|frame| photographs.camera_of(frame)).collect::<Result<Vec<_>, _>>()
    })?
    .or_raise()?;
    Ok(cameras.into_iter().map(|inner| Camera { inner }).collect())
}

/// A target for each photograph of a set, averaged down in linear light. Exposures and white balances of JPEG, PNG and integer TIFF
/// are found by `fit`, and their clipped pixels are lower bounds.
///
/// Args:
///     path: A transforms.json (NeRF, Blender, instant-ngp, nerfstudio), or the folder of a COLMAP model.
///     images: Folder of the pictures, if not that of the set.
///     suffix: Suffix of the pictures, if not that in the set, such as ".exr".
///     mask: Path of masks, in which `{name}` stands for the name of the frame.
///     segments: Path of segmentation pictures in the same way: one colour for each material, for `Fit(per="segment")`.
///     noise: Shot and read noise of a pixel of the files, in units of white, as of `Target`.
///     layer: Layer of EXR files.
///     every: Each n-th frame only.
///     response: How numbers of integer formats follow from radiance: "srgb", "linear", "gamma", or "fit", one curve for all pictures
///         that `fit` finds. By default "srgb".
///     gamma: The exponent of "gamma".
///     pixels: Largest number of pixels of all pictures together. They are averaged down by the smallest whole number that keeps it.
///
/// Raises:
///     SceneError: The set cannot be read.
///     PictureError: A picture cannot be read, or does not fit its camera; the message names the frame.
///     ValueError: `every` or `pixels` is 0, `response` is unknown, `gamma` is not above 0, or a noise is negative or nothing.
#[pyfunction]
#[pyo3(signature = (path, *, images=None, suffix=None, mask=None, segments=None, noise=None, layer=None, every=1, response=None,
    gamma=2.2, pixels=USUAL_PIXELS),
    text_signature = "(path, *, images=None, suffix=None, mask=None, segments=None, noise=None, layer=None, every=1, \
    response=None, gamma=2.2, pixels=2_000_000)")]
#[expect(clippy::too_many_arguments, reason = "keyword arguments")]
pub fn load_targets(
    py: Python<'_>,
    path: PathBuf,
    images: Option<PathBuf>,
    suffix: Option<String>,
    mask: Option<PathBuf>,
    segments: Option<PathBuf>,
    noise: Option<(f64, f64)>,
    layer: Option<String>,
    every: usize,
    response: Option<&str>,
    gamma: f64,
    pixels: usize,
) -> PyResult<Vec<Target>> {
    let response = match response {
        Some("gamma") if gamma > 0.0 && gamma.is_finite() => Some(Response::Gamma(gamma)),
        Some("gamma") => return Err(invalid(format!("gamma is {gamma}; it must be above 0, and finite"))),
        response => response.map(|response| word("response", response)).transpose()?,
    };
    if every == 0 || pixels == 0 {
        return Err(invalid("every and pixels must be 1 or more".to_owned()));
    }
    let noise = checked(noise)?;
    let targets = work::run(py, None, move |_| -> PyResult<_> {
        let mut set = CameraSet::read(&path).or_raise()?;
        set.frames = set.frames.into_iter().step_by(every).collect();
        let photographs = Photographs::new(set).images(images).suffix(suffix).mask(mask).layer(layer);
        let photographs = photographs.segments(segments).noise(noise).response(response);
        let shrink = photographs.shrink_to(pixels);
        photographs.shrink(shrink).targets().map_err(exceptions::PictureError::new_err)
    })??;
    Ok(targets.into_iter().map(|inner| Target { inner }).collect())
}

/// Reads a picture, EXR, PNG, JPEG, TIFF or Radiance HDR, as float64 (height, width, 3): linear RGB, rows from the top.
///
/// Args:
///     path: The file. Integer formats are decoded from sRGB.
///     white: Radiance of white in an integer format, W/(m² sr).
///
/// Raises:
///     PictureError: The file is no such picture.
#[pyfunction]
#[pyo3(signature = (path, *, white=1.0))]
pub fn read_picture(py: Python<'_>, path: PathBuf, white: f64) -> PyResult<Array<'_>> {
    let picture = work::run(py, None, move |_| fit::TargetPicture::read(&path, white))?.or_raise()?;
    arrays::picture(py, picture.pixels.into_iter().map(Into::into).collect(), picture.width)
}
