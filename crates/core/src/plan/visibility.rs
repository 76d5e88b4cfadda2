//! The choice between implicit visibility, by antiradiance, and explicit visibility, by rays.

use super::{Occlusion, Placement, PlanError, PlanOptions};
use crate::direct::from_front;
use crate::model::{Facet, rays_among};
use antirad_base::parallel;
use antirad_scene::{Scene, SolveSettings, VisibilityChoice};
use glam::DVec3;
use std::f64::consts::TAU;

/// Rays of a triangle that look for dense blockers, and triangles that are looked at, at most.
const EACH: u32 = 8;
const LOOKED_AT: usize = 1 << 15;
/// Solid angle of a direction bin by default, sr: the same whatever the bins, so that these do not change what is chosen.
const BIN: f64 = TAU / 130.0;
/// Blockers in a row, each of which errs by more than it blocks, up to which antiradiance serves.
const IN_A_ROW: usize = 2;
/// The share of rays that may meet more. There are none in rooms, statues and boxes of this repository; in plants, piles, shelves and blinds there
/// are 3 to 200 times as many.
const FEW: f64 = 1e-3;

/// Why visibility is to be explicit, if it is.
///
/// # Errors
/// Fails if that is stated along with derivatives by positions, which it has none of.
pub(super) fn why_explicit(
    facets: &[Facet],
    settings: &SolveSettings,
    options: &PlanOptions,
) -> Result<Option<&'static str>, PlanError> {
    let moves = options.gradients.positions;
    match settings.visibility {
        _ if options.occlusion != Occlusion::Exact => Ok(None),
        VisibilityChoice::Explicit if moves => Err(PlanError::ExplicitVisibility),
        VisibilityChoice::Explicit => Ok(Some("settings")),
        VisibilityChoice::Auto if !moves && dense_share(facets) > FEW => Ok(Some("dense blockers")),
        VisibilityChoice::Auto | VisibilityChoice::Implicit => Ok(None),
    }
}

/// Whether plans of a scene without derivatives by positions have explicit visibility, since its settings state it or its blockers are dense.
pub fn is_explicit(scene: &Scene) -> bool {
    is_explicit_among(&Placement::of(scene).facets(scene), &scene.settings)
}

/// The same of the facets of the scene.
pub(super) fn is_explicit_among(facets: &[Facet], settings: &SolveSettings) -> bool {
    // Nothing is refused without derivatives.
    why_explicit(facets, settings, &PlanOptions::default()).is_ok_and(|why| why.is_some())
}

/// The share of rays from fronts that meet more than [`IN_A_ROW`] fronts in a row, each so close before the next that it subtends more than a
/// direction bin there. The antiradiance of such blockers is wrong by more than the light that they stop (`warnings`, gain), and that of one
/// multiplies the error of the one before.
fn dense_share(facets: &[Facet]) -> f64 {
    let rays = rays_among(facets);
    let coarse = |ray: DVec3, [(blocker, at), (_, next)]: [(usize, f64); 2]| {
        let Facet { area, normal, .. } = facets[blocker];
        area * normal.dot(ray).abs() > BIN * (next - at).powi(2)
    };
    let is_dense = |triangle: usize, (origin, ray): (DVec3, DVec3)| {
        let fronts = rays.fronts(origin, ray, triangle);
        let coarse: Vec<bool> = fronts.windows(2).map(|pair| coarse(ray, [pair[0], pair[1]])).collect();
        coarse.split(|coarse| !coarse).any(|row| row.len() > IN_A_ROW)
    };
    let step = facets.len().div_ceil(LOOKED_AT).max(1);
    let looked: Vec<usize> = (0..facets.len()).step_by(step).filter(|&i| facets[i].area > 0.0).collect();
    let dense =
        |&i: &usize| from_front(&facets[i], i as u64, 0..EACH).filter(|&ray| is_dense(i, ray)).count();
    let found: usize = parallel::map(&looked, dense).into_iter().sum();
    found as f64 / (looked.len() * EACH as usize).max(1) as f64
}
