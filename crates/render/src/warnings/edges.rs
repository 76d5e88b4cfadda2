//! Blockers that are open or inconsistently oriented, and duplicate triangles.
//!
//! A triangle blocks light that hits its front; light that hits its back passes. So a blocker must be closed, or stand on
//! something that closes it, with all fronts outside. An edge is balanced if as many triangles traverse it one way as the other.
//! Unbalanced edges are split at vertices of others that lie on them, and tested again.

use super::distance::to_triangle;
use antirad_base::parallel;
use antirad_core::model::{BoundedRun, Hierarchy, coplanar_tolerance};
use antirad_core::plan::{PADDING, Plan};
use antirad_scene::{self as scene, Welded, bounds, sides};
use glam::DVec3;
use std::collections::HashSet;

/// Triangles per leaf of the search for surfaces that edges stand on.
const LEAF: usize = 8;

/// Triangles with bad edges: indices in the scene, ascending.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Edges {
    /// Blockers with an edge that no other triangle shares or touches.
    pub open: Vec<u32>,
    /// Blockers with an edge that all its triangles traverse in the same direction.
    pub inconsistent: Vec<u32>,
    /// Triangles, blockers or not, with the same corners and the same front as another.
    pub duplicate: Vec<u32>,
}

impl Edges {
    pub fn of(plan: &Plan) -> Self {
        let tolerance = coplanar_tolerance(plan.facets());
        let (vertices, faces) = weld(plan, tolerance);
        let whole = scene::Edges::new(faces.iter().flat_map(|&(t, abc)| sides(abc).map(|side| (t, side))));
        let unbalanced = whole.iter().filter(|edge| edge.balance() != 0);
        let loose: Vec<(u32, [u32; 2])> = unbalanced.flat_map(|edge| edge.directed()).collect();
        // An unbalanced edge may meet several shorter ones.
        let cut = scene::Edges::new(cut(&vertices, &loose, tolerance));

        let blocker = |t: &u32| plan.classes()[*t as usize].blocker;
        let mut edges = Self::default();
        let mut unshared = Vec::new();
        // All other edges balance, or end on a surface that continues.
        for edge in cut.iter().filter(|edge| edge.balance().unsigned_abs() as usize == edge.len()) {
            let blockers = edge.triangles().filter(blocker);
            match edge.len() {
                1 => unshared.extend(blockers.map(|alone| (alone, edge.ends()))),
                _ => edges.inconsistent.extend(blockers),
            }
        }
        let standing = Standing::new(plan, tolerance);
        edges.open = parallel::flat_map(unshared, |(t, ends)| {
            let [a, b] = ends.map(|v| vertices[v as usize]);
            let stands = [0.25, 0.5, 0.75].iter().all(|&s| standing.on_another(t, a.lerp(b, s)));
            (!stands).then_some(t)
        });
        edges.duplicate = duplicates(&faces);
        for list in [&mut edges.open, &mut edges.inconsistent] {
            list.sort_unstable();
            list.dedup();
        }
        edges
    }
}

/// All but the first of the triangles with the same corners in the same cyclic order, ascending.
fn duplicates(faces: &[(u32, [u32; 3])]) -> Vec<u32> {
    let mut seen = HashSet::new();
    let again = |&&(_, [a, b, c]): &&(u32, [u32; 3])| {
        let first = [[a, b, c], [b, c, a], [c, a, b]].into_iter().min();
        !seen.insert(first)
    };
    faces.iter().filter(again).map(|&(t, _)| t).collect()
}

/// Vertex positions and triangles, welded within the tolerance, without triangles of zero area.
fn weld(plan: &Plan, tolerance: f64) -> (Vec<DVec3>, Vec<(u32, [u32; 3])>) {
    let with_area = || (0u32..).zip(plan.facets()).filter(|(_, facet)| facet.area > 0.0);
    let corners: Vec<DVec3> = with_area().flat_map(|(_, facet)| facet.corners).collect();
    let welded = Welded::within(tolerance, corners.iter().copied());
    let faces =
        with_area().zip(welded.position.chunks_exact(3)).map(|((t, _), abc)| (t, [abc[0], abc[1], abc[2]]));
    (welded.first.iter().map(|&v| corners[v as usize]).collect(), faces.collect())
}

/// Edges with their triangles, split at the ends of others that lie on them.
fn cut(vertices: &[DVec3], edges: &[(u32, [u32; 2])], tolerance: f64) -> Vec<(u32, [u32; 2])> {
    let mut ends: Vec<u32> = edges.iter().flat_map(|(_, ends)| *ends).collect();
    ends.sort_unstable();
    ends.dedup();
    let at = |v: u32| vertices[v as usize];
    // Sorted along the axis of largest spread.
    let spread = bounds(ends.iter().map(|&v| at(v)));
    let axis = (spread.1 - spread.0).max_position();
    ends.sort_by(|&a, &b| at(a)[axis].total_cmp(&at(b)[axis]));
    let pieces = |&(triangle, [a, b]): &(u32, [u32; 2])| {
        let (from, to) = (at(a), at(b));
        let along = to - from;
        let (low, high) = (from[axis].min(to[axis]) - tolerance, from[axis].max(to[axis]) + tolerance);
        let first = ends.partition_point(|&v| at(v)[axis] < low);
        let mut inside: Vec<(f64, u32)> = ends[first..]
            .iter()
            .take_while(|&&v| at(v)[axis] <= high)
            .filter(|&&v| v != a && v != b)
            .filter_map(|&v| {
                let s = (at(v) - from).dot(along) / along.length_squared();
                let off = at(v).distance(from + along * s);
                (s > 0.0 && s < 1.0 && off <= tolerance).then_some((s, v))
            })
            .collect();
        inside.sort_by(|x, y| x.0.total_cmp(&y.0));
        let stops: Vec<u32> =
            std::iter::once(a).chain(inside.into_iter().map(|(_, v)| v)).chain([b]).collect();
        stops.windows(2).map(|run| (triangle, [run[0], run[1]])).collect::<Vec<_>>()
    };
    parallel::flat_map(edges, pieces)
}

/// Finds triangles at a point.
struct Standing<'a> {
    plan: &'a Plan,
    order: Vec<u32>,
    tree: Hierarchy,
    tolerance: f64,
}

impl<'a> Standing<'a> {
    fn new(plan: &'a Plan, tolerance: f64) -> Self {
        let order: Vec<u32> = plan.layout().order.iter().copied().filter(|&i| i != PADDING).collect();
        let tree = Hierarchy::new(plan.facets(), &order, LEAF, tolerance);
        Self { plan, order, tree, tolerance }
    }

    /// Whether a triangle other than `triangle` contains the point.
    fn on_another(&self, triangle: u32, point: DVec3) -> bool {
        let near = |BoundedRun { min, max }: &BoundedRun| {
            (*min - point).max(point - *max).max_element() <= self.tolerance
        };
        let holds = |&i: &u32| {
            i != triangle
                && to_triangle(point, self.plan.facets()[i as usize].corners).length() <= self.tolerance
        };
        let mut leaves = self.tree.leaves(|node| near(&node.bounds));
        leaves.any(|node| node.slots(LEAF, &self.order).iter().any(holds))
    }
}
