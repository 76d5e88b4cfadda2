//! The specification of what to fit.

use antirad_base::setters;
use antirad_render::render::Quantity;
use serde::Serialize;

/// Which triangles share a value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Per {
    /// All triangles of a material.
    #[default]
    Material,
    /// All triangles of a mesh.
    Mesh,
    /// All triangles of a label of the targets' segmentation ([`segments`](crate::segments)); of what none labels, those of a mesh.
    Segment,
    /// Each triangle has its own value.
    Triangle,
    /// Each texel of a texture over the texture coordinates of each mesh.
    Texel,
}

/// How positions may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionKind {
    /// Each vertex separately; vertices at the same place move as one.
    Vertices,
    /// Translation.
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

/// Members that share a value, or move together, by name.
pub type Groups = Vec<(String, Vec<u32>)>;

/// One quantity to fit, where, and within which bounds.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Fit {
    /// The quantity.
    pub quantity: Quantity,
    /// Names of materials; triangles with both a material and a mesh listed are fitted. `None`: all.
    pub materials: Option<Vec<String>>,
    /// Names of meshes. `None`: all.
    pub meshes: Option<Vec<String>>,
    /// For cameras: names of those of targets. `None`: all.
    pub cameras: Option<Vec<String>>,
    /// Which triangles share a value.
    pub per: Per,
    /// Triangles that share a value, or views whose cameras move together, with a name for each group, in place of [`Self::per`]: for example candidates for lamps
    /// ([`candidates`](crate::candidates)). They must be among those selected.
    pub groups: Option<Groups>,
    /// For [`Per::Texel`]: columns and rows of each texture; `None`: 64.
    pub resolution: Option<u32>,
    /// For positions, and for cameras that move together: how they may change.
    pub motion: MotionKind,
    /// The meshes move as one body instead of separately; of cameras, those of each set of photographs ([`Target::set`](crate::Target::set)).
    pub together: bool,
    /// Lower bound in the unit of the quantity; for positions and cameras, of the displacement from where they are given, m.
    pub lower: Option<[f64; 3]>,
    /// Upper bound, in the same unit as the lower one.
    pub upper: Option<[f64; 3]>,
    /// Initial value; `None`: that of the scene.
    pub initial: Option<[f64; 3]>,
    /// Largest component of a rotation vector, degrees; `None`: 180, and 5 for cameras.
    pub max_rotation_degrees: Option<f64>,
    /// Largest factor of size; its reciprocal is the smallest. `None`: 10, and 2 for cameras.
    pub max_scale: Option<f64>,
}

setters!(Fit {
    quantity: Quantity,
    materials: Option<Vec<String>>,
    meshes: Option<Vec<String>>,
    cameras: Option<Vec<String>>,
    per: Per,
    groups: Option<Groups>,
    resolution: Option<u32>,
    motion: MotionKind,
    together: bool,
    lower: Option<[f64; 3]>,
    upper: Option<[f64; 3]>,
    initial: Option<[f64; 3]>,
    max_rotation_degrees: Option<f64>,
    max_scale: Option<f64>,
});

impl Fit {
    /// Fits a quantity of the whole scene, per material; positions by rigid motions of each mesh.
    pub fn new(quantity: Quantity) -> Self {
        Self {
            quantity,
            materials: None,
            meshes: None,
            cameras: None,
            per: Per::default(),
            groups: None,
            resolution: None,
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
