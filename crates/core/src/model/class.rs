//! Which triangles need direction bins and why; exact for any lights and materials.

use super::facet::Facet;
use super::hierarchy::{Hierarchy, Node, Sight};
use super::order::{BoundedRun, spatial_order};
use antirad_base::parallel;
use antirad_scene::Scene;

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

/// Heights above a plane below this fraction of the scene's diagonal are rounding, not geometry: the walls of a room,
/// subdivided and rotated, must not count as being behind one another.
const COPLANAR: f64 = 1e-6;

/// Triangles per leaf of the search for receivers.
const LEAF: usize = 16;

/// The class of every triangle of the scene.
pub fn classify(scene: &Scene) -> Vec<Class> {
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let search = Search::new(&facets);
    parallel::map(0..facets.len(), |i| Class {
        blocker: facets[i].area > 0.0 && search.casts_shadow(i),
        glossy: facets[i].area > 0.0 && scene.material(i).is_glossy(),
    })
}

/// The height in metres below which a corner counts as lying in a plane.
pub fn coplanar_tolerance(facets: &[Facet]) -> f64 {
    let bounds = BoundedRun::around(facets.iter());
    COPLANAR * (bounds.max - bounds.min).length()
}

/// Whether light from the front (`side` = 1) or back (-1) of `source` can reach the front of `receiver`.
pub fn reaches(source: &Facet, receiver: &Facet, side: f64, tolerance: f64) -> bool {
    let beyond = |plane: &Facet, corner: glam::DVec3| (corner - plane.centroid).dot(plane.normal);
    receiver.corners.iter().any(|&c| side * beyond(source, c) > tolerance)
        && source.corners.iter().any(|&c| beyond(receiver, c) > tolerance)
}

/// Finds what lies behind triangles.
struct Search<'a> {
    facets: &'a [Facet],
    /// Triangles with an area.
    order: Vec<u32>,
    tree: Hierarchy,
    tolerance: f64,
}

impl<'a> Search<'a> {
    fn new(facets: &'a [Facet]) -> Self {
        let order = spatial_order(facets);
        let tolerance = coplanar_tolerance(facets);
        let tree = Hierarchy::new(facets, &order, LEAF, tolerance);
        Self { facets, order, tree, tolerance }
    }

    /// True where some triangle can receive antiradiance from the back of triangle `i`.
    fn casts_shadow(&self, i: usize) -> bool {
        let source = &self.facets[i];
        let bounds = BoundedRun::around(std::iter::once(source));
        let behind = |node: &Node| {
            !self.tree.misses(source, &node.bounds, -1.0)
                && self.tree.sight(node, &bounds, 1.0, true) != Sight::Nothing
        };
        let mut slots = self.tree.leaves(behind).flat_map(|leaf| leaf.slots(LEAF, &self.order));
        slots.any(|&j| j as usize != i && reaches(source, &self.facets[j as usize], -1.0, self.tolerance))
    }
}
