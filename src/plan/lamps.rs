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
    /// Lamps in all, whether exact or not.
    pub emitters: usize,
    /// Triangles of these.
    pub triangles: usize,
    /// In words.
    pub why: String,
}

/// The lamps of a scene whose direct light is to be exact, and how many there are, exact or not.
pub(super) fn choose(scene: &Scene, facets: &[Facet], setting: Lamps) -> (Vec<Lamp>, usize) {
    let lamps = lamps(scene, facets, coplanar_tolerance(facets));
    let count = lamps.len();
    let affordable = || {
        let pairs = (facets.len() as f64).powi(2);
        DirectLight::estimated_tests(facets, &lamps) <= TESTS_PER_PAIR * pairs + FEW_TESTS
    };
    let exact = match setting {
        Lamps::Exact => true,
        Lamps::Antiradiance => false,
        Lamps::Auto => count == 0 || count <= MOST && affordable(),
    };
    (if exact { lamps } else { Vec::new() }, count)
}

/// The triangles of a scene, in units of its size, and the lamps whose direct light is to be exact.
pub(crate) fn exact_lamps(scene: &Scene) -> (Vec<Facet>, Vec<Lamp>) {
    let facets = Placement::of(scene).facets(scene);
    let (lamps, _) = choose(scene, &facets, scene.settings.lamps);
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
        let why = match (self.settings.lamps, self.lamps.len(), self.emitters) {
            (_, 0, 0) => String::from("no emitter"),
            (Lamps::Antiradiance, _, _) => String::from("by antiradiance, as stated"),
            (_, 0, count @ 0..=MOST) => {
                format!(
                    "by antiradiance through bins, which blurs shadows: exact ones of {count} lamp(s) would take far longer than the solve"
                )
            }
            (_, 0, count) => {
                format!("by antiradiance through bins, which blurs shadows: {count} lamps, more than {MOST}")
            }
            (_, 1, _) => String::from("direct light of 1 lamp with exact visibility"),
            (_, count, _) => format!("direct light of {count} lamps with exact visibility"),
        };
        LampsReport { exact: self.lamps.len(), emitters: self.emitters, triangles, why }
    }
}
