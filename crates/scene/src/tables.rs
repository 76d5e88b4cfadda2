//! The tables of a scene file as deserialised from TOML, with their keys and types checked.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use glam::DVec3;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use toml::Spanned;

use super::error::{Place, SceneError};
use super::{
    BackendChoice, BinLayout, Camera, Lamps, Material, Normalization, Orient, Precision, Shape,
    SolveSettings, SolverChoice, VisibilityChoice,
};

/// Named tables; the span of a name is its position in the file.
pub(crate) type Named<T> = BTreeMap<Spanned<String>, T>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneTable {
    #[serde(default)]
    pub mesh: Vec<Spanned<MeshTable>>,
    #[serde(default)]
    pub material: Named<MaterialTable>,
    #[serde(default)]
    pub camera: Named<CameraTable>,
    pub sky: Option<Spanned<SkyTable>>,
    #[serde(default, deserialize_with = "one_or_more")]
    pub sun: Vec<SunTable>,
    pub settings: Option<Spanned<SettingsTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MeshTable {
    pub name: Option<String>,
    pub path: Option<Spanned<PathBuf>>,
    pub shape: Option<Spanned<Shape>>,
    pub material: Option<Spanned<String>>,
    #[serde(default, deserialize_with = "vector")]
    pub translate: DVec3,
    #[serde(default, deserialize_with = "vector")]
    pub rotate_degrees: DVec3,
    pub scale: Option<Spanned<Triple>>,
    pub subdivide: Option<Spanned<u32>>,
    pub two_sided: Option<bool>,
    pub orient: Option<Orient>,
    pub snap: Option<Spanned<f64>>,
    pub simplify: Option<u32>,
    pub objects: Option<bool>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MaterialTable {
    pub diffuse: Option<f64>,
    pub albedo: Option<Triple>,
    pub specular: Option<Triple>,
    pub power: Option<f64>,
    pub emission: Option<Triple>,
    pub normalization: Option<Normalization>,
    pub two_sided: Option<bool>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SkyTable {
    pub radiance: Option<Triple>,
    pub image: Option<Spanned<PathBuf>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SunTable {
    pub direction: Spanned<Vector>,
    pub irradiance: Triple,
    pub angular_diameter: Option<f64>,
}

/// Three finite numbers.
#[derive(Clone, Copy, Deserialize)]
pub(super) struct Vector(#[serde(deserialize_with = "vector")] pub DVec3);

/// `[NAME]`, or any number of `[[NAME]]`.
fn one_or_more<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    struct Tables<T>(std::marker::PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Tables<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            f.write_str("a table, or several")
        }

        fn visit_map<A: MapAccess<'de>>(self, table: A) -> Result<Vec<T>, A::Error> {
            T::deserialize(MapAccessDeserializer::new(table)).map(|one| vec![one])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, tables: A) -> Result<Vec<T>, A::Error> {
            Vec::deserialize(SeqAccessDeserializer::new(tables))
        }
    }

    deserializer.deserialize_any(Tables(std::marker::PhantomData))
}

impl MaterialTable {
    /// Sets the properties that the table gives; others keep their values.
    pub fn apply(&self, material: &mut Material) {
        material.diffuse = self.diffuse.unwrap_or(material.diffuse);
        material.albedo = self.albedo.map_or(material.albedo, |t| t.0);
        material.specular = self.specular.map_or(material.specular, |t| t.0);
        material.power = self.power.unwrap_or(material.power);
        material.emission = self.emission.map_or(material.emission, |t| t.0);
        material.normalization = self.normalization.unwrap_or(material.normalization);
    }
}

/// A camera in a TOML file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraTable {
    /// In metres.
    #[serde(deserialize_with = "vector")]
    pub position: DVec3,
    /// The point in the middle of the picture, in metres.
    #[serde(deserialize_with = "vector")]
    pub target: DVec3,
    /// Upwards in the picture.
    #[serde(default = "upwards", deserialize_with = "vector")]
    pub up: DVec3,
    /// Horizontal field of view; or the vertical one.
    pub fov_x_degrees: Option<f64>,
    /// Vertical field of view.
    pub fov_y_degrees: Option<f64>,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
}

fn upwards() -> DVec3 {
    DVec3::Y
}

impl CameraTable {
    /// The camera, with its field of view converted to horizontal.
    ///
    /// # Errors
    /// Fails unless exactly one field of view is given. Fails also if the vertical one is not between 0 and
    /// 180 degrees, or if it is given with a height of 0.
    pub fn camera(&self, name: String, place: Place) -> Result<Camera, SceneError> {
        let fov_x_degrees = match (self.fov_x_degrees, self.fov_y_degrees) {
            (Some(x), None) => x,
            (None, Some(y)) if y > 0.0 && y < 180.0 && self.height > 0 => {
                let aspect = f64::from(self.width) / f64::from(self.height);
                2.0 * ((y / 2.0).to_radians().tan() * aspect).atan().to_degrees()
            }
            (None, Some(y)) => {
                let height = self.height;
                return Err(place.error(format!(
                    "camera \"{name}\": fov_y_degrees is {y} and height {height}; \
                 the first must lie between 0 and 180, the second above 0"
                )));
            }
            (Some(_), Some(_)) | (None, None) => {
                return Err(place.error(format!(
                    "camera \"{name}\": give exactly one of fov_x_degrees and fov_y_degrees"
                )));
            }
        };
        Ok(Camera {
            name,
            position: self.position,
            target: self.target,
            up: self.up,
            fov_x_degrees,
            width: self.width,
            height: self.height,
        })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SettingsTable {
    pub error: Option<f64>,
    pub bins: Option<BinsTable>,
    pub near_field: Option<f64>,
    pub lamps: Option<Lamps>,
    pub tolerance: Option<f64>,
    pub max_passes: Option<u32>,
    pub solver: Option<SolverChoice>,
    pub precision: Option<Precision>,
    pub backend: Option<BackendChoice>,
    pub visibility: Option<VisibilityChoice>,
    pub ray_error: Option<f64>,
}

impl SettingsTable {
    /// The settings, with defaults for missing keys.
    pub fn settings(&self) -> SolveSettings {
        let default = SolveSettings::default();
        SolveSettings {
            bins: self.bins.map_or(default.bins, Into::into),
            near_field: self.near_field.unwrap_or(default.near_field),
            lamps: self.lamps.unwrap_or(default.lamps),
            tolerance: self.tolerance.unwrap_or(default.tolerance),
            max_passes: self.max_passes.unwrap_or(default.max_passes),
            solver: self.solver.unwrap_or(default.solver),
            precision: self.precision.unwrap_or(default.precision),
            backend: self.backend.unwrap_or(default.backend),
            visibility: self.visibility.unwrap_or(default.visibility),
            ray_error: self.ray_error.unwrap_or(default.ray_error),
        }
    }
}

impl SettingsTable {
    /// The target error. It excludes the settings that are chosen for it.
    ///
    /// # Errors
    /// Fails if a target error is given along with a setting that is chosen for it.
    pub fn target_error(&self) -> Result<Option<f64>, String> {
        let stated = [("bins", self.bins.is_some()), ("tolerance", self.tolerance.is_some())];
        match (self.error, stated.iter().find(|(_, stated)| *stated)) {
            (Some(_), Some((name, _))) => Err(format!(
                "`error` and `{name}` cannot both be given: bins, rays, mesh and tolerance are chosen for the error; \
                 remove one of the two"
            )),
            (error, _) => Ok(error),
        }
    }
}

/// `{ equal_angle = [10, 13] }` or `{ concentric = 12 }`.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum BinsTable {
    EqualAngle([u32; 2]),
    Concentric(u32),
}

impl From<BinsTable> for BinLayout {
    fn from(bins: BinsTable) -> Self {
        match bins {
            BinsTable::EqualAngle([theta, phi]) => Self::EqualAngle { theta, phi },
            BinsTable::Concentric(n) => Self::Concentric { n },
        }
    }
}

/// Three finite numbers, or one for all three.
#[derive(Clone, Copy)]
pub struct Triple(pub [f64; 3]);

impl<'de> Deserialize<'de> for Triple {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(TripleVisitor { one_for_all: true }).map(Self)
    }
}

fn vector<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DVec3, D::Error> {
    deserializer.deserialize_any(TripleVisitor { one_for_all: false }).map(DVec3::from)
}

struct TripleVisitor {
    one_for_all: bool,
}

impl<'de> Visitor<'de> for TripleVisitor {
    type Value = [f64; 3];

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(if self.one_for_all {
            "a number or three, like 0.5 or [1, 0.5, 0]"
        } else {
            "three numbers, like [1, 0.5, 0]"
        })
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<[f64; 3], E> {
        match (self.one_for_all, value.is_finite()) {
            (true, true) => Ok([value; 3]),
            (true, false) => Err(E::custom(format!("{value} is not finite"))),
            (false, _) => Err(E::invalid_type(serde::de::Unexpected::Float(value), &self)),
        }
    }

    fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<[f64; 3], E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<[f64; 3], A::Error> {
        let mut values = Vec::with_capacity(3);
        while let Some(value) = sequence.next_element::<f64>()? {
            if !value.is_finite() {
                return Err(A::Error::custom(format!("{value} is not finite")));
            }
            values.push(value);
        }
        <[f64; 3]>::try_from(values).map_err(|values| A::Error::invalid_length(values.len(), &self))
    }
}

/// Named tables in file order.
pub(crate) fn in_file_order<T>(tables: &Named<T>) -> Vec<(&Spanned<String>, &T)> {
    let mut ordered: Vec<_> = tables.iter().collect();
    ordered.sort_by_key(|(name, _)| name.span().start);
    ordered
}
