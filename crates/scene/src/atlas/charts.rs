//! Charts: parts of a surface that one direction sees whole, each laid out in the plane across it.

use std::collections::VecDeque;

use glam::{DVec2, DVec3};

use crate::{Edges, Scene, Welded, bounds};

/// Least cosine between the normal of a triangle and the direction that sees its chart: its area in the chart by that on the surface.
pub(super) const FACING: f64 = 0.6;
/// Corners closer than this share of the surface's size are one, and triangles that overlap by less do not.
const TOUCH: f64 = 1e-5;
/// Directions in which a chart may lie, over a right angle.
const TURNS: u32 = 45;

/// A part of a surface in a plane, in metres, within the rectangle from the origin to `size`.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    /// Indices into the list of triangles, and their corners.
    pub triangles: Vec<(usize, [DVec2; 3])>,
    pub size: DVec2,
}

/// Cuts triangles of a scene into charts, large ones first. Those without area are in none.
///
/// A chart grows from the largest triangle that is left over neighbours which face the same way, twice: the second time along the mean
/// normal of the first. What would lie over another part of it is left to the next charts.
pub(super) fn charts(scene: &Scene, triangles: &[u32]) -> Vec<Chart> {
    let corners: Vec<[DVec3; 3]> = triangles.iter().map(|&t| scene.corners(t as usize)).collect();
    let areas: Vec<DVec3> = triangles.iter().map(|&t| scene.area_vector(t as usize)).collect();
    let (low, high) = bounds(corners.iter().flatten().copied());
    let touch = ((high - low).length() * TOUCH).max(f64::MIN_POSITIVE);
    let neighbours = neighbours(&corners, touch);

    let mut left: Vec<bool> = areas.iter().map(|area| area.normalize_or_zero() != DVec3::ZERO).collect();
    let mut seeds: Vec<usize> = (0..triangles.len()).filter(|&k| left[k]).collect();
    seeds.sort_by(|&a, &b| areas[b].length().total_cmp(&areas[a].length()));
    let mut charts = Vec::new();
    for seed in seeds {
        if !left[seed] {
            continue;
        }
        let faces = |k: usize, axis: DVec3| areas[k].normalize_or_zero().dot(axis) >= FACING;
        let grown = |axis: DVec3| grow(seed, &neighbours, |k| left[k] && faces(k, axis));
        let first = areas[seed].normalize_or_zero();
        let mean = grown(first).into_iter().map(|k| areas[k]).sum::<DVec3>().normalize_or_zero();
        let axis = if faces(seed, mean) { mean } else { first };
        let members = grown(axis);
        let flat: Vec<[DVec2; 3]> = members.iter().map(|&k| project(corners[k], axis)).collect();
        let covered = covered(&flat, touch);
        let kept: Vec<(usize, [DVec2; 3])> = members
            .into_iter()
            .zip(flat)
            .zip(covered)
            .filter(|(_, covered)| !covered)
            .map(|(of, _)| of)
            .collect();
        kept.iter().for_each(|&(k, _)| left[k] = false);
        charts.push(laid_out(kept));
    }
    charts
}

/// Per triangle, those that share an edge with it.
fn neighbours(corners: &[[DVec3; 3]], touch: f64) -> Vec<Vec<usize>> {
    let welded = Welded::within(touch, corners.iter().flatten().copied());
    let of = |k: usize| [0, 1, 2].map(|corner| welded.position[3 * k + corner]);
    let mut around = vec![Vec::new(); corners.len()];
    for edge in Edges::of((0..corners.len()).map(of)).iter() {
        for a in edge.triangles() {
            around[a as usize].extend(edge.triangles().filter(|&b| b != a).map(|b| b as usize));
        }
    }
    around
}

/// A triangle and all that can be reached from it over neighbours that may join, the nearest ones first.
fn grow(seed: usize, neighbours: &[Vec<usize>], may_join: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut reached = std::collections::HashSet::from([seed]);
    let (mut members, mut rim) = (Vec::new(), VecDeque::from([seed]));
    while let Some(k) = rim.pop_front() {
        members.push(k);
        rim.extend(neighbours[k].iter().copied().filter(|&next| may_join(next) && reached.insert(next)));
    }
    members
}

/// Corners as seen against an axis: the first coordinate to the right, the second one down.
fn project(corners: [DVec3; 3], axis: DVec3) -> [DVec2; 3] {
    let across = DVec3::AXES.into_iter().min_by(|a, b| a.dot(axis).abs().total_cmp(&b.dot(axis).abs()));
    let right = across.unwrap_or(DVec3::X).reject_from_normalized(axis).normalize_or_zero();
    let down = right.cross(axis);
    corners.map(|corner| DVec2::new(corner.dot(right), corner.dot(down)))
}

/// Which triangles overlap one that comes before them.
fn covered(triangles: &[[DVec2; 3]], touch: f64) -> Vec<bool> {
    let low = |k: usize| triangles[k].into_iter().fold(DVec2::INFINITY, DVec2::min);
    let high = |k: usize| triangles[k].into_iter().fold(DVec2::NEG_INFINITY, DVec2::max);
    let boxes: Vec<[DVec2; 2]> = (0..triangles.len()).map(|k| [low(k), high(k)]).collect();
    let mut order: Vec<usize> = (0..triangles.len()).collect();
    order.sort_by(|&a, &b| boxes[a][0].x.total_cmp(&boxes[b][0].x));
    let mut covered = vec![false; triangles.len()];
    let mut open: Vec<usize> = Vec::new();
    for k in order {
        let [low, high] = boxes[k];
        open.retain(|&other| boxes[other][1].x > low.x + touch);
        for &other in &open {
            let meet = boxes[other][0].y < high.y - touch && boxes[other][1].y > low.y + touch;
            if meet && !covered[k] && !covered[other] && overlap(&triangles[k], &triangles[other], touch) {
                covered[k.max(other)] = true;
            }
        }
        open.push(k);
    }
    covered
}

/// Whether two convex polygons overlap by more than a distance: no side of either keeps them apart.
pub(super) fn overlap(a: &[DVec2], b: &[DVec2], by: f64) -> bool {
    let apart = |normal: DVec2| {
        let span = |polygon: &[DVec2]| {
            let along = polygon.iter().map(|p| p.dot(normal));
            along.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
        };
        let [a, b] = [span(a), span(b)];
        a[1] <= b[0] + by || b[1] <= a[0] + by
    };
    let keeps_apart = |polygon: &[DVec2]| {
        let next = polygon.iter().cycle().skip(1);
        polygon.iter().zip(next).any(|(p, q)| apart((q - p).perp().normalize_or_zero()))
    };
    !keeps_apart(a) && !keeps_apart(b)
}

/// A chart of triangles in a plane, turned so that it takes a small rectangle, wider than high.
fn laid_out(triangles: Vec<(usize, [DVec2; 3])>) -> Chart {
    let bounds = |turn: DVec2| {
        let points = triangles.iter().flat_map(|(_, corners)| corners).map(|p| p.rotate(turn));
        points.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
    };
    let area = |turn: DVec2| {
        let (low, high) = bounds(turn);
        (high - low).element_product()
    };
    let turns =
        (0..TURNS).map(|k| DVec2::from_angle(f64::from(k) * std::f64::consts::FRAC_PI_2 / f64::from(TURNS)));
    let best = turns
        .map(|turn| (area(turn), turn))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(DVec2::X, |best| best.1);
    let (low, high) = bounds(best);
    let turn = if (high - low).x < (high - low).y { best.perp() } else { best };
    let (low, high) = bounds(turn);
    let place = |(k, corners): (usize, [DVec2; 3])| (k, corners.map(|p| p.rotate(turn) - low));
    Chart { triangles: triangles.into_iter().map(place).collect(), size: high - low }
}
