//! What to fit, as it is asked for.

use super::super::gradient::Quantity;
use crate::options::setters;
use serde::Serialize;

/// What shares one value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Per {
    /// All triangles of a material.
    #[default]
    Material,
    /// All triangles of a mesh.
    Mesh,
    /// Nothing: each triangle has its own.
    Triangle,
}

/// How positions may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionKind {
    /// Every vertex for itself; vertices at the same place move as one.
    Vertices,
    /// The mesh moves as it is.
    Translation,
    /// Translation and rotation.
    Rigid,
    /// A factor about the centre of the mesh's bounding box.
    Scale,
    /// Translation, rotation and scale.
    Similarity,
}

impl MotionKind {
    /// Whether translation, rotation and scale are unknown.
    pub(super) fn parts(self) -> [bool; 3] {
        match self {
            Self::Vertices => [false; 3],
            Self::Translation => [true, false, false],
            Self::Rigid => [true, true, false],
            Self::Scale => [false, false, true],
            Self::Similarity => [true; 3],
        }
    }
}

/// One thing to fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Fit {
    /// What is unknown.
    pub quantity: Quantity,
    /// Names of materials and meshes: what has both is fitted. `None`: all.
    pub materials: Option<Vec<String>>,
    /// The same of meshes.
    pub meshes: Option<Vec<String>>,
    /// What shares one value.
    pub per: Per,
    /// Of positions: how they may change.
    pub motion: MotionKind,
    /// The meshes move as one body, rather than each for itself.
    pub together: bool,
    /// In the unit of the quantity; of a position, the way from where it stands in the scene, metres.
    pub lower: Option<[f64; 3]>,
    /// The same from above.
    pub upper: Option<[f64; 3]>,
    /// Where to start; `None`: what the scene has.
    pub initial: Option<[f64; 3]>,
    /// Largest component of a rotation vector, degrees.
    pub max_rotation_degrees: Option<f64>,
    /// Largest factor of size, and largest to divide it by.
    pub max_scale: Option<f64>,
}

setters!(Fit {
    quantity: Quantity,
    materials: Option<Vec<String>>,
    meshes: Option<Vec<String>>,
    per: Per,
    motion: MotionKind,
    together: bool,
    lower: Option<[f64; 3]>,
    upper: Option<[f64; 3]>,
    initial: Option<[f64; 3]>,
    max_rotation_degrees: Option<f64>,
    max_scale: Option<f64>,
});

impl Fit {
    /// A quantity of the whole scene, per material; positions as rigid motions of each mesh.
    pub fn new(quantity: Quantity) -> Self {
        Self {
            quantity,
            materials: None,
            meshes: None,
            per: Per::default(),
            motion: MotionKind::Rigid,
            together: false,
            lower: None,
            upper: None,
            initial: None,
            max_rotation_degrees: None,
            max_scale: None,
        }
    }
}
