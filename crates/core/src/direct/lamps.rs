//! What light comes straight from: emitters, as planar convex polygons and convex closed solids, and suns.

use super::polygon::{Polygon, connected, in_plane, merged};
use super::solid::Solid;
use super::sun::Disc;
use crate::model::Facet;
use antirad_scene::Scene;
use std::collections::HashSet;

/// Sine of the largest angle between normals of one plane.
const PARALLEL: f64 = 1e-6;
/// Lamps up to which direct light is exact unless stated. Beyond them, a convex closed emitter is one whatever its silhouettes.
pub const FEW: usize = 128;

/// What light comes straight from.
#[derive(Clone, Debug, PartialEq)]
pub enum Lamp {
    /// A planar convex emitter: one triangle, or several of one material in one plane, whose front is the lit side. Or a convex closed
    /// emitter of one material ([`Polygon::solid`]).
    Surface(Polygon),
    /// A sun, of which no triangle is part.
    Sun(Disc),
}

impl Lamp {
    /// One triangle.
    pub fn single(triangle: u32) -> Self {
        Self::Surface(Polygon::single(triangle))
    }

    /// Its triangles; none of a sun.
    pub fn triangles(&self) -> &[u32] {
        self.surface().map_or(&[], |surface| &surface.triangles)
    }

    /// The emitter, unless it is a sun.
    pub fn surface(&self) -> Option<&Polygon> {
        match self {
            Self::Surface(surface) => Some(surface),
            Self::Sun(_) => None,
        }
    }

    /// The sun, if it is one.
    pub fn sun(&self) -> Option<&Disc> {
        match self {
            Self::Sun(disc) => Some(disc),
            Self::Surface(_) => None,
        }
    }

    /// Whether it stands where another one does, however either shines.
    pub fn is_at(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Sun(own), Self::Sun(other)) => own.is_at(other),
            _ => self == other,
        }
    }

    /// Whether its light passes a triangle: one of its own, or one behind a sun.
    pub fn passes(&self, triangle: u32) -> bool {
        match self {
            Self::Surface(surface) => surface.triangles.binary_search(&triangle).is_ok(),
            Self::Sun(disc) => disc.is_before(triangle),
        }
    }

    /// The surface of a convex closed emitter.
    pub fn solid(&self) -> Option<&Solid> {
        self.surface()?.solid.as_deref()
    }
}

/// The lamps of a scene: its emitters, in the order of their first triangles, and its suns. `facets`: its triangles, in any unit of
/// length; `tolerance`: height in that unit up to which a corner is in a plane.
pub fn lamps(scene: &Scene, facets: &[Facet], tolerance: f64) -> Vec<Lamp> {
    let surfaces = surfaces(scene, facets, tolerance).into_iter().map(Lamp::Surface);
    surfaces.chain(suns(scene)).collect()
}

/// The suns of a scene.
pub fn suns(scene: &Scene) -> impl Iterator<Item = Lamp> {
    Disc::all(scene).into_iter().map(Lamp::Sun)
}

/// The emitters of a scene.
fn surfaces(scene: &Scene, facets: &[Facet], tolerance: f64) -> Vec<Polygon> {
    let emits = |&i: &u32| facets[i as usize].area > 0.0 && scene.material(i as usize).emits();
    let emitters: Vec<u32> = (0..facets.len() as u32).filter(emits).collect();
    let alike = |i: u32, j: u32| scene.triangles[i as usize].material == scene.triangles[j as usize].material;
    let solids = Solid::among(facets, &emitters, tolerance, alike);
    let same = |i: u32, j: u32| in_plane(facets, [i, j], PARALLEL, tolerance);
    let faces = |solid: &Solid| connected(facets, solid.triangles(), tolerance, same).len();
    let (mut whole, others): (Vec<Solid>, Vec<Solid>) =
        solids.into_iter().partition(|solid| solid.is_flat(facets, faces(solid)));
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
) -> Vec<Polygon> {
    let same = |i: u32, j: u32| in_plane(facets, [i, j], PARALLEL, tolerance) && alike(i, j);
    let of_solids: HashSet<u32> = solids.iter().flat_map(Solid::triangles).copied().collect();
    let emitters: Vec<u32> = emitters.iter().copied().filter(|i| !of_solids.contains(i)).collect();
    let mut lamps: Vec<Polygon> = solids.into_iter().map(Solid::whole).collect();
    for group in connected(facets, &emitters, tolerance, same) {
        match merged(facets, &group) {
            Some(lamp) => lamps.push(lamp),
            None => lamps.extend(group.into_iter().map(Polygon::single)),
        }
    }
    lamps.sort_by_key(Polygon::first);
    lamps
}
