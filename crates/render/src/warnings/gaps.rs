//! Gaps narrower than the triangles on their sides, from which light leaks.

use super::distance::between;
use antirad_base::parallel;
use antirad_core::model::{BoundedRun, Facet, Hierarchy, coplanar_tolerance, reaches};
use antirad_core::plan::{PADDING, Plan};
use glam::DVec3;

/// A gap is narrow below this multiple of the size √s of the larger triangle.
const NARROW: f64 = 0.5;
/// Smallest cosine between the gap and both normals: surfaces that meet at an angle form an edge, not a gap.
const FACING: f64 = 0.7;

/// Triangles per leaf of the search.
const LEAF: usize = 8;

/// Two triangles that face each other: indices in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// The larger one.
    pub wide: u32,
    pub other: u32,
    /// Width of the gap over the size √s of the larger triangle.
    pub share: f64,
}

/// For each triangle, the narrowest gap to a smaller one that light or antiradiance crosses.
pub fn gaps(plan: &Plan) -> Vec<Gap> {
    let facets = plan.facets();
    let order: Vec<u32> = plan.layout().order.iter().copied().filter(|&i| i != PADDING).collect();
    let size = |i: u32| facets[i as usize].characteristic_area.sqrt();
    let tolerance = coplanar_tolerance(facets);
    let tree = Hierarchy::new(facets, &order, LEAF, tolerance);
    let passes = |i: usize, j: usize| {
        reaches(&facets[i], &facets[j], 1.0, tolerance)
            || plan.classes()[i].blocker && reaches(&facets[i], &facets[j], -1.0, tolerance)
    };
    let narrow = |wide: u32, other: u32| -> Option<Gap> {
        let (i, j) = (wide as usize, other as usize);
        if size(other) > size(wide) || wide == other {
            return None;
        }
        let most = NARROW * size(wide);
        let gap = near(&facets[i], &facets[j], most)?;
        let width = gap.length();
        (width > tolerance && width < most && facing(gap, &facets[i]) && facing(gap, &facets[j]))
            .then_some(())
            .filter(|()| passes(i, j) || passes(j, i))
            .map(|()| Gap { wide, other, share: width / size(wide) })
    };
    let narrowest = |&wide: &u32| {
        let around = BoundedRun::around(std::iter::once(&facets[wide as usize]));
        let range = NARROW * size(wide);
        tree.leaves(|node| around.distance_squared(&node.bounds) < range * range)
            .flat_map(|node| node.slots(LEAF, &order))
            .filter_map(|&other| narrow(wide, other))
            .min_by(|a, b| a.share.total_cmp(&b.share))
    };
    parallel::flat_map(&order, narrowest)
}

/// The shortest vector between two roughly parallel facets, or `None` where it is certainly longer than `most`.
fn near(a: &Facet, b: &Facet, most: f64) -> Option<DVec3> {
    if a.normal.dot(b.normal).abs() < FACING {
        return None;
    }
    let within = |x: &Facet, y: &Facet| {
        y.corners.iter().any(|&c| (c - x.centroid).dot(x.normal).abs() <= most * (1.0 + 1.0 / FACING))
    };
    let reach = |x: &Facet| x.corners.iter().map(|&c| c.distance(x.centroid)).fold(0.0, f64::max);
    if a.centroid.distance(b.centroid) > most + reach(a) + reach(b) || !within(a, b) {
        return None;
    }
    Some(between(a.corners, b.corners))
}

fn facing(gap: DVec3, facet: &Facet) -> bool {
    gap.dot(facet.normal).abs() >= FACING * gap.length()
}
