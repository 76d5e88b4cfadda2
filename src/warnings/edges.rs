//! Blockers that are not closed, or not of one orientation, and triangles that are there twice.
//!
//! A triangle holds back what meets its front; what meets its back goes on. So a blocker must be closed, or stand on
//! something that closes it, with all fronts outside. Edges are compared as chains: along each, the triangles that run one
//! way are counted against those that run the other way, after edges have been cut where vertices of others lie on them.

use super::distance::to_triangle;
use crate::plan::{Block, Hierarchy, PADDING, Plan, coplanar_tolerance};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Triangles per leaf of the search for what edges stand on.
const LEAF: usize = 8;

/// Blockers with bad edges, by triangle of the scene, rising.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Edges {
    /// With an edge that no other triangle shares or touches.
    pub open: Vec<u32>,
    /// With an edge along which all triangles run the same way.
    pub inconsistent: Vec<u32>,
    /// Triangles, blockers or not, that lie on another one of the same corners and the same front.
    pub duplicate: Vec<u32>,
}

impl Edges {
    pub fn of(plan: &Plan) -> Self {
        let tolerance = coplanar_tolerance(&plan.facets);
        let (vertices, faces) = weld(plan, tolerance);
        let whole =
            Chain::of(faces.iter().flat_map(|&(t, [a, b, c])| [(t, [a, b]), (t, [b, c]), (t, [c, a])]));
        let loose: Vec<(u32, [u32; 2])> = whole.unbalanced().collect();
        // What is not balanced may be where one edge meets several shorter ones.
        let cut = Chain::of(cut(&vertices, &loose, tolerance));

        let blocker = |t: &&u32| plan.classes[**t as usize].blocker;
        let mut edges = Self::default();
        let mut lonely = Vec::new();
        for (&ends, edge) in cut.edges.iter().filter(|(_, edge)| edge.sum != 0) {
            match edge.triangles.as_slice() {
                [alone] if blocker(&alone) => lonely.push((*alone, ends)),
                several if several.len() > 1 && edge.sum.unsigned_abs() as usize == several.len() => {
                    edges.inconsistent.extend(several.iter().filter(blocker));
                }
                // Alone and no blocker; or a sheet that ends on a surface that goes on.
                _ => {}
            }
        }
        let standing = Standing::new(plan, tolerance);
        edges.open = lonely
            .par_iter()
            .filter(|(t, [a, b])| {
                let [a, b] = [vertices[*a as usize], vertices[*b as usize]];
                ![0.25, 0.5, 0.75].iter().all(|&s| standing.on_another(*t, a.lerp(b, s)))
            })
            .map(|&(t, _)| t)
            .collect();
        edges.duplicate = duplicates(&faces);
        for list in [&mut edges.open, &mut edges.inconsistent] {
            list.sort_unstable();
            list.dedup();
        }
        edges
    }
}

/// All but the first of the triangles that have the same corners in the same turn, rising.
fn duplicates(faces: &[(u32, [u32; 3])]) -> Vec<u32> {
    let mut seen = HashSet::new();
    let again = |&&(_, [a, b, c]): &&(u32, [u32; 3])| {
        let first = [[a, b, c], [b, c, a], [c, a, b]].into_iter().min();
        !seen.insert(first)
    };
    faces.iter().filter(again).map(|&(t, _)| t).collect()
}

/// Directed edges of triangles, summed up by their ends.
struct Chain {
    edges: HashMap<[u32; 2], Edge>,
}

#[derive(Default)]
struct Edge {
    triangles: Vec<u32>,
    /// Triangles that run from the lower to the higher end, less those that run back.
    sum: i32,
}

impl Chain {
    fn of(directed: impl IntoIterator<Item = (u32, [u32; 2])>) -> Self {
        let mut edges: HashMap<[u32; 2], Edge> = HashMap::new();
        for (triangle, [a, b]) in directed.into_iter().filter(|(_, [a, b])| a != b) {
            let edge = edges.entry([a.min(b), a.max(b)]).or_default();
            edge.triangles.push(triangle);
            edge.sum += if a < b { 1 } else { -1 };
        }
        Self { edges }
    }

    /// The edges that do not cancel, with each of their triangles, in its direction.
    fn unbalanced(&self) -> impl Iterator<Item = (u32, [u32; 2])> {
        self.edges.iter().filter(|(_, edge)| edge.sum != 0).flat_map(|(&[low, high], edge)| {
            let forward = (edge.triangles.len() as i32 + edge.sum) / 2;
            edge.triangles.iter().enumerate().map(move |(k, &t)| {
                // Which of the triangles run which way does not matter: only numbers are compared.
                (t, if (k as i32) < forward { [low, high] } else { [high, low] })
            })
        })
    }
}

/// Vertices that coincide within the tolerance become one. Triangles without area are left out.
fn weld(plan: &Plan, tolerance: f64) -> (Vec<DVec3>, Vec<(u32, [u32; 3])>) {
    let cell = |x: DVec3| (x / (2.0 * tolerance)).floor().as_i64vec3();
    let mut vertices: Vec<DVec3> = Vec::new();
    let mut cells: HashMap<glam::I64Vec3, Vec<u32>> = HashMap::new();
    let mut index = |x: DVec3| {
        // Whatever lies within the tolerance is in one of the cells at the corners of a cube around the point.
        for corner in 0..8 {
            let side = |axis: u32| if corner >> axis & 1 == 1 { tolerance } else { -tolerance };
            let near = cell(x + DVec3::new(side(0), side(1), side(2)));
            let known = cells.get(&near).into_iter().flatten();
            if let Some(&v) = known.into_iter().find(|&&v| vertices[v as usize].distance(x) <= tolerance) {
                return v;
            }
        }
        vertices.push(x);
        let new = vertices.len() as u32 - 1;
        cells.entry(cell(x)).or_default().push(new);
        new
    };
    let with_area = (0u32..).zip(&plan.facets).filter(|(_, facet)| facet.area > 0.0);
    let faces = with_area.map(|(t, facet)| (t, facet.corners.map(&mut index))).collect();
    (vertices, faces)
}

/// The same edges, cut at the ends of others that lie on them.
fn cut(vertices: &[DVec3], edges: &[(u32, [u32; 2])], tolerance: f64) -> Vec<(u32, [u32; 2])> {
    let mut ends: Vec<u32> = edges.iter().flat_map(|(_, ends)| *ends).collect();
    ends.sort_unstable();
    ends.dedup();
    let at = |v: u32| vertices[v as usize];
    // Sorted along the axis in which they are spread most.
    let spread = ends
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &v| (low.min(at(v)), high.max(at(v))));
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
    edges.par_iter().flat_map_iter(pieces).collect()
}

/// Finds what a point lies on.
struct Standing<'a> {
    plan: &'a Plan,
    order: Vec<u32>,
    tree: Hierarchy,
    tolerance: f64,
}

impl<'a> Standing<'a> {
    fn new(plan: &'a Plan, tolerance: f64) -> Self {
        let order: Vec<u32> = plan.layout.order.iter().copied().filter(|&i| i != PADDING).collect();
        let tree = Hierarchy::new(&plan.facets, &order, LEAF, tolerance);
        Self { plan, order, tree, tolerance }
    }

    /// True where a triangle other than `triangle` holds the point.
    fn on_another(&self, triangle: u32, point: DVec3) -> bool {
        let near =
            |Block { min, max }: &Block| (*min - point).max(point - *max).max_element() <= self.tolerance;
        let holds = |&i: &u32| {
            i != triangle
                && to_triangle(point, self.plan.facets[i as usize].corners).length() <= self.tolerance
        };
        let mut leaves = self.tree.leaves(|node| near(&node.bounds));
        leaves.any(|node| node.slots(LEAF, &self.order).iter().any(holds))
    }
}
