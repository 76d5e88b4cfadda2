//! Which emitters are lamps, whose direct light is exact.

use super::{Placement, Plan};
use crate::direct::{DirectLight, Lamp, lamps};
use crate::model::{Facet, coplanar_tolerance};
use crate::scene::{Lamps, Scene};

/// Lamps up to which direct light is exact unless stated.
const MOST: usize = 128;
/// Blockers and edges looked at up to which it is, per pair of triangles and in addition: two or three times a solve, and a second.
const TESTS_PER_PAIR: f64 = 8.0;
const FEW_TESTS: f64 = 2e7;

/// How the light that comes straight from emitters is computed, and why.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LampsReport {
    /// Lamps with exact visibility: planar convex polygons, merged from triangles.
    pub exact: usize,
    /// Triangles of these.
    pub triangles: usize,
    /// In words.
    pub why: String,
}

/// The lamps of a scene whose direct light is to be exact.
pub(super) fn choose(scene: &Scene, facets: &[Facet], setting: Lamps) -> Vec<Lamp> {
    if setting == Lamps::Antiradiance {
        return Vec::new();
    }
    let lamps = lamps(scene, facets, coplanar_tolerance(facets));
    let affordable = || {
        let pairs = (facets.len() as f64).powi(2);
        DirectLight::estimated_tests(facets, &lamps) <= TESTS_PER_PAIR * pairs + FEW_TESTS
    };
    match setting == Lamps::Exact || lamps.is_empty() || lamps.len() <= MOST && affordable() {
        true => lamps,
        false => Vec::new(),
    }
}

/// The triangles of a scene, in units of its size, and the lamps whose direct light is to be exact.
pub(crate) fn exact_lamps(scene: &Scene) -> (Vec<Facet>, Vec<Lamp>) {
    let facets = Placement::of(scene).facets(scene);
    let lamps = choose(scene, &facets, scene.settings.lamps);
    (facets, lamps)
}

/// Whether the light of a scene's lamps is to be exact.
pub(crate) fn has_exact_lamps(scene: &Scene) -> bool {
    !exact_lamps(scene).1.is_empty()
}

impl Plan {
    /// How the light of emitters is computed.
    pub(super) fn lamps_report(&self) -> LampsReport {
        let triangles = self.lamps.iter().map(|lamp| lamp.triangles.len()).sum();
        let why = match (self.settings.lamps, self.lamps.len()) {
            (Lamps::Antiradiance, _) => String::from("by antiradiance, as stated"),
            (Lamps::Auto, 0) => {
                format!(
                    "by antiradiance: no emitter, more than {MOST}, or exact shadows would take far longer than the solve"
                )
            }
            (Lamps::Exact, 0) => String::from("no emitter"),
            (_, 1) => String::from("direct light of 1 lamp with exact visibility"),
            (_, count) => format!("direct light of {count} lamps with exact visibility"),
        };
        LampsReport { exact: self.lamps.len(), triangles, why }
    }
}
