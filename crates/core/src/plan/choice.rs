//! What clusters and their lists are chosen for, which outlasts a plan: lists that changed with every small step would make losses jump.

use super::{Placement, PlanOptions};
use crate::direct::Lamp;
use crate::model::{Class, Facet, MOVED};
use antirad_scene::{Scene, SolveSettings, Transport};
use std::sync::Arc;

/// Largest brightness of a source, relative to the mean.
const BRIGHTEST: f64 = 1e4;
/// Brightness of backs under diffuse light, relative to the mean.
const BACKS: f64 = 2.0;
/// Brightness of backs under the light of an emitter, relative to the emitter: bins spread it out.
const NARROW: f64 = 0.25;
/// Factor on the error of each cluster where derivatives by vertices are wanted: what depends on how neighbours differ errs more than light.
const OF_VERTICES: f64 = 0.1;
/// Factor on the error of each cluster where light comes from emitters straight to clusters, and is uneven there.
const UNEVEN: f64 = 0.3;
/// Factor by which the brightness of a source may change before clusters are chosen anew.
const BRIGHTENED: f64 = 10.0;

/// The triangles and the light that clusters are chosen for, and the order of triangles, of which clusters
/// are ranges.
///
/// Plans for the same triangles with other vertices or another emission keep it ([`Plan::following`](super::Plan::following)), so that
/// pictures and losses are as smooth as those of the exact sum, until a corner has moved by more than a quarter of the root of its
/// triangle's characteristic area, or a source is ten times as bright, or a tenth. Only those of plans with derivatives are kept.
#[derive(Clone, Debug)]
pub struct ClusterChoice {
    pub(super) placement: Placement,
    /// The triangles, in the coordinates of `placement`.
    pub(super) facets: Arc<[Facet]>,
    pub(super) classes: Vec<Class>,
    /// The triangles in the order of their slots, without padding.
    pub(super) order: Vec<u32>,
    /// Brightness of the front of each triangle, relative to the mean.
    pub(super) brightness: Vec<f64>,
    /// Brightness of backs, relative to the mean.
    pub(super) backs: f64,
    /// What each cluster may change, relative to the mean irradiance.
    pub(super) error: f64,
    /// Whether derivatives were planned.
    pub(super) derivatives: bool,
    /// Whether some of them are by geometry, and depend on how steep bins are.
    pub(super) slopes: bool,
    pub(super) settings: SolveSettings,
    pub(super) cull: bool,
}

impl ClusterChoice {
    /// One that is yet without an order; `None` where no clusters are asked for.
    pub(super) fn of(
        scene: &Scene,
        (placement, facets): (Placement, &Arc<[Facet]>),
        classes: &[Class],
        lamps: &[Lamp],
        (options, settings): (&PlanOptions, &SolveSettings),
    ) -> Option<Self> {
        let Transport::Hierarchical { error } = settings.transport.usual(facets.len()) else { return None };
        let brightness = brightness(scene, facets, lamps);
        let uneven = brightness.iter().any(|&bright| bright > 1.0);
        let error = if uneven { UNEVEN * error } else { error };
        Some(Self {
            placement,
            facets: facets.clone(),
            classes: classes.to_vec(),
            order: Vec::new(),
            backs: brightness.iter().fold(BACKS, |most, &bright| most.max(NARROW * bright)),
            brightness,
            error: if options.gradients.geometry() { OF_VERTICES * error } else { error },
            derivatives: options.gradients.any(),
            slopes: options.gradients.geometry(),
            settings: *settings,
            cull: options.cull,
        })
    }

    /// Whether a plan may keep it, for which `anew` would be chosen otherwise.
    pub(super) fn serves(&self, anew: &Self) -> bool {
        // Without derivatives there are volumes, which are chosen by other rules.
        let is_as_careful = self.derivatives
            && self.slopes >= anew.slopes
            && self.error <= anew.error
            && self.settings == anew.settings
            && self.cull == anew.cull;
        is_as_careful
            && self.facets.len() == anew.facets.len()
            && (0..self.facets.len()).all(|i| self.triangle_serves(anew, i))
    }

    /// Whether the light of a scene is still like that which it is chosen for; `facets`: its triangles.
    pub(super) fn is_lit_by(&self, scene: &Scene, facets: &[Facet], lamps: &[Lamp]) -> bool {
        let now = brightness(scene, facets, lamps);
        self.brightness.iter().zip(now).all(|(then, now)| are_alike(*then, now))
    }

    fn triangle_serves(&self, anew: &Self, i: usize) -> bool {
        let (then, now) = (&self.facets[i], &anew.facets[i]);
        let most = MOVED * MOVED * then.characteristic_area;
        let moved = |(then, now)| self.placement.apply(anew.placement.metres(now)).distance_squared(then);
        (then.area > 0.0) == (now.area > 0.0)
            // One that blocks nothing may count as a blocker.
            && self.classes[i].glossy == anew.classes[i].glossy
            && self.classes[i].blocker >= anew.classes[i].blocker
            && are_alike(self.brightness[i], anew.brightness[i])
            && then.corners.into_iter().zip(now.corners).all(|corners| moved(corners) <= most)
    }
}

/// Whether two brightnesses are of one order.
fn are_alike(a: f64, b: f64) -> bool {
    a.max(b) <= BRIGHTENED * a.min(b)
}

/// Brightness of the fronts, relative to the mean: 1, and more where light is emitted into U.
fn brightness(scene: &Scene, facets: &[Facet], lamps: &[Lamp]) -> Vec<f64> {
    let emitted = |i: usize| scene.material(i).emission.into_iter().fold(0.0, |m: f64, e| m.max(e.abs()));
    let (mut flux, mut area) = (0.0, 0.0);
    for (i, facet) in facets.iter().enumerate() {
        flux += facet.area * emitted(i);
        area += facet.area;
    }
    let mean = if area > 0.0 { flux / area } else { 0.0 };
    let relative = |i: usize| if mean > 0.0 { (1.0 + emitted(i) / mean).min(BRIGHTEST) } else { 1.0 };
    let mut brightness: Vec<f64> = (0..facets.len()).map(relative).collect();
    // Direct light of lamps does not pass through U.
    lamps.iter().flat_map(Lamp::triangles).for_each(|&i| brightness[i as usize] = 1.0);
    brightness
}
