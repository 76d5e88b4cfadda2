//! The f64 twin of every transport kernel on the CPU, written to be read: the definition that kernels are tested against.
//!
//! Each operator is linear, and states once which entries of light it reads, which it adds to, and with which weights: the operator and
//! its transpose follow. The weights are generic over a scalar type: of dual numbers, they give the derivatives, those of the model as
//! computed, including interpolation weights, both levels of the near field and their blending. Where a derivative does not exist (edges
//! of bins with bilinear weights, the pole, a triangle in the horizon of another) or a pair exchanges no light, it is zero or one-sided,
//! and always finite.
#![warn(missing_docs)]

mod exchange;
mod light;
mod lines;
mod observation;
mod operator;
mod reflection;
mod variables;

pub use exchange::Exchange;
pub use light::{Outgoing, State};
pub use observation::{observe, observe_adjoint, observe_derivative};
pub use operator::AdjointEquation;
pub use reflection::{MaterialGradient, emission, reflect_adjoint, reflect_derivative};

use antirad_core::model::{Bins, Class, Facet, classify};
use antirad_scene::{Material, Scene};

/// A discretised scene: facets, materials and bins, by index of the triangle in the scene.
pub struct Model {
    /// Geometry of each triangle.
    pub facets: Vec<Facet>,
    /// Material of each triangle.
    pub materials: Vec<Material>,
    /// Class of each triangle, which decides whether it has bins.
    pub classes: Vec<Class>,
    /// Direction bins of the hemisphere.
    pub bins: Bins,
    /// The range of the near field, as in [`SolveSettings`](antirad_scene::SolveSettings).
    pub near_field: f64,
    /// First bin of each triangle in [`State::bins`]; `None` where it has no bins.
    slots: Vec<Option<usize>>,
}

impl Model {
    /// The model of a scene, with the classes that the plan chooses.
    pub fn new(scene: &Scene) -> Self {
        Self::with_classes(scene, classify(scene))
    }

    /// The model of a scene with given classes: to show that what the plan omits changes nothing, or what
    /// happens without J.
    pub fn with_classes(scene: &Scene, classes: Vec<Class>) -> Self {
        let bins = Bins::new(scene.settings.bins);
        let mut next = 0;
        let slots = classes
            .iter()
            .map(|class| {
                class.has_bins().then(|| {
                    next += bins.count();
                    next - bins.count()
                })
            })
            .collect();
        Self {
            facets: (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect(),
            materials: (0..scene.triangles.len()).map(|i| scene.material(i).clone()).collect(),
            classes,
            bins,
            near_field: scene.settings.near_field,
            slots,
        }
    }
}
