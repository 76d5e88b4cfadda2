//! Which emitters are lamps: planar convex polygons and convex closed solids, few enough to be listed.

use super::polygon::{Polygon, connected, in_plane, merged};
use super::solid::Solid;
use crate::model::Facet;
use antirad_scene::Scene;
use std::collections::HashSet;

/// Sine of the largest angle between normals of one plane.
const PARALLEL: f64 = 1e-6;
/// Lamps up to which direct light is exact unless stated. Beyond them, a convex closed emitter is one whatever its silhouettes.
pub const FEW: usize = 128;

/// A planar convex emitter: one triangle, or several of one material in one plane, whose front is the lit side. Or a convex closed emitter
/// of one material ([`Polygon::solid`]).
pub type Lamp = Polygon;

/// The lamps of a scene: its emitters, in the order of their first triangles. `facets`: its triangles, in any unit of length;
/// `tolerance`: height in that unit up to which a corner is in a plane.
pub fn lamps(scene: &Scene, facets: &[Facet], tolerance: f64) -> Vec<Lamp> {
    let emits = |&i: &u32| {
        facets[i as usize].area > 0.0 && scene.material(i as usize).emission.iter().any(|&l| l != 0.0)
    };
    let emitters: Vec<u32> = (0..facets.len() as u32).filter(emits).collect();
    let alike = |i: u32, j: u32| scene.triangles[i as usize].material == scene.triangles[j as usize].material;
    let solids = Solid::among(facets, &emitters, tolerance, alike);
    let (mut whole, others): (Vec<Solid>, Vec<Solid>) =
        solids.into_iter().partition(|solid| solid.is_flat(facets));
    let lamps = beside(whole.clone(), facets, &emitters, tolerance, alike);
    if lamps.len() <= FEW || others.is_empty() {
        return lamps;
    }
    whole.extend(others);
    beside(whole, facets, &emitters, tolerance, alike)
}

/// Solids, and the planar lamps of all other emitters.
fn beside(
    solids: Vec<Solid>,
    facets: &[Facet],
    emitters: &[u32],
    tolerance: f64,
    alike: impl Fn(u32, u32) -> bool,
) -> Vec<Lamp> {
    let same = |i: u32, j: u32| in_plane(facets, [i, j], PARALLEL, tolerance) && alike(i, j);
    let of_solids: HashSet<u32> = solids.iter().flat_map(Solid::triangles).copied().collect();
    let emitters: Vec<u32> = emitters.iter().copied().filter(|i| !of_solids.contains(i)).collect();
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
