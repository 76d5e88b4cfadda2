//! Which emitters are lamps: planar convex polygons and convex closed solids, few enough to be listed.

use super::polygon::{Polygon, connected, in_plane, merged};
use super::solid::{FLAT, Solid};
use crate::model::Facet;
use antirad_scene::Scene;
use std::collections::HashSet;

/// Sine of the largest angle between normals of one plane.
const PARALLEL: f64 = 1e-6;
/// Lamps beyond which a convex closed emitter is one whatever its silhouettes: in parts, few of so many would be lamps at all.
const MANY: usize = 128;

/// A planar convex emitter: one triangle, or several of one material in one plane, whose front is the lit side. Or a convex closed emitter
/// of one material ([`Polygon::solid`]).
pub type Lamp = Polygon;

/// The lamps of a scene: its emitters, in the order of their first triangles. `facets`: its triangles, in any unit of length;
/// `tolerance`: height in that unit up to which a corner is in a plane.
pub fn lamps(scene: &Scene, facets: &[Facet], tolerance: f64) -> Vec<Lamp> {
    let lamps = lamps_with_solids(scene, facets, tolerance, FLAT);
    if lamps.len() <= MANY { lamps } else { lamps_with_solids(scene, facets, tolerance, f64::INFINITY) }
}

fn lamps_with_solids(scene: &Scene, facets: &[Facet], tolerance: f64, flat: f64) -> Vec<Lamp> {
    let emits = |&i: &u32| {
        facets[i as usize].area > 0.0 && scene.material(i as usize).emission.iter().any(|&l| l != 0.0)
    };
    let emitters: Vec<u32> = (0..facets.len() as u32).filter(emits).collect();
    let material = |i: u32| scene.triangles[i as usize].material;
    let same = |i: u32, j: u32| in_plane(facets, [i, j], PARALLEL, tolerance) && material(i) == material(j);
    let alike = |i: u32, j: u32| material(i) == material(j);
    let solids = Solid::among(facets, &emitters, (tolerance, flat), alike);
    let of_solids: HashSet<u32> = solids.iter().flat_map(Solid::triangles).copied().collect();
    let emitters: Vec<u32> = emitters.into_iter().filter(|i| !of_solids.contains(i)).collect();
    let mut lamps: Vec<Lamp> = solids.into_iter().map(Solid::whole).collect();
    for group in connected(facets, &emitters, tolerance, same) {
        match merged(facets, &group) {
            Some(lamp) => lamps.push(lamp),
            None => lamps.extend(group.into_iter().map(Lamp::single)),
        }
    }
    lamps.sort_by_key(Lamp::first);
    lamps
}
