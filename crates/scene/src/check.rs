//! The one check of a scene. Later layers rely on what it guarantees.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::settings::check_target_error;
use super::{Camera, Material, Mesh, Normalization, Scene, SceneError, Sun, Triangle};

/// A quarter of the range of 32-bit indices, so that sums over corners and bins stay within it.
pub(super) const MAX_TRIANGLES: u64 = u32::MAX as u64 / 4;
/// Below this area over longest edge squared, a triangle's normal is lost to the rounding of f64.
const FLAT: f64 = 1e-12;
const MAX_POWER: f64 = 1e5;
/// From this total albedo on, a closed room takes hundreds of passes, and the energy that transport loses or gains per
/// pass accumulates as often.
const HIGH_ALBEDO: f64 = 0.95;

impl Scene {
    /// A scene of one mesh in memory, with default settings and no camera, checked.
    ///
    /// Vertices in metres. Triangles without area are recorded with a warning, as by [`Scene::check`] without `strict`.
    ///
    /// # Errors
    /// Fails if the scene does not pass [`Scene::check`].
    pub fn new(
        name: impl Into<String>,
        vertices: Vec<DVec3>,
        triangles: Vec<Triangle>,
        materials: Vec<Material>,
    ) -> Result<Self, SceneError> {
        let name = name.into();
        let count = u32::try_from(triangles.len()).unwrap_or(u32::MAX);
        let mut scene = Self {
            meshes: vec![Mesh { name: name.clone(), range: 0..count }],
            name,
            vertices,
            triangles,
            materials,
            patterns: Default::default(),
            suns: Vec::new(),
            origins: Vec::new(),
            cameras: Vec::new(),
            settings: Default::default(),
            target_error: None,
            degenerate: Vec::new(),
            creases: Vec::new(),
            warnings: Vec::new(),
            given: None,
        };
        scene.check(false)?;
        Ok(scene)
    }

    /// Adds a sun.
    ///
    /// # Errors
    /// Fails if the sun does not pass [`Sun::check`].
    pub fn add_sun(&mut self, sun: Sun) -> Result<(), SceneError> {
        sun.check().map_err(|message| SceneError::Sun { number: self.suns.len(), message })?;
        self.suns.push(sun);
        Ok(())
    }

    /// Adds a camera, or replaces the one of the same name.
    ///
    /// # Errors
    /// Fails if the camera does not pass [`Camera::check`].
    pub fn set_camera(&mut self, camera: Camera) -> Result<(), SceneError> {
        camera.check()?;
        match self.cameras.iter_mut().find(|c| c.name == camera.name) {
            Some(old) => *old = camera,
            None => self.cameras.push(camera),
        }
        Ok(())
    }

    /// Checks everything that a solve relies on. Call it after changing a scene by hand.
    ///
    /// Fills [`Scene::degenerate`] and adds to [`Scene::warnings`]. With `strict`, triangles without area are an error.
    ///
    /// # Errors
    /// Fails if an index, a coordinate, the range of a mesh, a material, a sun, a setting or a camera is invalid,
    /// or if the scene has no triangles or too many. With `strict`, fails also if a triangle has no area.
    pub fn check(&mut self, strict: bool) -> Result<(), SceneError> {
        self.check_counts()?;
        self.check_triangles()?;
        self.find_degenerate(strict)?;
        self.check_size()?;
        self.check_suns(Sun::check)?;
        self.check_materials(Emission::Light)?.into_iter().for_each(|warning| self.warn(warning));
        self.settings.check()?;
        check_target_error(self.target_error)?;
        self.cameras.iter().try_for_each(Camera::check)
    }

    /// Checks geometry, materials and suns, all that light depends on, and changes nothing. Everything that solves a scene calls
    /// this, since the fields of a scene are public.
    ///
    /// # Errors
    /// Fails if an index, a coordinate, the range of a mesh, a material or a sun is invalid, or if the scene has
    /// no triangles or too many.
    #[doc(hidden)]
    pub fn validate(&self) -> Result<(), SceneError> {
        self.check_counts()?;
        self.check_geometry()?;
        self.check_suns(Sun::check)?;
        self.check_materials(Emission::Light).map(drop)
    }

    /// Checks a scene as [`Scene::validate`] does, but allows negative emission and negative irradiance by suns.
    /// Light is linear in both, so that differences of scenes can be solved too.
    #[doc(hidden)]
    pub fn validate_linear(&self) -> Result<(), SceneError> {
        self.check_counts()?;
        self.check_geometry()?;
        self.check_suns(Sun::check_linear)?;
        self.check_materials(Emission::Difference).map(drop)
    }

    /// Checks indices and coordinates, all that pictures depend on.
    #[doc(hidden)]
    pub fn check_geometry(&self) -> Result<(), SceneError> {
        self.check_triangles()?;
        match self.degenerate.iter().find(|&&t| t as usize >= self.triangles.len()) {
            Some(&triangle) => Err(SceneError::UnknownDegenerate { triangle, count: self.triangles.len() }),
            None => Ok(()),
        }
    }

    /// Name of the mesh of a triangle.
    pub(super) fn mesh_name(&self, triangle: usize) -> String {
        let holds = |m: &&Mesh| (m.range.start as usize..m.range.end as usize).contains(&triangle);
        self.meshes.iter().find(holds).map_or(String::new(), |m| m.name.clone())
    }

    pub(super) fn warn(&mut self, warning: String) {
        // A second check of the same scene must not repeat a warning.
        if !self.warnings.contains(&warning) {
            self.warnings.push(warning);
        }
    }

    fn check_counts(&self) -> Result<(), SceneError> {
        if self.triangles.is_empty() {
            return Err(SceneError::NoTriangles);
        }
        let limited = |what, count: usize, limit: u64| match count as u64 > limit {
            true => Err(SceneError::TooMany { what, count: count as u64, limit }),
            false => Ok(()),
        };
        limited("triangles", self.triangles.len(), MAX_TRIANGLES)?;
        limited("vertices", self.vertices.len(), u32::MAX as u64)?;
        let mut next = 0;
        for mesh in &self.meshes {
            if mesh.range.start != next || mesh.range.end < next {
                let message =
                    format!("\"{}\" has {:?}, but the next starts at {next}", mesh.name, mesh.range);
                return Err(SceneError::Meshes { message });
            }
            next = mesh.range.end;
        }
        match next as usize == self.triangles.len() {
            true => Ok(()),
            false => {
                Err(SceneError::Meshes { message: format!("they end at {next} of {}", self.triangles.len()) })
            }
        }
    }

    fn check_triangles(&self) -> Result<(), SceneError> {
        let out_of_range = |triangle, what, index, count| SceneError::Index {
            mesh: self.mesh_name(triangle),
            triangle,
            what,
            index,
            count,
        };
        let mut used = vec![false; self.vertices.len()];
        for (at, triangle) in self.triangles.iter().enumerate() {
            for vertex in triangle.vertices {
                let Some(&position) = self.vertices.get(vertex as usize) else {
                    return Err(out_of_range(at, "vertex", vertex, self.vertices.len()));
                };
                if !position.is_finite() {
                    return Err(SceneError::Vertex {
                        mesh: self.mesh_name(at),
                        triangle: at,
                        vertex,
                        position,
                    });
                }
                used[vertex as usize] = true;
            }
            if triangle.material as usize >= self.materials.len() {
                return Err(out_of_range(at, "material", triangle.material, self.materials.len()));
            }
        }
        match (0..used.len()).find(|&v| !used[v] && !self.vertices[v].is_finite()) {
            Some(vertex) => Err(SceneError::UnusedVertex { vertex }),
            None => Ok(()),
        }
    }

    /// Updates the list of triangles without area after vertices have moved.
    #[doc(hidden)]
    pub fn update_degenerate(&mut self) {
        self.degenerate =
            (0..self.triangles.len()).filter(|&t| is_flat(self.corners(t))).map(|t| t as u32).collect();
    }

    fn find_degenerate(&mut self, strict: bool) -> Result<(), SceneError> {
        self.update_degenerate();
        let Some(&first) = self.degenerate.first() else {
            return Ok(());
        };
        let (count, triangle) = (self.degenerate.len(), first as usize);
        let mesh = self.mesh_name(triangle);
        if strict {
            return Err(SceneError::Degenerate { count, mesh, triangle });
        }
        if count == self.triangles.len() {
            return Err(SceneError::NoArea);
        }
        self.warn(format!(
            "{count} triangle(s) have no area and take no part; \
             the first is triangle {triangle} of mesh \"{mesh}\"."
        ));
        Ok(())
    }

    fn check_suns(&self, check: impl Fn(&Sun) -> Result<(), String>) -> Result<(), SceneError> {
        let wrong = |(number, sun)| check(sun).err().map(|message| SceneError::Sun { number, message });
        self.suns.iter().enumerate().find_map(wrong).map_or(Ok(()), Err)
    }

    /// Warnings about the materials; an error at the first that is not physical.
    fn check_materials(&self, emission: Emission) -> Result<Vec<String>, SceneError> {
        let mut used = vec![false; self.materials.len()];
        for triangle in &self.triangles {
            used[triangle.material as usize] = true;
        }
        // Triangles with textures use copies with their means: NAME.1, NAME.2, …
        let originals: HashSet<String> = (self.materials.iter().zip(&used))
            .filter(|(_, used)| **used)
            .filter_map(|(material, _)| material.name.rsplit_once('.'))
            .filter(|(_, number)| number.parse::<u32>().is_ok())
            .map(|(name, _)| name.to_owned())
            .collect();
        let mut lobes = LobeCache::default();
        let mut warnings = Vec::new();
        for (material, used) in self.materials.iter().zip(used) {
            let name = &material.name;
            match (material.problem(emission, &mut lobes), used) {
                (Err(message), true) => {
                    return Err(SceneError::Material { name: name.clone(), message });
                }
                (Err(message), false) if !originals.contains(name) => {
                    warnings.push(format!("Material \"{name}\", which no triangle uses: {message}."));
                }
                (Ok(albedo), true) if albedo >= HIGH_ALBEDO => warnings.push(format!(
                    "Material \"{name}\" reflects up to {albedo:.3} of the light: \
                     in a closed room the solve takes many passes, whose small errors add up; \
                     settings.near_field = 400 keeps their sum below 1 %."
                )),
                _ => {}
            }
        }
        warnings.extend(self.darkness());
        Ok(warnings)
    }

    /// Warns of a scene in which nothing emits.
    pub(super) fn warn_if_dark(&mut self) {
        self.darkness().into_iter().for_each(|warning| self.warn(warning));
    }

    fn darkness(&self) -> Option<String> {
        let shines = |light: [f64; 3]| light.iter().any(|&l| l > 0.0);
        let lit = self.suns.iter().any(|sun| shines(sun.irradiance))
            || self.triangles.iter().any(|t| shines(self.materials[t.material as usize].emission));
        (!lit).then(|| {
            String::from(
                "No material in use has an emission, so there is no light: the picture will be black. Give one an emission, or add \
                 light from all around: --sky 1, or [sky] or [sun] of a scene file.",
            )
        })
    }
}

/// True if the corners span no area, or so little that rounding decides the normal.
fn is_flat([a, b, c]: [DVec3; 3]) -> bool {
    let edges = [b - a, c - b, a - c];
    let longest = edges.iter().map(|e| e.abs().max_element()).fold(0.0, f64::max);
    if longest == 0.0 {
        return true;
    }
    // In units of the longest edge, so that squares of tiny or huge edges stay within the range of f64.
    let [ab, bc, ca] = edges.map(|e| e / longest);
    let squared = ab.length_squared().max(bc.length_squared()).max(ca.length_squared());
    let area = ab.cross(ca).length() / 2.0;
    // NaN where the length of an edge overflows.
    area.is_nan() || area < FLAT * squared
}

/// What the emission of a material means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Emission {
    /// Radiance, which is not negative.
    Light,
    /// A difference of radiances, of either sign.
    Difference,
}

/// Albedo of the specular lobe for σ = 1, by power and normalization.
#[derive(Default)]
struct LobeCache(HashMap<(u64, Normalization), f64>);

impl LobeCache {
    fn get(&mut self, material: &Material) -> f64 {
        let key = (material.power.to_bits(), material.normalization);
        *self.0.entry(key).or_insert_with(|| material.specular_albedo_per_sigma())
    }
}

/// Largest emission, radiance and irradiance: what they add up to, and its squares, must fit f64.
const MOST_LIGHT: f64 = 1e100;

/// Checks that light is a number that can be computed with.
///
/// # Errors
/// Fails if a value is negative, not finite, or beyond [`MOST_LIGHT`]. The error begins with the value.
pub(super) fn check_light(values: impl IntoIterator<Item = f64>) -> Result<(), String> {
    match values.into_iter().find(|x| !(0.0..=MOST_LIGHT).contains(x)) {
        Some(wrong) if wrong > MOST_LIGHT && wrong.is_finite() => Err(format!(
            "{wrong:e}; it must be at most {MOST_LIGHT:e}: light adds up, so state all of it in a larger unit"
        )),
        Some(wrong) => Err(format!("{wrong}; it must be finite and 0 or more")),
        None => Ok(()),
    }
}

impl Material {
    /// The total albedo, or below [`HIGH_ALBEDO`] an upper bound of it. The error says what is wrong, and the remedy.
    fn problem(&self, emission: Emission, lobes: &mut LobeCache) -> Result<f64, String> {
        let emission = match emission {
            Emission::Light => self.emission,
            Emission::Difference => self.emission.map(f64::abs),
        };
        let numbers = [
            ("diffuse", vec![self.diffuse]),
            ("albedo", self.albedo.to_vec()),
            ("specular", self.specular.to_vec()),
            ("power", vec![self.power]),
        ];
        for (what, values) in numbers {
            if let Some(value) = values.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
                return Err(format!("{what} is {value}; it must be finite and 0 or more"));
            }
        }
        check_light(emission).map_err(|wrong| format!("emission is {wrong}"))?;
        if self.power > MAX_POWER {
            return Err(format!("power is {}; it must lie in 0 to {MAX_POWER}", self.power));
        }
        let most = self.total_albedo_with(if self.is_glossy() { self.specular_albedo_bound() } else { 0.0 });
        if most < HIGH_ALBEDO {
            // Skips the integral over the lobe, which takes milliseconds.
            return Ok(most);
        }
        let lobe = if self.is_glossy() { lobes.get(self) } else { 0.0 };
        let total = self.total_albedo_with(lobe);
        if total < 1.0 {
            return Ok(total);
        }
        let diffuse = self.diffuse_albedo().into_iter().fold(0.0, f64::max);
        if diffuse >= 1.0 {
            return Err(format!(
                "the diffuse albedo is {diffuse:.3}; lower diffuse or albedo until it is below 1"
            ));
        }
        let factor = (1.0 - diffuse) / (total - diffuse);
        let other = match self.normalization {
            Normalization::Phong => ", or set normalization = \"energy\"",
            Normalization::Energy => "",
        };
        Err(format!(
            "the total albedo is {total:.3} (diffuse up to {diffuse:.3}, the rest specular); it must be below 1: \
             multiply specular by less than {factor:.3}{other}"
        ))
    }
}
