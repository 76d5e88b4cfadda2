//! How a mesh is cut for a solve, by its geometry and which of its triangles emit.
//!
//! The radiance of a triangle is one number for each channel (and each bin). It is cut where light varies within it by more than that can tell:
//! where others stand on it, close to lamps, and where it reaches further than light travels freely from it, as rods of a grid and slats of blinds
//! do. Neither materials nor the brightness of lamps matter, so that the mesh of a scene stays the same while these are fitted.

use super::flooded::flooded;
use crate::direct::from_front;
use crate::model::Facet;
use antirad_base::parallel;
use antirad_scene::{Cut, Scene};

/// Longest side of a triangle, as a share of the scene's diagonal: over more, light that surfaces reflect onto each other varies.
const WIDEST: f64 = 0.15;
/// Sides longer than so many free paths are cut.
const LONG: f64 = 1.0;
/// Sides below this share of the scene's diagonal, without a sky, are not.
const SHORT: f64 = 0.03;
/// Rays that tell the free path of a triangle: their median.
const RAYS: u32 = 31;
/// What limits grow by where the mesh would have too many triangles.
const LOOSER: f64 = 1.2;

/// The scene of parts, and how its triangles were cut: at most `max_triangles`, if it had no more. `moves`: whether parts inside of others stay, where
/// they may come to light.
pub(super) fn cut(scene: &Scene, max_triangles: usize, moves: bool) -> (Scene, Cut) {
    let mut finer = scene.clone();
    let mut parents = match moves {
        true => finer.cut_along_all_contacts(max_triangles),
        false => finer.cut_along_contacts(max_triangles),
    };
    parents = of_parts(&parents, &cut_coarse(&mut finer, max_triangles));
    parents = of_parts(&parents, &cut_at_free_paths(&mut finer, max_triangles));
    let cut = Cut::between(scene, &finer, &parents);
    // To the last bit what later cuts of the moved scene are.
    (cut.apply(scene), cut)
}

/// Cuts what is close to lamps, and wide triangles, as far as `max_triangles` allows: the triangle of each new one.
pub fn cut_coarse(scene: &mut Scene, max_triangles: usize) -> Vec<u32> {
    let mut parents: Vec<u32> = (0..scene.triangles.len() as u32).collect();
    loop {
        let mut flooded = scene.with_other_sides(flooded(scene));
        flooded.sort_unstable();
        if flooded.is_empty() || scene.triangles.len() + 3 * flooded.len() > max_triangles {
            break;
        }
        parents = of_parts(&parents, &scene.split(&flooded));
    }
    of_parts(&parents, &scene.split_wide(WIDEST, max_triangles))
}

/// The triangles that parts of parts are of. `parts`: of each new part, the former one.
fn of_parts(parents: &[u32], parts: &[u32]) -> Vec<u32> {
    parts.iter().map(|&part| parents[part as usize]).collect()
}

/// Cuts triangles with sides longer than the median distance of what lies before them and 3 % of the scene's diagonal: the triangle of each
/// new one.
fn cut_at_free_paths(scene: &mut Scene, max_triangles: usize) -> Vec<u32> {
    let mut limits = limits(scene);
    let given = scene.clone();
    loop {
        let parents = scene.split_long(&limits);
        if parents.len() <= max_triangles.max(limits.len()) {
            return parents;
        }
        *scene = given.clone();
        limits.iter_mut().for_each(|limit| *limit *= LOOSER);
    }
}

/// Longest side that each triangle may have, m.
fn limits(scene: &Scene) -> Vec<f64> {
    let count = scene.triangles.len();
    let rays = scene.rays();
    let free_path = |i: usize| {
        let facet = Facet::new(scene.corners(i));
        let first = |(origin, ray)| rays.nearest(origin, ray, Some(i)).map_or(f64::INFINITY, |(_, at)| at);
        let mut distances: Vec<f64> = from_front(&facet, i as u64, 0..RAYS).map(first).collect();
        distances.sort_by(f64::total_cmp);
        distances[distances.len() / 2]
    };
    let short = SHORT * scene.diagonal_of_what_reflects();
    let limit = |i: usize| {
        let longest = scene.longest_side(i).1;
        if longest <= short || scene.area_vector(i).length() <= 0.0 || scene.material(i).only_emits() {
            return f64::INFINITY;
        }
        let limit = short.max(LONG * free_path(i));
        if longest > limit { limit } else { f64::INFINITY }
    };
    let of_fronts: Vec<f64> = parallel::map(0..count, limit);
    // Both sides of a sheet are cut alike.
    let other = scene.other_sides();
    let both = |i: usize| other[i].map_or(of_fronts[i], |back| of_fronts[i].min(of_fronts[back as usize]));
    (0..count).map(both).collect()
}
