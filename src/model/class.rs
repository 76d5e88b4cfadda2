//! Which triangles need direction bins, and why: exact, for whatever the lights and materials are.

use super::facet::Facet;
use super::order::{Block, blocks, spatial_order};
use crate::scene::Scene;
use rayon::prelude::*;

/// What is modelled of a triangle beyond its irradiance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Class {
    /// Something behind it can receive what it blocks: it keeps irradiance per bin and emits antiradiance.
    pub blocker: bool,
    /// It reflects a specular lobe: it keeps irradiance per bin and emits radiance per bin.
    pub glossy: bool,
}

impl Class {
    /// True where the triangle keeps irradiance per direction bin.
    pub fn has_bins(self) -> bool {
        self.blocker || self.glossy
    }
}

/// Heights above a plane below this share of the scene's diagonal are rounding, not geometry: the walls of a room,
/// subdivided and rotated, must not count as being behind one another.
const COPLANAR: f64 = 1e-6;

/// The class of every triangle of the scene.
pub fn classify(scene: &Scene) -> Vec<Class> {
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let order = spatial_order(&facets);
    let blocks = blocks(&facets, &order);
    let tolerance = coplanar_tolerance(&facets);
    (0..facets.len())
        .into_par_iter()
        .map(|i| Class {
            blocker: facets[i].area > 0.0 && casts_shadow(&facets, &order, &blocks, i, tolerance),
            glossy: facets[i].area > 0.0 && scene.material(i).is_glossy(),
        })
        .collect()
}

/// The height in metres below which a corner counts as lying in a plane.
pub fn coplanar_tolerance(facets: &[Facet]) -> f64 {
    let bounds = Block::around(facets.iter());
    COPLANAR * (bounds.max - bounds.min).length()
}

/// True where light that leaves the front or back of `source` as `side` (1 or -1) can reach the front of `receiver`.
pub fn reaches(source: &Facet, receiver: &Facet, side: f64, tolerance: f64) -> bool {
    let beyond = |plane: &Facet, corner: glam::DVec3| (corner - plane.centroid).dot(plane.normal);
    receiver.corners.iter().any(|&c| side * beyond(source, c) > tolerance)
        && source.corners.iter().any(|&c| beyond(receiver, c) > tolerance)
}

/// True where some triangle can receive antiradiance from the back of triangle `i`.
fn casts_shadow(facets: &[Facet], order: &[u32], blocks: &[Block], i: usize, tolerance: f64) -> bool {
    let source = &facets[i];
    blocks.iter().any(|block| {
        block.lowest(source.normal) - source.normal.dot(source.centroid) < -tolerance
            && order[block.range.clone()].iter().any(|&j| {
                let receiver = &facets[j as usize];
                j as usize != i && receiver.area > 0.0 && reaches(source, receiver, -1.0, tolerance)
            })
    })
}
