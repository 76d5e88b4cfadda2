//! The choice of lamps, the emitters whose direct light is computed separately from U, and of their
//! visibility.

use super::{Placement, Plan};
use crate::direct::{DirectLight, FEW_LAMPS, Lamp, Visibility, lamps, suns};
use crate::model::{Bins, Facet, coplanar_tolerance};
use antirad_scene::{Lamps, Scene, SolveSettings, VisibilityChoice};
use std::sync::Arc;

/// Blockers and edges looked at up to which it is, per pair of triangles and in addition: up to three times as long as a solve on a
/// CPU, and a second.
const TESTS_PER_PAIR: f64 = 16.0;
const FEW_TESTS: f64 = 2e7;
/// Lamps up to which direct light comes by rays unless stated, and numbers to hold: of each triangle and lamp, for glossy ones of each bin.
const MOST_SAMPLED: usize = 20_000;
const MOST_HELD: usize = 100_000_000;
/// Lamps of which light arrives at a triangle, about, where rays are distributed over all of them.
const MOST_AT_ONCE: usize = 256;

/// How the light that comes straight from emitters is computed, and why.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LampsReport {
    /// Lamps with exact visibility: planar convex polygons, merged from triangles, and suns.
    pub exact: usize,
    /// Lamps with visibility by rays where much stands in between, or by rays that are distributed over all lamps.
    pub sampled: usize,
    /// Lamps in all, also those whose light takes part in U.
    pub emitters: usize,
    /// Triangles of those with exact or sampled visibility.
    pub triangles: usize,
    /// The reason, in words.
    pub why: String,
}

/// Lamps whose direct light is computed separately from U.
#[derive(Default)]
pub(crate) struct Chosen {
    pub(crate) lamps: Vec<Lamp>,
    pub(crate) visibility: Visibility,
    /// How many lamps there are in all.
    pub(crate) emitters: usize,
}

/// Chooses the lamps of a scene whose direct light is computed separately from U, by geometry and settings alone. Where other light comes by rays,
/// so does visibility of lamps where much stands in between; by antiradiance, where exact visibility would take longer than the solve.
pub(super) fn choose(scene: &Scene, facets: &[Facet], settings: &SolveSettings) -> Chosen {
    let lamps = lamps(scene, facets, coplanar_tolerance(facets));
    let emitters = lamps.len();
    let all = facets.len();
    let affordable = |lamps: &[Lamp]| {
        let pairs = all as f64 * all as f64;
        lamps.len() <= FEW_LAMPS
            && DirectLight::takes_at_most(facets, lamps, TESTS_PER_PAIR * pairs + FEW_TESTS)
    };
    let by_rays = |lamps: &[Lamp]| match lamps.len() > FEW_LAMPS {
        true => Visibility::Distributed,
        false => Visibility::Sampled,
    };
    let sampled = |lamps: &[Lamp]| {
        let glossy = (0..all).filter(|&i| scene.material(i).is_glossy()).count();
        let bins = Bins::new(settings.bins).count();
        let held = lamps.len().min(MOST_AT_ONCE) * (all + glossy * bins);
        let possible = lamps.len() <= MOST_SAMPLED && held <= MOST_HELD;
        // Without shadows, light through U has no noise.
        let worthwhile = lamps.len() <= FEW_LAMPS || DirectLight::is_blocked(facets, lamps);
        (possible && worthwhile).then(|| by_rays(lamps))
    };
    let auto = |lamps: &[Lamp]| {
        let rays = settings.visibility == VisibilityChoice::Explicit;
        if lamps.is_empty() || (!rays && affordable(lamps)) {
            return Some(Visibility::Exact);
        }
        sampled(lamps)
    };
    let visibility = match settings.lamps {
        Lamps::Exact => Some(Visibility::Exact),
        Lamps::Sampled => Some(by_rays(&lamps)),
        Lamps::Antiradiance => None,
        Lamps::Auto => auto(&lamps),
    };
    let (lamps, visibility) = visibility.map_or_else(
        || {
            // No triangle sends the light of suns into U.
            let suns: Vec<Lamp> = suns(scene).collect();
            let visibility = auto(&suns).unwrap_or_default();
            (suns, visibility)
        },
        |visibility| (lamps.clone(), visibility),
    );
    Chosen { lamps, visibility, emitters }
}

/// The triangles of a scene, in units of its size, and the lamps whose direct light is computed separately
/// from U.
pub fn direct_lamps(scene: &Scene) -> (Arc<[Facet]>, Vec<Lamp>, Visibility) {
    let facets = Placement::of(scene).facets(scene);
    let Chosen { lamps, visibility, .. } = choose(scene, &facets, &scene.settings);
    (facets, lamps, visibility)
}

impl Plan {
    /// Whether kernels trace the rays that lamps are sampled with.
    #[doc(hidden)]
    pub fn traces_lamps(&self) -> bool {
        let surfaces = self.lamps.iter().all(|lamp| lamp.sun().is_none());
        let sampled = self.visibility == Visibility::Sampled && !self.lamps.is_empty();
        self.options.trace_lamps && sampled && surfaces
    }

    /// How the light of emitters is computed.
    pub(super) fn lamps_report(&self) -> LampsReport {
        let triangles = self.lamps.iter().map(|lamp| lamp.triangles().len()).sum();
        let suns = self.lamps.iter().filter(|lamp| lamp.sun().is_some()).count();
        let through_bins = self.emitters - self.lamps.len();
        let lamps = |count: usize| if count == 1 { String::from("1 lamp") } else { format!("{count} lamps") };
        let mut why = match (self.settings.lamps, through_bins, self.visibility) {
            _ if self.emitters == 0 => String::from("no emitter"),
            (Lamps::Antiradiance, 1.., _) => String::from("by antiradiance, as stated"),
            (_, 1.., _) => {
                let why = match lamps(through_bins) {
                    count if self.emitters > MOST_SAMPLED => format!("{count}, more than {MOST_SAMPLED}"),
                    count => format!(
                        "exact ones of {count} would take far longer than the solve, and sampled ones too much memory, or lack \
                         derivatives that are wanted"
                    ),
                };
                format!("by antiradiance through bins, which blurs shadows: {why}")
            }
            (_, 0, Visibility::Exact) => {
                format!("direct light of {} with exact visibility", lamps(self.emitters))
            }
            (_, 0, Visibility::Distributed) => {
                format!(
                    "direct light of {} by rays that are distributed over all of them",
                    lamps(self.emitters)
                )
            }
            (_, 0, Visibility::Sampled) if self.traces_lamps() => {
                format!(
                    "direct light of {} with visibility by rays, which kernels trace",
                    lamps(self.emitters)
                )
            }
            (_, 0, Visibility::Sampled) => {
                format!(
                    "direct light of {} with visibility by rays where much stands in between",
                    lamps(self.emitters)
                )
            }
        };
        if suns > 0 && through_bins > 0 {
            why += "; direct light of suns all the same";
        }
        let all = self.lamps.len();
        let (exact, sampled) = if self.visibility == Visibility::Exact { (all, 0) } else { (0, all) };
        LampsReport { exact, sampled, emitters: self.emitters, triangles, why }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::{LoadOptions, Material, SceneBuilder, Shape};
    use glam::{DAffine3, DVec3};

    /// Leaves under a lamp and over a floor, anywhere in a cube: many outlines before each other.
    fn leaves(count: u32) -> Scene {
        let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
        let grey = Material::named("grey");
        let mut builder = SceneBuilder::new();
        let at = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
        let down = DAffine3::from_rotation_x(std::f64::consts::PI);
        builder.shape("lamp", Shape::Quad { cells: 1 }, &lamp, at(0.0, 2.0, 0.0) * down);
        builder.shape(
            "floor",
            Shape::Quad { cells: 10 },
            &grey,
            at(0.0, -2.0, 0.0) * DAffine3::from_scale(DVec3::splat(4.0)),
        );
        for k in 0..count {
            // Additive recurrences by powers of the plastic number.
            let [x, y, z] =
                [0.8191725, 0.6710436, 0.5497005].map(|step| (f64::from(k) * step).fract() * 2.0 - 1.0);
            let turned = DAffine3::from_axis_angle(DVec3::new(x, y, z).normalize(), 20.0 * (x + y));
            builder.shape(
                "leaf",
                Shape::Quad { cells: 1 },
                &grey,
                at(x, y, z) * turned * DAffine3::from_scale(DVec3::splat(0.04)),
            );
        }
        builder.finish("leaves").expect("a scene")
    }

    #[test]
    fn rays_are_taken_where_outlines_are_many() {
        let scene = leaves(6000);
        let facets = Placement::of(&scene).facets(&scene);
        let chosen = |settings: SolveSettings| choose(&scene, &facets, &settings).visibility;
        assert_eq!(chosen(scene.settings), Visibility::Sampled);
        assert_eq!(chosen(scene.settings.lamps(Lamps::Exact)), Visibility::Exact);
    }

    #[test]
    fn shadows_of_a_statue_take_what_a_solve_takes() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/statue.toml");
        let scene = Scene::load(std::path::Path::new(file), &LoadOptions::default()).expect("a statue");
        let facets = Placement::of(&scene).facets(&scene);
        for (visibility, lamps) in [
            (VisibilityChoice::Implicit, Visibility::Exact),
            (VisibilityChoice::Explicit, Visibility::Sampled),
        ] {
            let chosen = choose(&scene, &facets, &scene.settings.visibility(visibility));
            assert_eq!((chosen.visibility, chosen.lamps.len()), (lamps, 1), "{visibility:?}");
        }
    }
}
