//! Scenes, materials and cameras: values that never change; `replace` makes changed ones.

use crate::arrays::{self, Array, Numbers, Triple};
use crate::errors::{OrRaise, invalid, word};
use crate::resolved::{self, Resolved};
use crate::work;
use antirad::export::{Format, export};
use antirad::glam::DVec3;
use antirad::scene::{self, BinLayout, LoadOptions, Mesh, Normalization, Orient, Sky, Sun, Triangle};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyRange};
use std::path::PathBuf;
use std::sync::Arc;

/// A Blinn-Phong material: f = δρ/π + σ N(p) ⟨h,n⟩^p, in 1/sr.
///
/// Args:
///     name: By which fits and messages refer to it.
///     albedo: ρ; one number or RGB, as specular and emission.
///     diffuse: δ, the factor on the albedo.
///     specular: σ.
///     power: p, 0 or more.
///     emission: Emitted radiance, W/(m² sr), the same in all directions.
///     normalization: "phong" or "energy", the scale of the specular lobe.
///
/// A scene refuses materials that reflect all light or more.
#[pyclass(frozen, eq, module = "antirad", skip_from_py_object)]
#[derive(Clone, PartialEq)]
pub struct Material {
    pub inner: scene::Material,
}

#[pymethods]
impl Material {
    #[new]
    #[pyo3(signature = (name, *, albedo=Triple::One(0.0), diffuse=1.0, specular=Triple::One(0.0), power=0.0,
        emission=Triple::One(0.0), normalization="phong"),
        text_signature = "(name, *, albedo=0.0, diffuse=1.0, specular=0.0, power=0.0, emission=0.0, \
        normalization='phong')")]
    fn new(
        name: String,
        albedo: Triple,
        diffuse: f64,
        specular: Triple,
        power: f64,
        emission: Triple,
        normalization: &str,
    ) -> PyResult<Self> {
        let normalization: Normalization = word("normalization", normalization)?;
        let (albedo, specular, emission) = (albedo.into(), specular.into(), emission.into());
        Ok(Self {
            inner: scene::Material { name, diffuse, albedo, specular, power, emission, normalization },
        })
    }

    /// Name.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Albedo ρ, RGB.
    #[getter]
    fn albedo(&self) -> (f64, f64, f64) {
        self.inner.albedo.into()
    }

    /// Diffuse constant δ.
    #[getter]
    fn diffuse(&self) -> f64 {
        self.inner.diffuse
    }

    /// Specular constant σ, RGB.
    #[getter]
    fn specular(&self) -> (f64, f64, f64) {
        self.inner.specular.into()
    }

    /// Power p.
    #[getter]
    fn power(&self) -> f64 {
        self.inner.power
    }

    /// Emitted radiance, RGB, W/(m² sr).
    #[getter]
    fn emission(&self) -> (f64, f64, f64) {
        self.inner.emission.into()
    }

    /// "phong" or "energy".
    #[getter]
    fn normalization(&self) -> &'static str {
        match self.inner.normalization {
            Normalization::Phong => "phong",
            Normalization::Energy => "energy",
        }
    }

    fn __repr__(&self) -> String {
        let scene::Material { name, albedo, emission, .. } = &self.inner;
        format!("Material({name:?}, albedo={albedo:?}, emission={emission:?})")
    }
}

/// A pinhole camera, right-handed.
///
/// Args:
///     position: Centre of projection, metres.
///     target: A point on the optical axis, metres.
///     up: A direction that points up in the picture.
///     fov_x_degrees: Horizontal field of view, between 0 and 180.
///     width: Columns of its pictures.
///     height: Rows of its pictures.
///     name: By which scenes and messages refer to it.
///
/// Raises:
///     SceneError: A value is out of range.
#[pyclass(frozen, eq, module = "antirad", skip_from_py_object)]
#[derive(Clone, PartialEq)]
pub struct Camera {
    pub inner: scene::Camera,
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (position, target, *, up=[0.0, 1.0, 0.0], fov_x_degrees=45.0, width=256, height=256,
        name=String::from("camera")),
        text_signature = "(position, target, *, up=(0.0, 1.0, 0.0), fov_x_degrees=45.0, width=256, height=256, \
        name='camera')")]
    fn new(
        position: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        fov_x_degrees: f64,
        width: u32,
        height: u32,
        name: String,
    ) -> PyResult<Self> {
        let (position, target, up) = (position.into(), target.into(), up.into());
        let inner = scene::Camera { name, position, target, up, fov_x_degrees, width, height };
        inner.check().or_raise()?;
        Ok(Self { inner })
    }

    /// The same camera with some values replaced.
    #[pyo3(signature = (*, position=None, target=None, up=None, fov_x_degrees=None, width=None, height=None, name=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn replace(
        &self,
        position: Option<[f64; 3]>,
        target: Option<[f64; 3]>,
        up: Option<[f64; 3]>,
        fov_x_degrees: Option<f64>,
        width: Option<u32>,
        height: Option<u32>,
        name: Option<String>,
    ) -> PyResult<Self> {
        let old = &self.inner;
        Self::new(
            position.unwrap_or(old.position.into()),
            target.unwrap_or(old.target.into()),
            up.unwrap_or(old.up.into()),
            fov_x_degrees.unwrap_or(old.fov_x_degrees),
            width.unwrap_or(old.width),
            height.unwrap_or(old.height),
            name.unwrap_or_else(|| old.name.clone()),
        )
    }

    /// Name.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Centre of projection, metres.
    #[getter]
    fn position(&self) -> (f64, f64, f64) {
        self.inner.position.into()
    }

    /// A point on the optical axis, metres.
    #[getter]
    fn target(&self) -> (f64, f64, f64) {
        self.inner.target.into()
    }

    /// A direction that points up in the picture.
    #[getter]
    fn up(&self) -> (f64, f64, f64) {
        self.inner.up.into()
    }

    /// Horizontal field of view, degrees.
    #[getter]
    fn fov_x_degrees(&self) -> f64 {
        self.inner.fov_x_degrees
    }

    /// Columns of its pictures.
    #[getter]
    fn width(&self) -> u32 {
        self.inner.width
    }

    /// Rows of its pictures.
    #[getter]
    fn height(&self) -> u32 {
        self.inner.height
    }

    fn __repr__(&self) -> String {
        let scene::Camera { name, position, target, fov_x_degrees, width, height, .. } = &self.inner;
        format!(
            "Camera({:?}, {:?}, fov_x_degrees={fov_x_degrees}, width={width}, height={height}, name={name:?})",
            position.to_array(),
            target.to_array()
        )
    }
}

/// A checked scene: triangles, materials, cameras and the settings of a solve. It never changes; `replace` and
/// `with_settings` return changed scenes.
///
/// Triangles are one-sided, counter-clockwise seen from the front: the front emits, reflects and blocks light, the back is
/// black. All results keep the order of the triangles.
#[pyclass(frozen, weakref, module = "antirad", skip_from_py_object)]
#[derive(Clone)]
pub struct Scene {
    pub inner: Arc<scene::Scene>,
}

impl Scene {
    pub fn of(inner: scene::Scene) -> Self {
        Self { inner: Arc::new(inner) }
    }

    /// The cameras with some names; all of them by default.
    pub fn chosen(&self, views: Option<Vec<String>>) -> PyResult<Vec<scene::Camera>> {
        let cameras = match views {
            None => self.inner.cameras.clone(),
            Some(names) => names.iter().map(|name| self.named(name)).collect::<PyResult<_>>()?,
        };
        match cameras.is_empty() {
            true => Err(invalid("the scene has no camera; add one with scene.replace(cameras=[...])")),
            false => Ok(cameras),
        }
    }

    fn named(&self, name: &str) -> PyResult<scene::Camera> {
        self.inner.camera(name).cloned().ok_or_else(|| {
            let names: Vec<&str> = self.inner.cameras.iter().map(|camera| camera.name.as_str()).collect();
            invalid(format!("there is no camera {name:?}; the scene has {}", names.join(", ")))
        })
    }

    /// One value per material.
    fn numbers<'py>(&self, py: Python<'py>, of: impl Fn(&scene::Material) -> f64) -> PyResult<Array<'py>> {
        arrays::vector(py, self.inner.materials.iter().map(of).collect())
    }

    /// Three values per material.
    fn colours<'py>(
        &self,
        py: Python<'py>,
        of: impl Fn(&scene::Material) -> [f64; 3],
    ) -> PyResult<Array<'py>> {
        arrays::rows(py, self.inner.materials.iter().map(of).collect())
    }
}

#[pymethods]
impl Scene {
    /// Loads and checks a scene: `.toml`, glTF (`.gltf`, `.glb`), Mitsuba 3 (`.xml`), or a mesh (`.obj` with its MTL, `.ply`).
    ///
    /// Args:
    ///     path: The file.
    ///     strict: Refuse what is otherwise mended or left out with a warning: triangles without area (listed in `degenerate`),
    ///         materials of mesh files that reflect all light or more, missing materials.
    ///     orient: `"auto"` turns faces of mesh files where closed shells say which way they should face, `"keep"` none.
    ///     two_sided: Give open sheets a second side.
    ///
    /// Raises:
    ///     SceneError: The message names file, line and remedy.
    #[staticmethod]
    #[pyo3(signature = (path, *, strict=false, orient="auto", two_sided=false))]
    fn load(py: Python<'_>, path: PathBuf, strict: bool, orient: &str, two_sided: bool) -> PyResult<Self> {
        let orient = match orient {
            "auto" => Orient::Auto,
            "keep" => Orient::Keep,
            other => return Err(invalid(format!("orient is {other:?}; it must be \"auto\" or \"keep\""))),
        };
        let options = LoadOptions::default().strict(strict).orient(orient).two_sided(two_sided);
        let loaded = work::run(py, None, move |_| scene::Scene::load(&path, &options))?;
        Ok(Self::of(loaded.or_raise()?))
    }

    /// A scene from arrays.
    ///
    /// Args:
    ///     vertices: Positions, (V, 3), metres.
    ///     triangles: Indices of their corners, (T, 3), counter-clockwise seen from the front.
    ///     materials: Materials.
    ///     cameras: Cameras, with different names.
    ///     material_of: Index of the material of each triangle, (T,); by default 0 for all.
    ///     meshes: Name and number of triangles of each run of triangles, together all of them; by default one mesh.
    ///         Fits refer to meshes by name.
    ///     name: Name of the scene, for messages and files.
    ///
    /// Raises:
    ///     ValueError: An array has the wrong shape.
    ///     SceneError: An index is out of range, a vertex is not finite, a material reflects all light or more.
    #[staticmethod]
    #[pyo3(signature = (vertices, triangles, materials, cameras=vec![], *, material_of=None, meshes=None,
        name=String::from("scene")),
        text_signature = "(vertices, triangles, materials, cameras=(), *, material_of=None, meshes=None, name='scene')")]
    fn from_arrays(
        vertices: Numbers,
        triangles: Numbers<i64>,
        materials: Vec<PyRef<Material>>,
        cameras: Vec<PyRef<Camera>>,
        material_of: Option<Numbers<i64>>,
        meshes: Option<Vec<(String, u32)>>,
        name: String,
    ) -> PyResult<Self> {
        let vertices = arrays::vectors("vertices", &vertices, None)?;
        let corners = arrays::triples("triangles", &triangles, None)?;
        let material_of = match material_of {
            Some(of) => arrays::scalars("material_of", &of, corners.len())?,
            None => vec![0; corners.len()],
        };
        // What is out of range stays so, and the check names the triangle.
        let index = |value: i64| u32::try_from(value).unwrap_or(u32::MAX);
        let triangle = |(corners, material): ([i64; 3], i64)| Triangle {
            vertices: corners.map(index),
            material: index(material),
        };
        let triangles = corners.into_iter().zip(material_of).map(triangle).collect();
        let materials = materials.iter().map(|material| material.inner.clone()).collect();
        let mut scene = scene::Scene::new(name, vertices, triangles, materials).or_raise()?;
        if let Some(meshes) = meshes {
            let mut next = 0_u32;
            let run = |(name, count): (String, u32)| {
                let start = next;
                next = next.saturating_add(count);
                Mesh { name, range: start..next }
            };
            scene.meshes = meshes.into_iter().map(run).collect();
        }
        scene.cameras = distinct(cameras)?;
        scene.check(false).or_raise()?;
        Ok(Self::of(scene))
    }

    /// The scene in light from all around: with a mesh "sky" around it and its cameras, after its own triangles, which emits inwards.
    ///
    /// Args:
    ///     radiance: One number or RGB, W/(m² sr).
    ///
    /// Raises:
    ///     ValueError: A radiance is negative or not finite.
    fn with_sky(&self, radiance: Triple) -> PyResult<Self> {
        let sky = Sky::uniform(radiance.into());
        sky.check().map_err(|message| invalid(format!("the sky {message}")))?;
        let mut scene = scene::Scene::clone(&self.inner);
        scene.add_sky(&sky);
        scene.warnings.clear();
        scene.check(false).or_raise()?;
        Ok(Self::of(scene))
    }

    /// The scene in the light of one more sun, which comes from one direction, beyond everything. It is not seen itself.
    ///
    /// Args:
    ///     direction: The direction in which light travels, (3,), of any length: (0, -1, 0) from the zenith.
    ///     irradiance: Of a surface that faces the sun; one number or RGB, W/m².
    ///     angular_diameter: The angle at which it is seen, degrees, from 0.01 to 90.
    ///
    /// Raises:
    ///     SceneError: A value is out of range.
    #[pyo3(signature = (direction, irradiance, *, angular_diameter=Sun::DIAMETER),
        text_signature = "($self, direction, irradiance, *, angular_diameter=0.53)")]
    fn with_sun(&self, direction: [f64; 3], irradiance: Triple, angular_diameter: f64) -> PyResult<Self> {
        let sun = Sun { angular_diameter, ..Sun::new(direction.into(), irradiance.into()) };
        let mut scene = scene::Scene::clone(&self.inner);
        scene.add_sun(sun).or_raise()?;
        scene.warnings.clear();
        scene.check(false).or_raise()?;
        Ok(Self::of(scene))
    }

    /// Writes the scene as a TOML file with its meshes and materials beside it.
    ///
    /// Raises:
    ///     OSError: A file cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let scene = self.inner.clone();
        work::run(py, None, move |_| scene.save(&path).map(|_| ()))?.or_raise()
    }

    /// Writes the scene for another program, by the name's extension: `.glb` (glTF 2.0), `.xml` (Mitsuba 3, with a PLY for each mesh
    /// and material beside it) or `.ply` (one mesh, albedo as colours of faces).
    ///
    /// Raises:
    ///     ValueError: The extension is another.
    ///     OSError: A file cannot be written.
    fn export(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let formats = [Format::Gltf, Format::Mitsuba, Format::Ply];
        let Some(format) = formats.into_iter().find(|format| format.extension() == extension) else {
            return Err(invalid(format!("{}: expected .glb, .xml or .ply", path.display())));
        };
        let scene = self.inner.clone();
        work::run(py, None, move |_| export(&scene, format, &path, None))?.or_raise()
    }

    /// The scene with some values replaced, checked.
    ///
    /// Args:
    ///     vertices: Positions, (V, 3), metres.
    ///     emission: Emitted radiance of each material, (M, 3), W/(m² sr).
    ///     albedo: ρ of each material, (M, 3).
    ///     specular: σ of each material, (M, 3).
    ///     diffuse: δ of each material, (M,).
    ///     power: p of each material, (M,).
    ///     cameras: Cameras, with different names.
    ///
    /// Raises:
    ///     ValueError: An array has the wrong shape.
    ///     SceneError: The result is no valid scene.
    #[pyo3(signature = (*, vertices=None, emission=None, albedo=None, specular=None, diffuse=None, power=None,
        cameras=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn replace(
        &self,
        vertices: Option<Numbers>,
        emission: Option<Numbers>,
        albedo: Option<Numbers>,
        specular: Option<Numbers>,
        diffuse: Option<Numbers>,
        power: Option<Numbers>,
        cameras: Option<Vec<PyRef<Camera>>>,
    ) -> PyResult<Self> {
        let values = Values { vertices, emission, albedo, specular, diffuse, power };
        let mut scene = values.applied(&self.inner)?;
        if let Some(cameras) = cameras {
            scene.cameras = distinct(cameras)?;
        }
        scene.warnings.clear();
        scene.check(false).or_raise()?;
        Ok(Self::of(scene))
    }

    /// The scene with a material for each triangle, in their order: index i is triangle i's.
    fn per_triangle(&self) -> Self {
        Self::of(self.inner.with_emission(&[]))
    }

    /// The settings of a solve.
    #[getter]
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let settings = &self.inner.settings;
        let dict = PyDict::new(py);
        dict.set_item("bins", settings.bins.to_string())?;
        dict.set_item("near_field", settings.near_field)?;
        dict.set_item("tolerance", settings.tolerance)?;
        dict.set_item("max_passes", settings.max_passes)?;
        dict.set_item(
            "solver",
            match settings.solver {
                scene::SolverChoice::Auto => "auto",
                scene::SolverChoice::FixedPoint => "fixed-point",
                scene::SolverChoice::Gmres => "gmres",
            },
        )?;
        dict.set_item("precision", settings.precision.to_string())?;
        dict.set_item("backend", settings.backend.to_string())?;
        dict.set_item("lamps", format!("{:?}", settings.lamps).to_lowercase())?;
        dict.set_item("visibility", format!("{:?}", settings.visibility).to_lowercase())?;
        dict.set_item("ray_error", settings.ray_error)?;
        Ok(dict)
    }

    /// The scene with some settings replaced.
    ///
    /// Args:
    ///     bins: "10x13" (rows of polar angle times sectors of azimuth) or "concentric:12".
    ///     near_field: Range of the near field; 0 for none.
    ///     tolerance: Relative residual at which a solve stops, between 0 and 1.
    ///     max_passes: Passes after which a solve gives up.
    ///     solver: "auto", "fixed-point" or "gmres".
    ///     precision: "f32" or "f64".
    ///     lamps: How direct light is computed: "exact", "sampled" (by rays, without derivatives by positions),
    ///         "antiradiance", or "auto" by what it costs.
    ///     visibility: "explicit" (by rays, without derivatives by positions) or "implicit" (by antiradiance).
    ///     ray_error: Standard error of the irradiance that rays bring, relative to its mean over the area.
    ///
    /// Raises:
    ///     ValueError: A word is unknown.
    ///     SceneError: A number is out of range.
    #[pyo3(signature = (*, bins=None, near_field=None, tolerance=None, max_passes=None, solver=None,
        precision=None, lamps=None, visibility=None, ray_error=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments")]
    fn with_settings(
        &self,
        bins: Option<&str>,
        near_field: Option<f64>,
        tolerance: Option<f64>,
        max_passes: Option<u32>,
        solver: Option<&str>,
        precision: Option<&str>,
        lamps: Option<&str>,
        visibility: Option<&str>,
        ray_error: Option<f64>,
    ) -> PyResult<Self> {
        let mut scene = (*self.inner).clone();
        let settings = &mut scene.settings;
        if let Some(bins) = bins {
            settings.bins = bins.parse::<BinLayout>().map_err(invalid)?;
        }
        settings.near_field = near_field.unwrap_or(settings.near_field);
        settings.tolerance = tolerance.unwrap_or(settings.tolerance);
        settings.max_passes = max_passes.unwrap_or(settings.max_passes);
        settings.ray_error = ray_error.unwrap_or(settings.ray_error);
        if let Some(solver) = solver {
            settings.solver = word("solver", solver)?;
        }
        if let Some(precision) = precision {
            settings.precision = word("precision", precision)?;
        }
        if let Some(lamps) = lamps {
            settings.lamps = word("lamps", lamps)?;
        }
        if let Some(visibility) = visibility {
            settings.visibility = word("visibility", visibility)?;
        }
        settings.check().or_raise()?;
        Ok(Self::of(scene))
    }

    /// The scene with nothing left to decide, as the command line solves it: its mesh is cut where light varies within triangles.
    ///
    /// Args:
    ///     cut: Whether triangles may be cut.
    #[pyo3(signature = (*, cut=true))]
    fn resolved(&self, py: Python<'_>, cut: bool) -> PyResult<Resolved> {
        resolved::resolved(py, self, cut)
    }

    /// The camera with a name; by default the only one.
    ///
    /// Raises:
    ///     ValueError: There is no such camera, or there are several.
    #[pyo3(signature = (name=None))]
    pub fn camera(&self, name: Option<&str>) -> PyResult<Camera> {
        let inner = match (name, self.inner.cameras.as_slice()) {
            (Some(name), _) => self.named(name)?,
            (None, [only]) => only.clone(),
            (None, cameras) => {
                return Err(invalid(format!(
                    "the scene has {} cameras; give the name of one",
                    cameras.len()
                )));
            }
        };
        Ok(Camera { inner })
    }

    /// Where a triangle comes from, such as `room.obj:17 (triangle 5 of mesh "room")`.
    fn place_of(&self, triangle: usize) -> PyResult<String> {
        let count = self.inner.triangles.len();
        match triangle < count {
            true => Ok(self.inner.place_of(triangle)),
            false => Err(invalid(format!("there is no triangle {triangle}; the scene has {count}, from 0"))),
        }
    }

    /// Name.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Positions, float64 (V, 3), metres. A copy.
    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::points(py, self.inner.vertices.clone())
    }

    /// Indices of the corners of each triangle, int64 (T, 3). A copy.
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::rows(
            py,
            self.inner.triangles.iter().map(|triangle| triangle.vertices.map(i64::from)).collect(),
        )
    }

    /// Index of the material of each triangle, int64 (T,). A copy.
    #[getter]
    fn material_of<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::vector(
            py,
            self.inner.triangles.iter().map(|triangle| triangle.material.into()).collect::<Vec<i64>>(),
        )
    }

    /// Area of each triangle, float64 (T,), m².
    #[getter]
    fn areas<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        let area = |triangle| self.inner.area_vector(triangle).length();
        arrays::vector(py, (0..self.inner.triangles.len()).map(area).collect())
    }

    /// Materials.
    #[getter]
    fn materials(&self) -> Vec<Material> {
        self.inner.materials.iter().map(|material| Material { inner: material.clone() }).collect()
    }

    /// Cameras.
    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.inner.cameras.iter().map(|camera| Camera { inner: camera.clone() }).collect()
    }

    /// Direction, irradiance (RGB, W/m²) and angular diameter (degrees) of each sun, as for `with_sun`.
    #[getter]
    fn suns(&self) -> Vec<(Rgb, Rgb, f64)> {
        let values = |sun: &Sun| (sun.direction.into(), sun.irradiance.into(), sun.angular_diameter);
        self.inner.suns.iter().map(values).collect()
    }

    /// Name and triangles of each mesh.
    #[getter]
    fn meshes<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyRange>)>> {
        let run = |mesh: &Mesh| {
            let range = PyRange::new(py, mesh.range.start as isize, mesh.range.end as isize)?;
            Ok((mesh.name.clone(), range))
        };
        self.inner.meshes.iter().map(run).collect()
    }

    /// Emitted radiance of each material, float64 (M, 3), W/(m² sr). A copy, like the following.
    #[getter]
    fn emission<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.colours(py, |material| material.emission)
    }

    /// Albedo ρ of each material, float64 (M, 3).
    #[getter]
    fn albedo<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.colours(py, |material| material.albedo)
    }

    /// Specular constant σ of each material, float64 (M, 3).
    #[getter]
    fn specular<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.colours(py, |material| material.specular)
    }

    /// Diffuse constant δ of each material, float64 (M,).
    #[getter]
    fn diffuse<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.numbers(py, |material| material.diffuse)
    }

    /// Power p of each material, float64 (M,).
    #[getter]
    fn power<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        self.numbers(py, |material| material.power)
    }

    /// Triangles without area, int64: they take no part in light transport.
    #[getter]
    fn degenerate<'py>(&self, py: Python<'py>) -> PyResult<Array<'py>> {
        arrays::indices(py, &self.inner.degenerate)
    }

    /// What is probably a mistake, in whole sentences.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.inner.warnings.clone()
    }

    fn __repr__(&self) -> String {
        let scene::Scene { name, triangles, materials, cameras, .. } = &*self.inner;
        let (triangles, materials, cameras) = (triangles.len(), materials.len(), cameras.len());
        format!("<Scene {name:?}: {triangles} triangles, {materials} materials, {cameras} cameras>")
    }
}

/// Three numbers, as a tuple.
type Rgb = (f64, f64, f64);

fn distinct(cameras: Vec<PyRef<Camera>>) -> PyResult<Vec<scene::Camera>> {
    let cameras: Vec<scene::Camera> = cameras.iter().map(|camera| camera.inner.clone()).collect();
    for (i, camera) in cameras.iter().enumerate() {
        if cameras[..i].iter().any(|other| other.name == camera.name) {
            return Err(invalid(format!(
                "two cameras are named {:?}; give each a name of its own",
                camera.name
            )));
        }
    }
    Ok(cameras)
}

/// Values that replace those of a scene.
pub struct Values {
    pub vertices: Option<Numbers>,
    pub emission: Option<Numbers>,
    pub albedo: Option<Numbers>,
    pub specular: Option<Numbers>,
    pub diffuse: Option<Numbers>,
    pub power: Option<Numbers>,
}

impl Values {
    /// The scene with these values, not checked.
    pub fn applied(&self, to: &scene::Scene) -> PyResult<scene::Scene> {
        let mut scene = to.clone();
        if let Some(vertices) = &self.vertices {
            let vertices: Vec<DVec3> = arrays::vectors("vertices", vertices, Some(to.vertices.len()))?;
            scene.vertices = vertices;
        }
        let count = scene.materials.len();
        let mut colours = |what, values: &Option<Numbers>, set: fn(&mut scene::Material, [f64; 3])| {
            if let Some(values) = values {
                let values = arrays::triples(what, values, Some(count))?;
                scene.materials.iter_mut().zip(values).for_each(|(material, value)| set(material, value));
            }
            PyResult::Ok(())
        };
        colours("emission", &self.emission, |material, value| material.emission = value)?;
        colours("albedo", &self.albedo, |material, value| material.albedo = value)?;
        colours("specular", &self.specular, |material, value| material.specular = value)?;
        let mut numbers = |what, values: &Option<Numbers>, set: fn(&mut scene::Material, f64)| {
            if let Some(values) = values {
                let values = arrays::scalars(what, values, count)?;
                scene.materials.iter_mut().zip(values).for_each(|(material, value)| set(material, value));
            }
            PyResult::Ok(())
        };
        numbers("diffuse", &self.diffuse, |material, value| material.diffuse = value)?;
        numbers("power", &self.power, |material, value| material.power = value)?;
        Ok(scene)
    }
}
