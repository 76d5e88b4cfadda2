//! What a cause of errors can do to the answer: a share of all light.
//!
//! Before a solve it is estimated, on the safe side, from the geometry. After one, estimates that matter are replaced by what path tracing
//! finds at the triangles concerned: geometry that looks bad is often dark, or turned away from what counts.

use super::gain::{Gain, Gains};
use super::layers::Layers;
use crate::path_tracer::PathTracer;
use antirad_base::parallel;
use antirad_core::plan::Plan;
use glam::DVec3;
use serde::Serialize;
use std::collections::HashSet;
use std::fmt;

/// Share of all light from which a cause of errors is told without being asked for.
pub const MATTERS: f64 = 0.01;
/// Error of the light that a blocker stops, relative to it, per unit of gain: measured on plates over a floor.
const ERROR_OF_GAIN: f64 = 0.1;
/// Neighbourhoods of the triangles concerned, in each of which errors are averaged.
const PLACES: usize = 32;
/// Triangles of a neighbourhood that are traced, and paths to each.
const TRIED: u32 = 12;
const PATHS: u32 = 24;

/// How much of all light a cause changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Effect {
    /// Area times error of irradiance, over the sum of area times irradiance.
    pub share: f64,
    /// Standard error of the share where it was measured by path tracing; `None` where it is an estimate from the geometry.
    pub measured: Option<f64>,
}

impl Effect {
    /// An estimate on the safe side.
    #[doc(hidden)]
    pub fn predicted(share: f64) -> Self {
        Self { share: share.min(1.0), measured: None }
    }

    /// Whether it is beyond doubt above a limit.
    #[doc(hidden)]
    pub fn exceeds(&self, limit: f64) -> bool {
        self.share - 2.0 * self.measured.unwrap_or(0.0) > limit
    }
}

/// The effect from which warnings are told: [`MATTERS`], or less for a smaller target error.
pub fn told_from(target_error: Option<f64>) -> f64 {
    target_error.map_or(MATTERS, |error| error.min(MATTERS))
}

impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let share = 100.0 * self.share;
        match self.measured {
            Some(error) if error > 0.0 => {
                write!(f, "{share:.2} ± {:.2} % of the light, by path tracing", 100.0 * error)
            }
            Some(_) => write!(f, "{share:.2} % of the light"),
            None => write!(f, "at most about {share:.2} % of the light, by the geometry"),
        }
    }
}

/// The share of all irradiance in error by these triangles, each with its relative error, where light comes from everywhere.
pub fn of_area(plan: &Plan, errors: impl Iterator<Item = (u32, f64)>) -> f64 {
    let area = |i: u32| plan.facets()[i as usize].area;
    let all: f64 = plan.facets().iter().map(|facet| facet.area).sum();
    errors.map(|(i, error)| area(i) * error.min(1.0)).sum::<f64>() / all.max(f64::MIN_POSITIVE)
}

/// Share of the light at a receiver that comes through one direction bin: all of it where lamps are small and their light goes through bins,
/// else the bin's share of a diffuse hemisphere, where bins are of equal size and along the normal: s_b/π.
fn through_a_bin(plan: &Plan) -> f64 {
    let (lamps, exact) = (plan.emitters() as f64, plan.lamps().len() as f64);
    let through_bins = if lamps > 0.0 { 1.0 - exact / lamps } else { 1.0 };
    through_bins + (1.0 - through_bins) * 2.0 / plan.bins().count() as f64
}

/// Errors at receivers behind coarse blockers.
pub fn behind_blockers(plan: &Plan, gains: &Gains) -> Vec<(u32, f64)> {
    let share = ERROR_OF_GAIN * through_a_bin(plan);
    let error =
        |list: &Vec<Gain>| Some((list.first()?.receiver, share * list.iter().map(|g| g.gain).sum::<f64>()));
    gains.strongest.iter().filter_map(error).collect()
}

/// Errors at receivers behind stacked layers.
pub fn behind_layers(plan: &Plan, layers: &Layers, stacked: &[u32]) -> Vec<(u32, f64)> {
    let share = ERROR_OF_GAIN * through_a_bin(plan);
    stacked.iter().map(|&i| (i, share * layers.product(i))).collect()
}

/// The error of a solution at some triangles, by path tracing: a mean over each of a few neighbourhoods, without the noise of the paths. The
/// same on every run. `irradiance`: of each triangle, W/m².
pub fn measured(plan: &Plan, tracer: &PathTracer, irradiance: &[[f64; 3]], concerned: &[u32]) -> Effect {
    let area = |i: u32| plan.facets()[i as usize].area;
    let light = |h: &[f64; 3]| DVec3::from(*h).length();
    let all: f64 = (0u32..).zip(irradiance).map(|(i, h)| area(i) * light(h)).sum();
    let chosen: HashSet<u32> = concerned.iter().copied().collect();
    let in_space: Vec<u32> = plan.layout().order.iter().copied().filter(|i| chosen.contains(i)).collect();
    if in_space.is_empty() || all <= 0.0 {
        return Effect { share: 0.0, measured: Some(0.0) };
    }
    let places: Vec<&[u32]> = in_space.chunks(in_space.len().div_ceil(PLACES)).collect();
    // The mean error over each place, without that of noise, and noise, both times its area.
    let errors: Vec<[f64; 2]> = parallel::map(&places, |place| {
        let (mut mean, mut noise) = (DVec3::ZERO, 0.0);
        for (i, times) in by_area(place, area) {
            let truth = tracer.irradiance_of(i as usize, PATHS * times);
            let weight = f64::from(times) / f64::from(TRIED);
            mean += weight * (DVec3::from(irradiance[i as usize]) - truth.mean);
            noise += weight * weight * truth.error.length_squared();
        }
        let whole: f64 = place.iter().map(|&i| area(i)).sum();
        [(mean.length_squared() - noise).max(0.0).sqrt(), noise.sqrt()].map(|error| whole * error / all)
    });
    let share = errors.iter().map(|[error, _]| error).sum();
    let noise = errors.iter().map(|[_, noise]| noise * noise).sum::<f64>().sqrt();
    Effect { share, measured: Some(noise) }
}

/// Triangles of a place, evenly spaced by area, with how often each is met.
fn by_area(place: &[u32], area: impl Fn(u32) -> f64) -> Vec<(u32, u32)> {
    let whole: f64 = place.iter().map(|&i| area(i)).sum();
    let mut met: Vec<(u32, u32)> = Vec::new();
    let (mut k, mut end) = (0, 0.0);
    for step in 0..TRIED {
        let at = whole * (f64::from(step) + 0.5) / f64::from(TRIED);
        while end + area(place[k]) < at && k + 1 < place.len() {
            end += area(place[k]);
            k += 1;
        }
        match met.last_mut() {
            Some((last, times)) if *last == place[k] => *times += 1,
            _ => met.push((place[k], 1)),
        }
    }
    met
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_core::plan::PlanOptions;
    use antirad_scene::{Material, Scene, SceneBuilder, Shape};
    use glam::DAffine3;

    /// In a closed room of uniform emission and albedo H = π L / (1 − ρ) everywhere.
    #[test]
    fn the_error_of_a_known_answer_is_found() {
        let wall = Material { albedo: [0.5; 3], emission: [1.0; 3], ..Material::named("wall") };
        let mut builder = SceneBuilder::new();
        builder.shape("room", Shape::Room { cells: 6 }, &wall, DAffine3::IDENTITY);
        let scene: Scene = builder.finish("furnace").expect("a scene");
        let plan = Plan::new(
            &scene,
            &PlanOptions::default(),
            &scene.settings.visibility(antirad_scene::VisibilityChoice::Implicit),
        )
        .expect("a plan");
        let tracer = PathTracer::new(&scene);
        let count = scene.triangles.len();
        let concerned: Vec<u32> = (0..count as u32 / 2).collect();
        let right = 2.0 * std::f64::consts::PI;
        for error in [0.0, 0.05, -0.2] {
            let found = |i: usize| [right * if i < count / 2 { 1.0 + error } else { 1.0 }; 3];
            let irradiance: Vec<[f64; 3]> = (0..count).map(found).collect();
            let effect = measured(&plan, &tracer, &irradiance, &concerned);
            let noise = effect.measured.expect("a standard error");
            let truth = error.abs() / (2.0 + error);
            println!("{truth:.4}: {effect}");
            assert!((effect.share - truth).abs() <= 4.0 * noise && noise <= 0.003, "{effect} for {truth}");
            assert_eq!(effect.exceeds(MATTERS), error != 0.0);
        }
        assert_eq!(measured(&plan, &tracer, &vec![[right; 3]; count], &[]).share, 0.0);
    }

    #[test]
    fn places_are_met_by_their_area() {
        let area = |i: u32| if i == 0 { 6.0 } else { 1.0 };
        let met = by_area(&[0, 1, 2, 3, 4, 5, 6], area);
        assert_eq!(met.iter().map(|(_, times)| times).sum::<u32>(), TRIED);
        assert_eq!(met[0], (0, TRIED / 2));
        assert_eq!(met.len(), 7);
        assert_eq!(by_area(&[9], area), [(9, TRIED)]);
    }
}
