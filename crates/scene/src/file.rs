//! Loads a scene from a TOML file, or from a file of another program.

use antirad_base::setters;
use std::ops::Range;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;
use toml::Spanned;

use super::assembly::{Assembly, Mending, Most, Snap};
use super::error::{Place, SceneError};
use super::geometry::{Placement, RawMesh};
use super::mesh_file::{self, Contents};
use super::tables::{self, MeshTable, SceneTable, SkyTable, SunTable};
use super::toml_file::TomlFile;
use super::{Scene, Sky, Sun};

/// How to load a scene.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct LoadOptions {
    /// Refuse what is otherwise mended or left out with a warning: triangles without area ([`Scene::degenerate`]), materials of mesh
    /// files that reflect all light or more, and missing materials.
    pub strict: bool,
    /// Whether faces of mesh files are turned where closed shells say which way they should face; `orient` of a `[[mesh]]` takes
    /// precedence.
    pub orient: Orient,
    /// Give all sheets a second side; `two_sided` of a `[[mesh]]` or a material takes precedence.
    pub two_sided: bool,
    /// Metres. Within this distance mesh files are made for light, as scans need it: walls become planes, gaps close, and lamps become
    /// planar or convex; `snap` of a `[[mesh]]` takes precedence. A few times the error of a vertex.
    pub snap: Option<f64>,
    /// Most triangles of a mesh file: one with more is [simplified](Scene::with_given_meshes), 0 for none; `simplify` of a `[[mesh]]` takes
    /// precedence. By default, 10 000 for meshes that are snapped.
    pub simplify: Option<u32>,
    /// The sky, in place of one that the file gives.
    pub sky: Option<Sky>,
}

setters!(LoadOptions { strict: bool, orient: Orient, two_sided: bool, snap: Option<f64>, simplify: Option<u32>, sky: Option<Sky> });

/// Which way the faces of a mesh face.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Orient {
    /// Faces stay as in the file, except where a closed or nearly closed shell allows mending: faces that
    /// disagree with most of their shell are turned, and so is a shell whose backs alone can see lamps. A
    /// note says what was turned.
    #[default]
    Auto,
    /// Faces stay as in the file.
    Keep,
}

/// Most triangles that `subdivide` may turn a mesh into: as many as the finest statue has.
const MOST_SUBDIVIDED: u64 = 10_000_000;

impl Scene {
    /// Loads and checks a `.toml` scene, a glTF (`.gltf`, `.glb`), a scene of Mitsuba 3 (`.xml`), or a mesh:
    /// `.obj` with its MTL, `.ply`.
    ///
    /// A scene without a camera gets one named "auto" that frames its bounding box, with a warning in [`Scene::warnings`].
    ///
    /// A scene file (metres, degrees, emission as radiance in W/(m² sr)); everything but one mesh is optional:
    /// ```toml
    /// [[mesh]]
    /// path = "room.obj"              # relative to this file; or shape = { kind = "quad", cells = 8 }, see Shape
    /// material = "white"             # for all faces; required with a shape
    /// name = "room"
    /// scale = [1, 1, 1]              # or one number; then rotated about x, y, z; then moved
    /// rotate_degrees = [0, 90, 0]
    /// translate = [0, 0, 2]
    /// subdivide = 1                  # how many times every edge is halved
    /// two_sided = false              # true: open sheets get a second side, which reflects and blocks light like the first
    /// orient = "auto"                # or "keep": do not turn faces that disagree with their closed shell
    /// # objects = true               # each object of the file is a mesh by its name
    /// # snap = 0.01                  # metres: walls of a scan become planes, gaps close, lamps become planar or convex
    /// # simplify = 10000             # most triangles of the file; 0 keeps all, the default without `snap`
    ///
    /// [material.white]               # overrides the MTL, or defines a material from black
    /// diffuse = 1                    # δ
    /// albedo = [0.7, 0.7, 0.7]       # ρ: one number or RGB, as specular and emission
    /// specular = 0.05                # σ
    /// power = 20                     # p
    /// emission = 0
    /// normalization = "phong"        # or "energy"
    /// two_sided = false              # as for a mesh, which takes precedence
    ///
    /// [sky]                          # light from all around, behind everything: a mesh "sky" around scene and cameras
    /// radiance = [0.4, 0.5, 0.7]     # one number or RGB, W/(m² sr); factors of the image, where there is one
    /// # image = "sky.hdr"            # equirectangular, +y above, -z in the middle; HDR, EXR, PNG or JPEG
    ///
    /// [sun]                          # light from one direction; [[sun]] for each of several
    /// direction = [1, -2, 0.5]       # in which light travels
    /// irradiance = [90, 85, 80]      # of a surface that faces it: one number or RGB, W/m²
    /// angular_diameter = 0.53        # degrees, from 0.01 to 90
    ///
    /// [camera.main]
    /// position = [0, 1, 5]
    /// target = [0, 1, 0]
    /// up = [0, 1, 0]
    /// fov_x_degrees = 40             # or fov_y_degrees
    /// width = 640                    # pixels
    /// height = 480
    ///
    /// [settings]
    /// bins = { equal_angle = [10, 13] }  # or { concentric = 12 }
    /// near_field = 30
    /// lamps = "auto"                 # or "exact", "sampled", "antiradiance": the light that comes straight from emitters
    /// tolerance = 1e-4
    /// max_passes = 200
    /// solver = "auto"                # or "fixed-point", "gmres"
    /// precision = "f32"              # or "f64"
    /// backend = "auto"               # or "cpu", "vulkan": where light is computed; auto: on a GPU if there is one, else on the CPU
    /// visibility = "explicit"        # or "implicit"
    /// ray_error = 0.005              # standard error of the irradiance that rays bring, relative to its mean
    /// # error = 0.02                 # target error of irradiance, instead of bins, near_field and tolerance
    /// ```
    ///
    /// # Errors
    /// Fails if the format is unknown, if a file cannot be read or understood, or if the scene does not pass
    /// [`Scene::check`].
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Self, SceneError> {
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        let mut assembly = Assembly::new(path, stem(path));
        match extension.as_deref() {
            Some("toml") => TomlFile::read(path)?.assemble(&mut assembly, options)?,
            Some(known) if mesh_file::EXTENSIONS.contains(&known) => {
                let Contents { meshes, cameras, sky, suns } =
                    mesh_file::read(path, options.strict, &|_| false, assembly.warnings())?;
                let snap = assembly.snap(options)?;
                let mending = Mending {
                    orient: options.orient,
                    two_sided: None,
                    snap,
                    most: Most::new(options.simplify, snap.is_some()),
                    objects: false,
                };
                for (name, mut mesh) in meshes {
                    assembly.add_materials(&mut mesh)?;
                    assembly.add_mesh(name, path, mesh, mending, Place { path, line: 1 })?;
                }
                cameras.into_iter().for_each(|camera| assembly.add_camera(camera, 1));
                sky.into_iter().for_each(|sky| assembly.set_sky(sky));
                suns.into_iter().for_each(|sun| assembly.add_sun(sun));
            }
            _ => return Err(SceneError::UnknownFormat { path: path.to_path_buf() }),
        }
        assembly.finish(options)
    }
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

impl TomlFile<'_> {
    fn assemble(&self, assembly: &mut Assembly, options: &LoadOptions) -> Result<(), SceneError> {
        let tables: SceneTable = self.parse()?;

        // Materials before triangles: a mesh may use a material defined further down, or in another mesh's MTL.
        let defined = |name: &str| tables.material.keys().any(|key| key.get_ref() == name);
        let mut meshes = Vec::new();
        for table in &tables.mesh {
            // A mesh whose material is stated needs none of its file's.
            let known = |name: &str| table.get_ref().material.is_some() || defined(name);
            let mut mesh =
                self.read_mesh(table.get_ref(), table.span(), options, &known, assembly.warnings())?;
            assembly.add_materials(&mut mesh)?;
            meshes.push(mesh);
        }
        let materials = tables::in_file_order(&tables.material);
        for &(name, table) in &materials {
            assembly.override_material(name.get_ref(), table, self.place(name.span()));
        }
        for (table, mesh) in tables.mesh.iter().zip(meshes) {
            let place = self.place(table.get_ref().material.as_ref().map_or(table.span(), |m| m.span()));
            let table = table.get_ref();
            let (default_name, file) = match (&table.path, &table.shape) {
                (Some(path), _) => (stem(path.get_ref()), self.beside(path.get_ref())),
                (None, Some(shape)) => (shape.get_ref().kind().to_owned(), self.path.to_path_buf()),
                (None, None) => (String::from("mesh"), self.path.to_path_buf()),
            };
            // The faces of a shape are right.
            let usual = if table.shape.is_some() { Orient::Keep } else { options.orient };
            let snap = match &table.snap {
                Some(snap) => Some(Snap::new(*snap.get_ref(), self.place(snap.span()))?),
                None if table.shape.is_some() => None,
                None => assembly.snap(options)?,
            };
            let (orient, objects) = (table.orient.unwrap_or(usual), table.objects.unwrap_or(false));
            let most = match table.shape {
                Some(_) => Most::new(table.simplify, false),
                None => Most::new(table.simplify.or(options.simplify), snap.is_some()),
            };
            let mending = Mending { orient, two_sided: table.two_sided, snap, most, objects };
            assembly.add_mesh(table.name.clone().unwrap_or(default_name), &file, mesh, mending, place)?;
        }
        for (name, _) in materials {
            assembly.warn_if_unused(name.get_ref(), self.place(name.span()));
        }

        for (name, table) in tables::in_file_order(&tables.camera) {
            let place = self.place(name.span());
            assembly.add_camera(table.camera(name.get_ref().clone(), place)?, place.line);
        }
        if let (Some(table), None) = (&tables.sky, &options.sky) {
            assembly.set_sky(self.sky(table)?);
        }
        for table in &tables.sun {
            assembly.add_sun(self.sun(table)?);
        }
        if let Some(table) = &tables.settings {
            let place = self.place(table.span());
            let (line, target_error) = (place.line, table.get_ref().target_error());
            let target_error = target_error.map_err(|message| place.error(message))?;
            assembly.set_settings(table.get_ref().settings(), target_error, line);
        }
        Ok(())
    }

    fn sky(&self, table: &Spanned<SkyTable>) -> Result<Sky, SceneError> {
        let place = self.place(table.span());
        let SkyTable { radiance, image } = table.get_ref();
        match (radiance, image) {
            (Some(radiance), None) => {
                let sky = Sky::uniform(radiance.0);
                sky.check().map(|()| sky).map_err(|message| place.error(format!("the sky {message}")))
            }
            (scale, Some(image)) => {
                let file = self.beside(image.get_ref());
                Sky::read(&file, scale.map_or([1.0; 3], |scale| scale.0)).map_err(|message| {
                    self.place(image.span()).error(format!("{} {message}", file.display()))
                })
            }
            (None, None) => Err(place.error("a sky needs `radiance = NUMBER`, or `image = \"FILE\"`")),
        }
    }

    fn sun(&self, table: &SunTable) -> Result<Sun, SceneError> {
        let SunTable { direction, irradiance, angular_diameter } = table;
        let sun = Sun::new(direction.get_ref().0, irradiance.0);
        let sun = Sun { angular_diameter: angular_diameter.unwrap_or(sun.angular_diameter), ..sun };
        let place = self.place(direction.span());
        sun.check().map(|()| sun).map_err(|message| place.error(format!("the sun's {message}")))
    }

    /// All meshes of a file as one.
    fn read_file(
        &self,
        path: &Spanned<PathBuf>,
        options: &LoadOptions,
        known: &dyn Fn(&str) -> bool,
        warnings: &mut Vec<String>,
    ) -> Result<RawMesh, SceneError> {
        let file = self.beside(path.get_ref());
        let contents = mesh_file::read(&file, options.strict, known, warnings);
        let contents = contents.map_err(|error| match error {
            SceneError::Read { path: file, reason } => self
                .place(path.span())
                .error(format!("mesh file {} cannot be read: {reason}", file.display())),
            other => other,
        })?;
        Ok(contents.into_one())
    }

    /// The mesh of a table, subdivided and placed.
    fn read_mesh(
        &self,
        table: &MeshTable,
        span: Range<usize>,
        options: &LoadOptions,
        defined: &dyn Fn(&str) -> bool,
        warnings: &mut Vec<String>,
    ) -> Result<RawMesh, SceneError> {
        let place = self.place(span);
        let material = table.material.as_ref().map(|m| m.get_ref().as_str());
        let mut mesh =
            match (&table.path, &table.shape, material) {
                (Some(path), None, material) => {
                    let known = |name: &str| material.is_some() || defined(name);
                    let mesh = self.read_file(path, options, &known, warnings)?;
                    match material {
                        Some(material) => RawMesh {
                            face_lines: mesh.face_lines,
                            objects: mesh.objects,
                            ..RawMesh::uniform(mesh.vertices, mesh.faces, material)
                        },
                        None => mesh,
                    }
                }
                (None, Some(shape), Some(material)) => {
                    let place = self.place(shape.span());
                    shape.get_ref().validate().map_err(|message| place.error(message))?;
                    let (vertices, faces) = shape.get_ref().mesh();
                    RawMesh::uniform(vertices, faces, material)
                }
                (None, Some(_), None) => {
                    return Err(place
                        .error("a shape needs a material; add `material = \"NAME\"` and [material.NAME]"));
                }
                (Some(_), Some(_), _) => {
                    return Err(place
                        .error("a mesh has either `path` or `shape`, not both; split it into two meshes"));
                }
                (None, None, _) => {
                    return Err(place.error(
                        "a mesh without geometry; add `path = \"FILE.obj\"` or `shape = { kind = ... }`",
                    ));
                }
            };

        self.subdivide(&mut mesh, table)?;
        let scale = match &table.scale {
            Some(scale) if scale.get_ref().0.contains(&0.0) => {
                return Err(self
                    .place(scale.span())
                    .error("a scale of 0 flattens the mesh; use another factor"));
            }
            Some(scale) => DVec3::from(scale.get_ref().0),
            None => DVec3::ONE,
        };
        let placement = Placement { scale, rotate_degrees: table.rotate_degrees, translate: table.translate };
        placement.apply(&mut mesh);
        Ok(mesh)
    }

    fn subdivide(&self, mesh: &mut RawMesh, table: &MeshTable) -> Result<(), SceneError> {
        let Some(levels) = &table.subdivide else {
            return Ok(());
        };
        let (faces, times) = (mesh.faces.len() as u64, *levels.get_ref());
        let triangles = |times: u32| 4u64.checked_pow(times)?.checked_mul(faces);
        let fits = |&times: &u32| triangles(times).is_some_and(|count| count <= MOST_SUBDIVIDED);
        if times > 0 && !fits(&times) {
            let count = triangles(times).map_or("more than 10^19".to_owned(), |count| count.to_string());
            let highest = (1..).take_while(fits).last().unwrap_or(0);
            return Err(self.place(levels.span()).error(format!(
                "subdivide = {times} turns {faces} triangles into {count}, but at most {MOST_SUBDIVIDED} are possible; \
                 use {highest} or less"
            )));
        }
        for _ in 0..times {
            mesh.subdivide();
        }
        Ok(())
    }
}
