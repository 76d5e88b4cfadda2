//! Refinement levels: settings from cheap to accurate, and the level at which a scene starts.

use crate::warnings::{Surfaces, Warnings, mean_albedo};
use antirad_core::model::{Bins, classify, spatial_order};
use antirad_core::plan::{Placement, Plan, PlanError, PlanOptions, Residency};
use antirad_scene::{BinLayout, Choice, Scene, SolveSettings, VisibilityChoice};
use serde::Serialize;
use std::f64::consts::SQRT_2;

/// One refinement level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    /// Polar angle x azimuth: finest around the normal, where lamps above floors and tables are.
    equal_angle: (u32, u32),
    /// Cells along a side of the equal-area square: bins of equal size, which coarse blockers need.
    concentric: u32,
    pub near_field: f64,
    /// How many times every triangle is cut into four, besides those that the estimate names.
    pub cuts: u32,
    pub tolerance: f64,
    /// Where visibility is explicit: the error of irradiance that rays may cause.
    rays: Option<f64>,
    /// Typical error of the level in the sweep of `bench_accuracy`.
    usual: f64,
}

const fn level(
    equal_angle: (u32, u32),
    concentric: u32,
    near_field: f64,
    cuts: u32,
    tolerance: f64,
    usual: f64,
) -> Level {
    Level { equal_angle, concentric, near_field, cuts, tolerance, rays: None, usual }
}

/// A level of explicit visibility. `concentric`: bins along a side of the square, of glossy triangles alone; `rays`: the error of irradiance
/// that these may cause.
const fn explicit(concentric: u32, rays: f64, tolerance: f64, usual: f64) -> Level {
    Level { equal_angle: (2, 3), concentric, near_field: 10.0, cuts: 0, tolerance, rays: Some(rays), usual }
}

/// Levels for scenes with shadows or gloss whose lamps are exact. The light in bins is then that of reflections, which changes slowly with
/// direction: ten by thirteen are enough for two percent. What finer bins leave is not smaller, where blockers stay as large; rays leave
/// less. What is left to refine is the mesh, where the estimate says.
const REFLECTED: [Level; 6] = [
    level((6, 8), 8, 10.0, 0, 3e-3, 0.03),
    level((10, 13), 10, 30.0, 0, 1e-3, 0.015),
    explicit(16, 0.0036, 1e-3, 0.008),
    explicit(16, 0.0018, 1e-3, 0.004),
    explicit(24, 0.0009, 3e-4, 0.002),
    explicit(32, 0.00045, 1e-4, 0.001),
];

/// The same by rays alone.
const EXPLICIT: [Level; 5] =
    [explicit(8, 0.0072, 3e-3, 0.015), REFLECTED[2], REFLECTED[3], REFLECTED[4], REFLECTED[5]];

/// The same by antiradiance alone.
const IMPLICIT: [Level; 5] = [
    REFLECTED[0],
    REFLECTED[1],
    level((14, 18), 16, 30.0, 0, 1e-3, 0.008),
    level((20, 26), 24, 30.0, 0, 3e-4, 0.004),
    level((20, 26), 24, 60.0, 0, 1e-4, 0.002),
];

/// Levels for scenes with shadows or gloss by antiradiance. Bins and mesh are refined together: alone,
/// neither improves much.
const DIRECTIONAL: [Level; 5] = [
    level((6, 8), 8, 10.0, 0, 3e-3, 0.08),
    level((10, 13), 10, 30.0, 0, 1e-3, 0.04),
    level((14, 18), 16, 30.0, 1, 1e-3, 0.025),
    level((20, 26), 24, 30.0, 1, 3e-4, 0.02),
    level((28, 36), 32, 30.0, 2, 1e-4, 0.01),
];

/// Levels for scenes without shadows or gloss: bins do not matter, only the near field and the mesh do.
const DIFFUSE: [Level; 5] = [
    level((2, 3), 2, 10.0, 0, 3e-3, 0.015),
    level((2, 3), 2, 30.0, 0, 1e-3, 0.006),
    level((2, 3), 2, 60.0, 0, 3e-4, 0.003),
    level((2, 3), 2, 120.0, 0, 1e-4, 0.0015),
    level((2, 3), 2, 400.0, 0, 1e-5, 0.0),
];

/// (range of the near field, largest share of light lost or gained per bounce), measured in closed rooms and spheres. Over all
/// bounces it counts ρ/(1 - ρ) times.
const LOSS: [(f64, f64); 5] = [(10.0, 1.8e-3), (30.0, 8e-4), (60.0, 3e-4), (120.0, 1.5e-4), (400.0, 1e-5)];

/// Factor by which coarse blockers widen the near field. With 10 x 10 bins of equal size, two plates closer than a triangle's
/// size leak 14 % of the light at a near field of 30, and 3.5 % at 60.
const COARSE_NEAR: f64 = 2.0;

/// Share of the area in coarse blockers above which bins of equal size are better.
const FEW: f64 = 0.05;

/// The layout of bins that suits a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LayoutKind {
    /// Equal polar angles: sharpest around the normal.
    EqualAngle,
    /// Equal solid angles, for scenes with many blockers that are too coarse for the narrow bins around the normal.
    Concentric,
    /// No shadows and no gloss: no bins are needed.
    None,
}

impl LayoutKind {
    /// Bound on the ratio of error to difference from the comparison solve, which holds in nearly all scenes of the sweep. It is
    /// larger where both solves use the same layout, since their errors are then alike.
    pub(super) fn ratio(self) -> f64 {
        match self {
            Self::EqualAngle => 1.25,
            Self::Concentric => 1.5,
            Self::None => 2.0,
        }
    }
}

/// The largest error that rays may cause.
const COARSEST: f64 = 0.2;

impl Level {
    /// `directional`: whether the scene has bins; `lamps`: whether the light of its lamps is exact.
    pub fn all(visibility: VisibilityChoice, directional: bool, lamps: bool) -> &'static [Self] {
        match (visibility, directional, lamps) {
            (VisibilityChoice::Explicit, _, _) => &EXPLICIT,
            (VisibilityChoice::Implicit, true, true) => &IMPLICIT,
            (VisibilityChoice::Auto, true, true) => &REFLECTED,
            (_, true, false) => &DIRECTIONAL,
            (_, false, _) => &DIFFUSE,
        }
    }

    /// Bound on the ratio of error to difference from the comparison. Of rays, the difference between half of them and all is as large as the
    /// error of these, if halves are independent; evenly spread as they are, it is larger.
    pub fn ratio(&self, layout: LayoutKind) -> f64 {
        if self.is_explicit() { 1.0 } else { layout.ratio() }
    }

    /// The level for a mesh of so many times as many triangles as it started with: of the same number of rays in all.
    pub fn with_finer(self, times: f64) -> Self {
        Self { rays: self.rays.map(|error| (error * times.sqrt()).min(COARSEST)), ..self }
    }

    pub fn is_explicit(&self) -> bool {
        self.rays.is_some()
    }

    /// The first of these levels whose usual error is within `error`, or the last.
    pub fn start(levels: &[Self], error: f64) -> usize {
        levels.iter().position(|level| level.usual <= error).unwrap_or(levels.len() - 1)
    }

    pub fn settings(&self, layout: LayoutKind, near: f64, base: &SolveSettings) -> SolveSettings {
        let usual = match layout {
            LayoutKind::Concentric => COARSE_NEAR * self.near_field,
            LayoutKind::EqualAngle | LayoutKind::None => self.near_field,
        };
        let settings = base.bins(self.bins(layout, self.concentric)).tolerance(self.tolerance);
        match self.rays {
            Some(error) => settings.visibility(VisibilityChoice::Explicit).ray_error(error),
            None => settings.near_field(near.max(usual)),
        }
    }

    /// Settings of the comparison solve: other bins and a third of the near field, or half the rays, so that its errors are as large or larger,
    /// and independent. Where narrow bins fail, fewer bins of equal size.
    pub fn comparison(&self, layout: LayoutKind, near: f64, base: &SolveSettings) -> SolveSettings {
        let fewer = (self.concentric * 5 / 6).next_multiple_of(2);
        let bins = match layout {
            LayoutKind::EqualAngle => self.bins(LayoutKind::Concentric, self.concentric),
            LayoutKind::Concentric => {
                self.bins(LayoutKind::Concentric, if fewer < self.concentric { fewer } else { fewer - 2 })
            }
            LayoutKind::None => self.bins(layout, self.concentric),
        };
        let settings = self.settings(layout, near, base);
        let settings = settings.bins(bins);
        match self.rays {
            Some(error) => settings.ray_error(SQRT_2 * error),
            None => settings.near_field(settings.near_field / 3.0),
        }
    }

    fn bins(&self, layout: LayoutKind, n: u32) -> BinLayout {
        let (theta, phi) = self.equal_angle;
        match layout {
            LayoutKind::Concentric => BinLayout::Concentric { n },
            LayoutKind::EqualAngle | LayoutKind::None => BinLayout::EqualAngle { theta, phi },
        }
    }
}

/// Range of the near field that loses at most half of `error` over all bounces. `albedo`: see [`mean_albedo`].
pub(super) fn near_field_for(albedo: f64, error: f64) -> f64 {
    let bounces = albedo / (1.0 - albedo).max(1e-6);
    let enough = LOSS.iter().find(|(_, loss)| loss * bounces <= 0.5 * error);
    enough.map_or(LOSS[LOSS.len() - 1].0, |&(range, _)| range)
}

/// Whether the scene has shadows or gloss, and therefore bins.
pub(super) fn is_directional(scene: &Scene) -> bool {
    classify(scene).iter().any(|class| class.has_bins())
}

/// The layout of bins that suits a scene: equal polar angles, unless coarse blockers would then make up more than a twentieth of
/// the area. Examines pairs of nearby triangles; needs no device.
pub fn layout(scene: &Scene, settings: &SolveSettings) -> LayoutKind {
    let classes = classify(scene);
    if !classes.iter().any(|class| class.has_bins()) {
        return LayoutKind::None;
    }
    let facets = Placement::of(scene).facets(scene);
    let surfaces = Surfaces {
        facets: &facets,
        classes: &classes,
        order: &spatial_order(&facets),
        bins: &Bins::new(settings.bins),
        near_field: settings.near_field,
    };
    if Warnings::coarse_share(surfaces) > FEW { LayoutKind::Concentric } else { LayoutKind::EqualAngle }
}

/// Settings for a scene that leaves some open ([`Choice::Open`]). Where [`layout`] is concentric: 10 x 10 bins of equal size and
/// a near field twice as wide. Everywhere: a near field that loses at most 1 % of the light over all bounces. All other settings
/// stay as they are.
pub fn usual_settings(scene: &Scene) -> SolveSettings {
    if is_open(scene) { usual(scene, layout(scene, &scene.settings)) } else { scene.settings }
}

/// The [`usual_settings`] and their plan. Visibility that is automatic is explicit where antiradiance would let much light pass through backs
/// ([`Warnings::light_through_backs`]) or take far longer than rays, if the plan has no derivatives by positions and rays fit its budget.
///
/// # Errors
/// Fails if the scene cannot be planned.
pub fn usual_plan(scene: &Scene, options: &PlanOptions) -> Result<(SolveSettings, Plan), PlanError> {
    let settings = usual_settings(scene);
    let plan = Plan::new(scene, options, &settings)?;
    let is_free = settings.visibility == VisibilityChoice::Auto && !options.gradients.positions;
    if !is_free || plan.transport().is_explicit() {
        return Ok((settings, plan));
    }
    let seconds = plan.report().estimated_seconds;
    let why = if seconds > LONG && seconds > FAR_LONGER * plan.seconds_of_rays() {
        format!("antiradiance would take {seconds:.0} s or more")
    } else if let Some(passed) = Warnings::light_through_backs(scene, &plan) {
        format!("antiradiance would add {:.1} % of light that passes through backs", 100.0 * passed)
    } else {
        return Ok((settings, plan));
    };
    let explicit = settings.visibility(VisibilityChoice::Explicit);
    Ok(match Plan::new(scene, options, &explicit) {
        Ok(by_rays) if by_rays.residency() == Residency::Device => {
            tracing::info!("{why}: visibility is explicit");
            (explicit, by_rays)
        }
        // Rays do not fit.
        _ => (settings, plan),
    })
}

/// Seconds that a solve by antiradiance may take at least, and in times of those that rays would take, before these replace it.
const LONG: f64 = 30.0;
const FAR_LONGER: f64 = 4.0;

fn is_open(scene: &Scene) -> bool {
    matches!(scene.choice, Choice::Open { bins, near_field } if bins || near_field)
}

fn usual(scene: &Scene, layout: LayoutKind) -> SolveSettings {
    let mut settings = scene.settings;
    let Choice::Open { bins, near_field } = scene.choice else { return settings };
    let coarse = layout == LayoutKind::Concentric;
    if near_field {
        let wider = if coarse { COARSE_NEAR } else { 1.0 };
        let bright = near_field_for(mean_albedo(scene), 2.0 * USUAL_LOSS);
        settings.near_field = bright.max(wider * scene.settings.near_field);
    }
    if bins && coarse {
        settings.bins = BinLayout::Concentric { n: 10 };
    }
    settings
}

/// Share of all light that the usual near field may lose.
const USUAL_LOSS: f64 = 0.01;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comparisons_have_other_settings() {
        let lists = [&REFLECTED[..], &EXPLICIT, &IMPLICIT, &DIRECTIONAL, &DIFFUSE];
        for level in lists.into_iter().flatten() {
            for layout in [LayoutKind::EqualAngle, LayoutKind::Concentric, LayoutKind::None] {
                let own = level.settings(layout, 0.0, &SolveSettings::default());
                let other = level.comparison(layout, 0.0, &SolveSettings::default());
                let fewer = other.ray_error > own.ray_error || other.near_field < own.near_field;
                assert!(fewer, "{own:?}, {other:?}");
                assert!(
                    layout == LayoutKind::None || level.concentric < 4 || other.bins != own.bins,
                    "{own:?}"
                );
            }
        }
    }

    /// What a level is expected to leave falls from each to the next, and so does what its rays may cause.
    #[test]
    fn levels_go_from_cheap_to_accurate() {
        for list in [&REFLECTED[..], &EXPLICIT, &IMPLICIT, &DIRECTIONAL, &DIFFUSE] {
            assert!(list.windows(2).all(|two| two[1].usual < two[0].usual), "{list:?}");
            let rays: Vec<f64> = list.iter().filter_map(|level| level.rays).collect();
            assert!(rays.windows(2).all(|two| two[1] < two[0]), "{list:?}");
        }
    }

    #[test]
    fn brighter_rooms_have_wider_near_fields() {
        assert_eq!(near_field_for(0.0, 0.01), 10.0);
        assert_eq!(near_field_for(0.8, 0.01), 30.0);
        assert_eq!(near_field_for(0.95, 0.01), 120.0);
        assert_eq!(near_field_for(0.99, 0.01), 400.0);
        assert_eq!(near_field_for(1.0, 0.01), 400.0);
    }
}
