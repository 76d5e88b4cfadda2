//! The f64 twin of every transport kernel on the CPU, written to be read: the definition that kernels are tested against.

mod adjoint;
mod clusters;
mod clusters_adjoint;
mod derivative;
mod observation;
mod operator;
mod path_tracer;
mod random;
mod reflection;
mod scenes;
mod transport;
mod volumes;

pub use crate::model::projected_solid_angle;
pub use adjoint::{AdjointEquation, observe_adjoint, reflect_adjoint, transport_adjoint};
pub use clusters::transport_through_clusters;
pub use clusters_adjoint::transport_through_clusters_adjoint;
pub use derivative::{
    MaterialGradient, observe_derivative, reflect_derivative, transport_derivative,
    transport_through_clusters_derivative,
};
pub use observation::observe;
pub use path_tracer::{MonteCarloEstimate, PathTracer, TracedPicture, TracedPixel};
pub use random::Random;
pub use reflection::{emission, reflect};
pub use scenes::{Plates, Shadow};
pub use transport::{irradiance_of, transport};

use crate::model::{Bins, Class, Facet, classify};
use crate::scene::{Material, Scene};
use glam::DVec3;
use std::ops::Range;

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
    /// The range of the near field, as in [`SolveSettings`](crate::scene::SolveSettings).
    pub near_field: f64,
    /// First bin of each triangle in [`State::bins`]; `None` where it has no bins.
    slots: Vec<Option<usize>>,
}

/// Incident light H, RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Irradiance of each front, W/m².
    pub irradiance: Vec<DVec3>,
    /// Incident radiance per bin, H(b) / c_b, W/(m² sr), B entries for each triangle that has bins. In this form J is the
    /// identity: incident radiance at the front of a blocker is antiradiance A(b) of its back.
    pub bins: Vec<DVec3>,
}

/// Outgoing light C, RGB, W/(m² sr).
#[derive(Clone, Debug)]
pub struct Outgoing {
    /// Diffuse radiance of the front.
    pub diffuse: Vec<DVec3>,
    /// Specular radiance of the front per bin, in the slots of [`State::bins`].
    pub specular: Vec<DVec3>,
    /// A, antiradiance of the back per bin of the incident direction, in the slots of [`State::bins`].
    pub antiradiance: Vec<DVec3>,
}

impl Model {
    /// With the classes that the plan chooses.
    pub fn new(scene: &Scene) -> Self {
        Self::with_classes(scene, classify(scene))
    }

    /// With given classes: to show that what the plan omits changes nothing, or what happens without J.
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

    /// The bins of a triangle in [`State::bins`].
    pub fn bins_of(&self, triangle: usize) -> Option<Range<usize>> {
        self.slots[triangle].map(|first| first..first + self.bins.count())
    }

    /// R, the squared distance below which the near field takes part in the transport between two triangles, m².
    pub fn range(&self, i: usize, j: usize) -> f64 {
        self.near_field * 0.5 * (self.facets[i].characteristic_area + self.facets[j].characteristic_area)
    }

    /// A state without incident light.
    pub fn zero(&self) -> State {
        State {
            irradiance: vec![DVec3::ZERO; self.facets.len()],
            bins: vec![DVec3::ZERO; self.slots.iter().flatten().count() * self.bins.count()],
        }
    }

    /// No outgoing light.
    pub fn dark(&self) -> Outgoing {
        let State { irradiance, bins } = self.zero();
        Outgoing { diffuse: irradiance, specular: bins.clone(), antiradiance: bins }
    }

    /// (K - J) H: outgoing light without emission.
    pub fn leave(&self, state: &State) -> Outgoing {
        let mut outgoing = reflect(self, state);
        outgoing.antiradiance = state.bins.clone();
        outgoing
    }
}

impl Outgoing {
    /// Outgoing radiance of triangle `i` in a world direction, from its front or its back, W/(m² sr).
    pub fn radiance(&self, model: &Model, i: usize, direction: DVec3, front: bool) -> DVec3 {
        self.diffuse(i, front) + self.binned(model, i, direction, front)
    }

    /// The part of the radiance that is the same in all directions.
    pub fn diffuse(&self, i: usize, front: bool) -> DVec3 {
        if front { self.diffuse[i] } else { DVec3::ZERO }
    }

    /// The part that varies with direction: specular radiance from the front, and from the back the negative of the radiance
    /// incident on the front in the same direction of travel.
    pub fn binned(&self, model: &Model, i: usize, direction: DVec3, front: bool) -> DVec3 {
        let gather = |values: &[DVec3], direction: DVec3| -> DVec3 {
            let Some(range) = model.bins_of(i) else { return DVec3::ZERO };
            let taps = model.bins.taps(model.facets[i].to_local(direction));
            taps.iter().map(|&(b, weight)| weight * values[range.start + b]).sum()
        };
        match (front, model.classes[i]) {
            (true, class) if class.glossy => gather(&self.specular, direction),
            // Antiradiance in `direction` stems from light incident on the front from the opposite direction.
            (false, class) if class.blocker => -gather(&self.antiradiance, -direction),
            _ => DVec3::ZERO,
        }
    }
}
