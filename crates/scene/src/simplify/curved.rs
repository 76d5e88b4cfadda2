//! Where a surface curves, as opposed to planes and their edges and corners.

use super::super::{Fans, Welded};
use antirad_base::parallel;
use glam::DVec3;

/// Cosine of the largest angle between normals that count as one.
const SAME: f64 = 0.985;
/// Planes that meet at a corner.
const AT_CORNER: usize = 3;

/// Per vertex, whether triangles around its place face more ways than at the corner of a box.
pub(super) fn curved(places: &[DVec3], triangles: &[[u32; 3]]) -> Vec<bool> {
    let welded = Welded::exactly(places.iter().copied());
    let fans = Fans::of(welded.first.len(), triangles.iter().map(|&corners| welded.positions(corners)));
    let normal = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| places[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    let normals: Vec<DVec3> = parallel::map(triangles, normal);
    let curves = |position: u32| {
        let mut ways: Vec<DVec3> = Vec::new();
        for &t in fans.around(position) {
            let normal = normals[t as usize];
            if ways.iter().all(|way| way.dot(normal) < SAME) {
                ways.push(normal);
            }
        }
        ways.len() > AT_CORNER
    };
    let all: Vec<bool> = parallel::map(0..welded.first.len() as u32, curves);
    welded.position.iter().map(|&position| all[position as usize]).collect()
}
