//! Planar convex polygons, merged from triangles: lamps, and what blocks their light. A shadow then takes as many cuts as a face has
//! edges, however fine its mesh.

use super::solid::Solid;
use crate::model::Facet;
use antirad_scene::{Welded, sides};
use glam::{DVec2, DVec3};
use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

/// Relative difference of areas up to which a convex hull is the union of its triangles.
const FILLED: f64 = 1e-9;

/// One triangle, or several that share edges and a plane and whose union is convex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Polygon {
    /// Numbers of the triangles of the polygon.
    pub triangles: Vec<u32>,
    /// Corners of the polygon, counter-clockwise seen from the front, each as a triangle and a corner of it.
    pub corners: Vec<[u32; 2]>,
    /// Corners of the polygon, and the vertices of triangles between them, in order.
    pub outline: Vec<[u32; 2]>,
    /// The place of each corner in the outline.
    starts: Vec<u32>,
    /// The surface, where this stands for a convex closed emitter: corners are all of its vertices then.
    pub solid: Option<Arc<Solid>>,
}

impl Polygon {
    /// One triangle.
    pub fn single(triangle: u32) -> Self {
        let corners = vec![[triangle, 0], [triangle, 1], [triangle, 2]];
        Self {
            triangles: vec![triangle],
            outline: corners.clone(),
            corners,
            starts: vec![0, 1, 2],
            solid: None,
        }
    }

    /// Triangles with these corners around them.
    pub fn around(triangles: Vec<u32>, corners: Vec<[u32; 2]>) -> Self {
        let starts = (0..corners.len() as u32).collect();
        Self { triangles, outline: corners.clone(), corners, starts, solid: None }
    }

    /// The first of its triangles, which has its plane and, of a lamp, its emission.
    pub fn first(&self) -> usize {
        self.triangles[0] as usize
    }

    /// The vertices of the outline from a corner up to the next, that one excluded; numbers go on beyond the end of the outline.
    pub fn edge(&self, corner: usize) -> Range<usize> {
        let start = self.starts[corner] as usize;
        match self.starts.get(corner + 1) {
            Some(&next) => start..next as usize,
            None => start..self.outline.len() + self.starts[0] as usize,
        }
    }

    /// The vertex of the outline with a number, which may go on beyond its end.
    pub fn vertex(&self, number: usize) -> [u32; 2] {
        self.outline[number % self.outline.len()]
    }
}

/// The mean of some points.
pub fn mean(points: &[DVec3]) -> DVec3 {
    points.iter().sum::<DVec3>() / points.len() as f64
}

/// The place of the point that is farthest in a direction.
pub fn farthest(points: &[DVec3], direction: DVec3) -> usize {
    let along = |k: &usize| points[*k].dot(direction);
    (0..points.len()).max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(0)
}

/// Whether triangle `j` lies in the plane of triangle `i`, up to an angle between normals with a sine of `parallel` and a height of
/// `tolerance`, and faces the same side.
pub fn in_plane(facets: &[Facet], [i, j]: [u32; 2], parallel: f64, tolerance: f64) -> bool {
    let (a, b) = (&facets[i as usize], &facets[j as usize]);
    let low = |corner: &DVec3| (*corner - a.centroid).dot(a.normal).abs() <= tolerance;
    a.normal.dot(b.normal) > 0.0 && a.normal.cross(b.normal).length() <= parallel && b.corners.iter().all(low)
}

/// Groups of the triangles `among`, connected by edges, all of which are the `same` as the first of their group; each in ascending
/// order. Edges that were cut at their midpoints on one side only connect as well, up to a distance of `tolerance`.
pub fn connected(
    facets: &[Facet],
    among: &[u32],
    tolerance: f64,
    same: impl Fn(u32, u32) -> bool,
) -> Vec<Vec<u32>> {
    let corners = || among.iter().flat_map(|&i| facets[i as usize].corners);
    let welded = Welded::exactly(corners());
    let places: Vec<DVec3> = {
        let corners: Vec<DVec3> = corners().collect();
        welded.first.iter().map(|&corner| corners[corner as usize]).collect()
    };
    let sides_of = |at: u32| sides(welded.positions([3 * at, 3 * at + 1, 3 * at + 2]));
    let whole = (0..among.len() as u32).flat_map(|at| sides_of(at).into_iter().map(move |side| (side, at)));
    let of_triangles = cut_at_midpoints(whole.collect(), &places, tolerance);
    let mut with_side = of_triangles.clone();
    with_side.sort_unstable();
    let mut grouped = vec![false; among.len()];
    let mut groups = Vec::new();
    for start in 0..among.len() as u32 {
        if std::mem::replace(&mut grouped[start as usize], true) {
            continue;
        }
        let mut group = vec![start];
        let mut done = 0;
        while let Some(&at) = group.get(done) {
            done += 1;
            let from = of_triangles.partition_point(|(_, other)| *other < at);
            for ([a, b], _) in of_triangles[from..].iter().take_while(|(_, other)| *other == at) {
                let from = with_side.partition_point(|(side, _)| *side < [*b, *a]);
                let neighbours = with_side[from..].iter().take_while(|(side, _)| *side == [*b, *a]);
                for &(_, next) in neighbours {
                    if !grouped[next as usize] && same(among[start as usize], among[next as usize]) {
                        grouped[next as usize] = true;
                        group.push(next);
                    }
                }
            }
        }
        group.sort_unstable();
        groups.push(group.into_iter().map(|at| among[at as usize]).collect());
    }
    groups
}

/// A directed edge between two positions, and the number of its triangle.
type Side = ([u32; 2], u32);

/// Edges of triangles, in the order of these, with those that nothing runs back along cut in halves while a vertex of another such edge
/// is in their middle. `places`: the positions.
fn cut_at_midpoints(mut all: Vec<Side>, places: &[DVec3], tolerance: f64) -> Vec<Side> {
    loop {
        let known: HashSet<[u32; 2]> = all.iter().map(|(side, _)| *side).collect();
        let alone = |[a, b]: [u32; 2]| a != b && !known.contains(&[b, a]);
        let ends: Vec<u32> =
            all.iter().filter(|(side, _)| alone(*side)).flat_map(|(side, _)| *side).collect();
        let middle = |[a, b]: [u32; 2]| 0.5 * (places[a as usize] + places[b as usize]);
        let open = || all.iter().map(|(side, _)| *side).filter(|side| alone(*side));
        let welded =
            Welded::within(tolerance, ends.iter().map(|&p| places[p as usize]).chain(open().map(middle)));
        // The vertex of each edge's middle, if there is one.
        let mut vertices = welded.position[ends.len()..]
            .iter()
            .map(|&position| ends.get(welded.first[position as usize] as usize).copied());
        let count = all.len();
        all = all
            .into_iter()
            .flat_map(|([a, b], at)| {
                let vertex = if alone([a, b]) { vertices.next().flatten() } else { None };
                match vertex.filter(|m| ![a, b].contains(m)) {
                    Some(m) => [Some(([a, m], at)), Some(([m, b], at))],
                    None => [Some(([a, b], at)), None],
                }
            })
            .flatten()
            .collect();
        if all.len() == count {
            return all;
        }
    }
}

/// The convex hull of coplanar triangles, if they fill it.
pub fn merged(facets: &[Facet], group: &[u32]) -> Option<Polygon> {
    let plane = &facets[group[0] as usize];
    let frame = crate::model::orthonormal_basis(plane.normal);
    let place = |&[i, k]: &[u32; 2]| {
        let at = facets[i as usize].corners[k as usize] - plane.centroid;
        DVec2::new(at.dot(frame.x_axis), at.dot(frame.y_axis))
    };
    let all = group.iter().flat_map(|&i| [[i, 0], [i, 1], [i, 2]]);
    let mut points: Vec<(DVec2, [u32; 2])> = all.map(|corner| (place(&corner), corner)).collect();
    points.sort_by(|(a, _), (b, _)| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup_by(|(a, _), (b, _)| a == b);
    let area: f64 = group.iter().map(|&i| facets[i as usize].area).sum();
    let outline = hull(&points, area * FILLED);
    let hull_area: f64 = (0..outline.len())
        .map(|k| 0.5 * place(&outline[k]).perp_dot(place(&outline[(k + 1) % outline.len()])))
        .sum();
    let filled = (hull_area - area).abs() <= FILLED * area;
    let turns = |k: usize| {
        let [before, at, after] =
            [k + outline.len() - 1, k, k + 1].map(|k| place(&outline[k % outline.len()]));
        (at - before).perp_dot(after - at) > area * FILLED
    };
    let starts: Vec<u32> = (0..outline.len()).filter(|&k| turns(k)).map(|k| k as u32).collect();
    let corners: Vec<[u32; 2]> = starts.iter().map(|&k| outline[k as usize]).collect();
    (filled && corners.len() >= 3).then(|| Polygon {
        triangles: group.to_vec(),
        corners,
        outline,
        starts,
        solid: None,
    })
}

/// The convex hull of points in lexicographic order, counter-clockwise, with the points on its sides: those whose triangle with
/// their neighbours has an area of at least `-slack` (A. Andrew, *Information Processing Letters* 9, 1979).
fn hull(points: &[(DVec2, [u32; 2])], slack: f64) -> Vec<[u32; 2]> {
    let mut hull = Vec::new();
    let chains: [Vec<usize>; 2] = [(0..points.len()).collect(), (0..points.len()).rev().collect()];
    for chain in chains {
        let mut side: Vec<usize> = Vec::new();
        for k in chain {
            let bends_inwards = |side: &[usize]| {
                let [.., a, b] = side else { return false };
                let [a, b, c] = [*a, *b, k].map(|k| points[k].0);
                (b - a).perp_dot(c - b) < -slack
            };
            while bends_inwards(&side) {
                side.pop();
            }
            side.push(k);
        }
        side.pop();
        hull.extend(side);
    }
    // Points on a side that both chains pass are listed once.
    let mut seen = Vec::new();
    hull.retain(|k| {
        !seen.contains(k) && {
            seen.push(*k);
            true
        }
    });
    hull.into_iter().map(|k| points[k].1).collect()
}
