//! Which emitters are lamps: planar convex polygons, merged from triangles, few enough to be listed.

use crate::model::Facet;
use crate::scene::{Scene, Welded, sides};
use glam::DVec2;
use std::collections::{BTreeSet, HashMap};

/// Sine of the largest angle between normals of one plane.
const PARALLEL: f64 = 1e-6;
/// Relative difference of areas up to which a convex hull is the union of its triangles.
const FILLED: f64 = 1e-9;

/// A planar convex emitter: one triangle, or several of one material in one plane.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lamp {
    /// Its triangles.
    pub triangles: Vec<u32>,
    /// Its corners, counter-clockwise seen from the lit side, each as a triangle and a corner of it.
    pub corners: Vec<[u32; 2]>,
    /// Its corners, and the vertices of triangles between them, in order.
    pub outline: Vec<[u32; 2]>,
}

impl Lamp {
    /// A lamp of one triangle.
    pub fn single(triangle: u32) -> Self {
        let corners = vec![[triangle, 0], [triangle, 1], [triangle, 2]];
        Self { triangles: vec![triangle], outline: corners.clone(), corners }
    }

    /// The first of its triangles, which has its plane and its emission.
    pub fn first(&self) -> usize {
        self.triangles[0] as usize
    }
}

/// The lamps of a scene: its emitters, in the order of their first triangles. `facets`: its triangles, in any unit of length;
/// `tolerance`: height in that unit up to which a corner is in a plane.
pub fn lamps(scene: &Scene, facets: &[Facet], tolerance: f64) -> Vec<Lamp> {
    let emits = |&i: &u32| {
        facets[i as usize].area > 0.0 && scene.material(i as usize).emission.iter().any(|&l| l != 0.0)
    };
    let emitters: Vec<u32> = (0..facets.len() as u32).filter(emits).collect();
    let mut lamps: Vec<Lamp> = Vec::new();
    for group in connected(scene, facets, &emitters, tolerance) {
        match merged(facets, &group) {
            Some(lamp) => lamps.push(lamp),
            None => lamps.extend(group.into_iter().map(Lamp::single)),
        }
    }
    lamps.sort_by_key(Lamp::first);
    lamps
}

/// Groups of triangles that share edges, plane and material; each in ascending order.
fn connected(scene: &Scene, facets: &[Facet], emitters: &[u32], tolerance: f64) -> Vec<Vec<u32>> {
    let welded = Welded::exactly(scene.vertices.iter().copied());
    let mut with_side: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
    let sides_of = |i: u32| sides(welded.positions(scene.triangles[i as usize].vertices));
    for &i in emitters {
        sides_of(i).into_iter().for_each(|side| with_side.entry(side).or_default().push(i));
    }
    let same = |i: u32, j: u32| {
        let (a, b) = (&facets[i as usize], &facets[j as usize]);
        let in_plane = b.corners.iter().all(|c| (*c - a.centroid).dot(a.normal).abs() <= tolerance);
        let material = |i: u32| scene.triangles[i as usize].material;
        a.normal.dot(b.normal) > 0.0
            && a.normal.cross(b.normal).length() <= PARALLEL
            && in_plane
            && material(i) == material(j)
    };
    let mut grouped = BTreeSet::new();
    let mut groups = Vec::new();
    for &start in emitters {
        if grouped.contains(&start) {
            continue;
        }
        grouped.insert(start);
        let mut group = vec![start];
        let mut done = 0;
        while let Some(&i) = group.get(done) {
            done += 1;
            for [a, b] in sides_of(i) {
                for &j in with_side.get(&[b, a]).into_iter().flatten() {
                    if !grouped.contains(&j) && same(start, j) {
                        grouped.insert(j);
                        group.push(j);
                    }
                }
            }
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

/// The convex hull of coplanar triangles, if they fill it.
fn merged(facets: &[Facet], group: &[u32]) -> Option<Lamp> {
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
    let corners: Vec<[u32; 2]> = (0..outline.len()).filter(|&k| turns(k)).map(|k| outline[k]).collect();
    (filled && corners.len() >= 3).then(|| Lamp { triangles: group.to_vec(), corners, outline })
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
