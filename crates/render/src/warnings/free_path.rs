//! Triangles that reach further than light travels freely from them: the rods of a grid, the slats of blinds.
//!
//! Light is even over a triangle. Among dense blockers it falls off along one within about the distance of the next surface, and what is
//! brightest is what the room sees best: evenly, too little of it leaves.

use super::refine::cut_coarse;
use super::too_coarse;
use crate::path_tracer::PathTracer;
use antirad_base::parallel;
use antirad_core::direct::from_front;
use antirad_core::model::Facet;
use antirad_core::plan::is_explicit;
use antirad_scene::Scene;

/// Sides longer than so many free paths are cut.
const LONG: f64 = 1.0;
/// Sides below this share of the scene's diagonal, without a sky, are not.
const SHORT: f64 = 0.03;
/// Rays that tell the free path of a triangle: their median.
const RAYS: u32 = 31;
/// Paths that tell how bright a triangle is.
const PATHS: u32 = 8;
/// Triangles that tell the mean irradiance.
const TRIED: usize = 1000;
/// Irradiance relative to that mean below which a triangle stays as it is, such as the sides of books that stand close together.
const DARK: f64 = 0.05;
/// What limits grow by where the mesh would have too many triangles.
const LOOSER: f64 = 1.2;

/// Cuts the mesh of a scene whose visibility is explicit, as far as `max_triangles` allows: one that is [far too coarse](super::too_coarse) for the
/// light of lamps, as [`refine`](super::refine) does at first, and then lit triangles with sides longer than the median distance of what lies
/// before them and 3 % of the scene's diagonal. Returns the original triangle of each new one; `None` where visibility is implicit.
pub fn cut_for_rays(scene: &mut Scene, max_triangles: usize) -> Option<Vec<u32>> {
    if !is_explicit(scene) {
        return None;
    }
    let coarse = match too_coarse(scene) {
        true => cut_coarse(scene, max_triangles),
        false => (0..scene.triangles.len() as u32).collect(),
    };
    let mut limits = limits(scene);
    let given = scene.clone();
    loop {
        let parents = scene.split_long(&limits);
        if parents.len() <= max_triangles.max(limits.len()) {
            return Some(parents.into_iter().map(|parent| coarse[parent as usize]).collect());
        }
        *scene = given.clone();
        limits.iter_mut().for_each(|limit| *limit *= LOOSER);
    }
}

/// Longest side that each triangle may have, m.
fn limits(scene: &Scene) -> Vec<f64> {
    let count = scene.triangles.len();
    let facets: Vec<Facet> = (0..count).map(|i| Facet::new(scene.corners(i))).collect();
    let tracer = PathTracer::new(scene);
    let free_path = |i: usize| {
        let nearest = |(origin, ray)| tracer.rays().nearest(origin, ray, Some(i));
        let first = |ray| nearest(ray).map_or(f64::INFINITY, |(_, at)| at);
        let mut distances: Vec<f64> = from_front(&facets[i], i as u64, 0..RAYS).map(first).collect();
        distances.sort_by(f64::total_cmp);
        distances[distances.len() / 2]
    };
    let short = SHORT * scene.diagonal_of_what_reflects();
    let irradiance = |i: usize| tracer.irradiance_of(i, PATHS).mean.element_sum();
    let reflecting: Vec<usize> = (0..count).filter(|&i| !scene.material(i).only_emits()).collect();
    let tried: Vec<usize> =
        reflecting.iter().copied().step_by(reflecting.len().div_ceil(TRIED).max(1)).collect();
    let found: Vec<f64> = parallel::map(&tried, |&i| facets[i].area * irradiance(i));
    let mean = found.iter().sum::<f64>() / tried.iter().map(|&i| facets[i].area).sum::<f64>();
    let limit = |i: usize| {
        if facets[i].area <= 0.0 || scene.material(i).diffuse_albedo() == [0.0; 3] {
            return f64::INFINITY;
        }
        let longest = scene.longest_side(i).1;
        if longest <= short {
            return f64::INFINITY;
        }
        let limit = short.max(LONG * free_path(i));
        let is_lit_and_long = longest > limit && irradiance(i) > DARK * mean;
        if is_lit_and_long { limit } else { f64::INFINITY }
    };
    let of_fronts: Vec<f64> = parallel::map(0..count, limit);
    // Both sides of a sheet are cut alike.
    let other = scene.other_sides();
    (0..count)
        .map(|i| other[i].map_or(of_fronts[i], |back| of_fronts[i].min(of_fronts[back as usize])))
        .collect()
}
