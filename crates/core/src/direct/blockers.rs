//! What may stand between a point and a lamp: triangles with others before and behind them, from both sides, those in one plane as convex
//! polygons. Suns are beyond everything, so that they are blocked by outermost triangles, too.

use super::lamps::Lamp;
use super::polygon::{Polygon, connected, farthest, in_plane, mean, merged};
use super::shaft::Shaft;
use super::visible::{Geometry, Placed};
use crate::model::{Facet, Hierarchy, coplanar_tolerance, spatial_order};
use antirad_base::parallel;
use antirad_scene::{Welded, bounds};
use glam::DVec3;
use std::borrow::Cow;

/// Triangles per leaf of the search.
pub const LEAF: usize = 4;
/// Sine of the largest angle between normals of a polygon, and its largest height over its plane as a fraction of the height up to which
/// points count as in a plane: little more than rounding, since shadows count as exact.
const PARALLEL: f64 = 1e-9;
const FLAT: f64 = 1e-3;
/// How far triangles may reach over a line between them, as a fraction of the width of all.
const CROSSES: f64 = 1e-9;
/// Corners of a polygon at most. A disc of more sides is cut into several.
pub const CORNERS: usize = 24;
/// Vertices on the outline of a polygon at most: numbers of planes have room for so many.
pub const OUTLINE: usize = 990;

/// Number in place of the polygon across an edge, where there is none.
pub const NO_TWIN: u32 = u32::MAX;

/// Polygons that block light, and a tree over them.
#[derive(Clone, Debug)]
pub struct Blockers {
    /// The polygons of the tree; behind them, the triangles of those that consist of several, each a polygon of its own.
    polygons: Vec<Polygon>,
    /// Their areas and centroids.
    moments: Vec<(f64, DVec3)>,
    /// Index in `polygons` at which the triangles of each polygon of the tree begin.
    triangles: Vec<u32>,
    /// The polygon of each triangle of the tree: polygons are cut into fans.
    fans: Vec<u32>,
    order: Vec<u32>,
    tree: Hierarchy,
    /// Across each edge of each polygon of the tree, the polygon that shares it, or [`NO_TWIN`]; where those of each polygon begin.
    twins: Vec<u32>,
    first_twins: Vec<u32>,
    /// Height up to which a point counts as in a plane.
    tolerance: f64,
    /// A distance from any triangle beyond which there is none.
    far: f64,
}

impl Blockers {
    /// What may block lamps: nothing where there are none.
    pub fn of(facets: &[Facet], lamps: &[Lamp]) -> Self {
        match lamps.iter().find_map(Lamp::sun) {
            _ if lamps.is_empty() => Self::new(&[]),
            None => Self::new(facets),
            Some(disc) => {
                // Walls of a room stand between suns and what is in it.
                let blocks = |i: &u32| facets[*i as usize].area > 0.0 && !disc.is_before(*i);
                Self::among(facets, (0..facets.len() as u32).filter(blocks).collect())
            }
        }
    }

    /// Whether anything may block lamps.
    pub fn exist(facets: &[Facet], lamps: &[Lamp]) -> bool {
        match lamps.iter().find_map(Lamp::sun) {
            _ if lamps.is_empty() => false,
            None => !in_between(facets, coplanar_tolerance(facets)).is_empty(),
            Some(disc) => (0..facets.len()).any(|i| facets[i].area > 0.0 && !disc.is_before(i as u32)),
        }
    }

    /// Nothing that blocks, in a scene of some triangles.
    pub fn none(facets: &[Facet]) -> Self {
        Self { tolerance: coplanar_tolerance(facets), far: beyond(facets), ..Self::new(&[]) }
    }

    /// What may block lamps within a scene.
    pub fn new(facets: &[Facet]) -> Self {
        Self::among(facets, in_between(facets, coplanar_tolerance(facets)))
    }

    /// What some triangles block, by their numbers.
    fn among(facets: &[Facet], solid: Vec<u32>) -> Self {
        let tolerance = coplanar_tolerance(facets);
        let same = |i, j| in_plane(facets, [i, j], PARALLEL, FLAT * tolerance);
        let mut polygons: Vec<Polygon> = Vec::new();
        connected(facets, &solid, FLAT * tolerance, same)
            .into_iter()
            .for_each(|group| cut_into_convex(facets, group, &mut polygons));

        let (fans, fan_facets): (Vec<u32>, Vec<Facet>) = cut_into_fans(facets, &polygons).unzip();
        let mut singles = Vec::new();
        let mut triangles = Vec::with_capacity(polygons.len());
        for polygon in &polygons {
            triangles.push((polygons.len() + singles.len()) as u32);
            if polygon.triangles.len() > 1 {
                singles.extend(polygon.triangles.iter().map(|&i| Polygon::single(i)));
            }
        }
        let (twins, first_twins) = twins(facets, &polygons);
        polygons.append(&mut singles);
        let moments = polygons.iter().map(|polygon| moments(facets, polygon)).collect();
        let order = spatial_order(&fan_facets);
        let tree = Hierarchy::new(&fan_facets, &order, LEAF, tolerance);
        let far = beyond(facets);
        Self { polygons, moments, triangles, fans, order, tree, twins, first_twins, tolerance, far }
    }

    /// A distance from any triangle beyond which there is none.
    pub fn far(&self) -> f64 {
        self.far
    }

    /// Height up to which a point counts as in a plane.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// The polygons of the tree, which hold each triangle once.
    #[cfg(test)]
    pub fn all(&self) -> impl Iterator<Item = &Polygon> {
        self.polygons[..self.count()].iter()
    }

    /// The tree, of leaves of at most [`LEAF`] triangles, and the triangles in its order.
    pub fn tree(&self, facets: &[Facet]) -> (&Hierarchy, Vec<Facet>) {
        let fans: Vec<Facet> =
            cut_into_fans(facets, &self.polygons[..self.count()]).map(|(_, fan)| fan).collect();
        (&self.tree, self.order.iter().map(|&fan| fans[fan as usize]).collect())
    }

    /// How many polygons block light.
    pub fn count(&self) -> usize {
        self.triangles.len()
    }

    /// How many numbers polygons have.
    pub fn numbers(&self) -> usize {
        self.polygons.len()
    }

    /// Across each edge of a polygon, the polygon with the same edge in the opposite direction, if there is one and it is listed as a
    /// whole. Empty for triangles of polygons that consist of several.
    pub fn twins(&self, number: u32) -> &[u32] {
        let bounds = self.first_twins.get(number as usize).zip(self.first_twins.get(number as usize + 1));
        bounds.map_or(&[], |(&from, &to)| &self.twins[from as usize..to as usize])
    }

    /// A polygon that [`Self::between`] has listed.
    pub fn polygon(&self, number: u32) -> &Polygon {
        &self.polygons[number as usize]
    }

    /// Area of a polygon that [`Self::between`] has listed.
    pub fn area(&self, number: u32) -> f64 {
        self.moments[number as usize].0
    }

    /// The polygons that may stand between some points of a plane and a lamp, the widest first; none that consists of several triangles
    /// crosses the plane of the lamp. `points[0]` and `normal` give the plane of the points. `None` if there are more than `most`, which
    /// is found out long before all are known.
    pub fn between(
        &self,
        geometry: &Geometry,
        points: &[DVec3],
        normal: DVec3,
        lamp: &Placed,
        most: Option<usize>,
    ) -> Option<Vec<u32>> {
        let own = |p: u32| {
            let triangles = lamp.lamp.solid().map_or(&[][..], |solid| solid.triangles());
            triangles.binary_search(&self.polygon(p).triangles[0]).is_ok()
        };
        let centre = mean(points);
        // A sun goes along with each point.
        let lamp_corners: Cow<[DVec3]> = match lamp.lamp.sun() {
            Some(_) => {
                points.iter().flat_map(|point| geometry.seen_from(lamp, *point).corners.clone()).collect()
            }
            None => Cow::Borrowed(&lamp.corners),
        };
        let has_plane = lamp.plane.is_some() && lamp.lamp.solid().is_none();
        // Silhouettes have planes of their own, behind the corner that is nearest; so have suns.
        let (lamp_corner, lamp_normal) = match has_plane {
            true => (lamp.corners[0], lamp.normal),
            false => {
                let to_points = (centre - mean(&lamp_corners)).normalize_or_zero();
                (lamp_corners[farthest(&lamp_corners, to_points)], to_points)
            }
        };
        let plane = has_plane.then_some(lamp.normal);
        let shaft = Shaft::new(points, normal, &lamp_corners, plane, self.tolerance);
        let misses = |p: &u32| own(*p) || shaft.misses(geometry.corners(self.polygon(*p)));
        let under_lamp =
            |p: &Polygon| geometry.corners(p).any(|c| (c - lamp_corner).dot(lamp_normal) < -self.tolerance);
        let in_parts = |p: &u32| self.polygon(*p).triangles.len() > 1 && under_lamp(self.polygon(*p));
        let mut met = Vec::new();
        let mut counted = Vec::new();
        for leaf in self.tree.leaves(|node| !shaft.misses_box(&node.bounds)) {
            let polygons = leaf.slots(LEAF, &self.order).iter().map(|&fan| self.fans[fan as usize]);
            met.extend(polygons.clone());
            if let Some(most) = most {
                for p in polygons {
                    if !counted.contains(&p) && !misses(&p) && !in_parts(&p) {
                        counted.push(p);
                    }
                }
                if counted.len() > most {
                    return None;
                }
            }
        }
        met.sort_unstable();
        met.dedup();
        let width = |p: u32| {
            let (area, centroid) = self.moments[p as usize];
            area / (centroid - centre).length_squared().max(f64::MIN_POSITIVE)
        };
        let mut found: Vec<(f64, u32)> = Vec::with_capacity(met.len());
        for p in met.into_iter().filter(|p| !misses(p)) {
            if in_parts(&p) {
                let first = self.triangles[p as usize];
                let singles = first..first + self.polygon(p).triangles.len() as u32;
                found.extend(singles.filter(|single| !misses(single)).map(|single| (width(single), single)));
            } else {
                found.push((width(p), p));
            }
        }
        // A wide blocker that comes first leaves less to cut.
        found.sort_by(|(a, i), (b, j)| b.total_cmp(a).then(i.cmp(j)));
        most.is_none_or(|most| found.len() <= most).then(|| found.into_iter().map(|(_, p)| p).collect())
    }
}

/// A distance from any triangle beyond which there is none.
fn beyond(facets: &[Facet]) -> f64 {
    let (low, high) = bounds(facets.iter().flat_map(|facet| facet.corners));
    if facets.is_empty() { 1.0 } else { 2.0 * (high - low).length() }
}

/// The triangles with some of the scene on either side of their planes. Others stand between no two points of it: walls of a room, say.
fn in_between(facets: &[Facet], tolerance: f64) -> Vec<u32> {
    let order = spatial_order(facets);
    let tree = Hierarchy::new(facets, &order, LEAF, tolerance);
    let any_below = |origin: DVec3, normal: DVec3| {
        let level = origin.dot(normal) - tolerance;
        let mut found = false;
        tree.walk(|_, node| {
            if found || node.bounds.lowest(normal) >= level {
                return false;
            }
            let below = |i: &u32| facets[*i as usize].corners.iter().any(|c| c.dot(normal) < level);
            // The whole box is below, or some triangle of a leaf.
            found = -node.bounds.lowest(-normal) < level
                || node.is_leaf() && node.slots(LEAF, &order).iter().any(below);
            true
        });
        found
    };
    let between = |i: &u32| {
        let Facet { area, corners: [origin, ..], normal, .. } = facets[*i as usize];
        area > 0.0 && any_below(origin, normal) && any_below(origin, -normal)
    };
    parallel::filter(0..facets.len() as u32, between)
}

/// Across each edge of some polygons, the other that has the same edge in the opposite direction; where those of each polygon begin.
/// Where several have it, as those of a sheet with two sides do, the one that continues the surface best, if it agrees.
fn twins(facets: &[Facet], polygons: &[Polygon]) -> (Vec<u32>, Vec<u32>) {
    let mut firsts = vec![0];
    let corners = polygons.iter().flat_map(|polygon| &polygon.corners);
    let welded = Welded::exactly(corners.map(|&[i, k]| facets[i as usize].corners[k as usize]));
    let mut edges: Vec<([u32; 2], u32)> = Vec::new();
    let mut owners = Vec::new();
    for (p, polygon) in (0..).zip(polygons) {
        let (first, count) = (owners.len() as u32, polygon.corners.len() as u32);
        let side =
            |k: u32| [first + k, first + (k + 1) % count].map(|corner| welded.position[corner as usize]);
        edges.extend((0..count).map(|k| (side(k), first + k)));
        owners.resize(owners.len() + count as usize, p);
        firsts.push(owners.len() as u32);
    }
    let mut sorted = edges.clone();
    sorted.sort_unstable();
    let normal = |edge: u32| facets[polygons[owners[edge as usize] as usize].first()].normal;
    let best = |&([a, b], edge): &([u32; 2], u32)| {
        let from = sorted.partition_point(|(side, _)| *side < [b, a]);
        let others = sorted[from..].iter().take_while(|(side, _)| *side == [b, a]).map(|(_, other)| *other);
        let along = |other: &u32| normal(edge).dot(normal(*other));
        others.max_by(|i, j| along(i).total_cmp(&along(j)).then(j.cmp(i)))
    };
    let best: Vec<Option<u32>> = edges.iter().map(best).collect();
    let agreed = |edge: usize| best[edge].filter(|&other| best[other as usize] == Some(edge as u32));
    let twins = (0..edges.len()).map(|edge| agreed(edge).map_or(NO_TWIN, |other| owners[other as usize]));
    (twins.collect(), firsts)
}

/// The triangles of the fans into which polygons are cut, each with the number of its polygon.
fn cut_into_fans(facets: &[Facet], polygons: &[Polygon]) -> impl Iterator<Item = (u32, Facet)> {
    let corner = |[i, k]: [u32; 2]| facets[i as usize].corners[k as usize];
    let fan = move |(p, polygon): (u32, &Polygon)| {
        let corners: Vec<DVec3> = polygon.corners.iter().map(|&c| corner(c)).collect();
        (2..corners.len()).map(move |k| (p, Facet::new([corners[0], corners[k - 1], corners[k]])))
    };
    (0..).zip(polygons).flat_map(fan)
}

/// Area and centroid.
fn moments(facets: &[Facet], polygon: &Polygon) -> (f64, DVec3) {
    let of = |&i: &u32| (facets[i as usize].area, facets[i as usize].centroid);
    let sum = |(sum, moment), (area, at)| (sum + area, moment + area * at);
    let (area, moment) = polygon.triangles.iter().map(of).fold((0.0, DVec3::ZERO), sum);
    (area, moment / area)
}

/// Splits some triangles of one plane into two sets, on either side of a line along an edge of the first
/// triangle. The line crosses none of them if such a line exists, and is as near to their median as can be.
fn halves(facets: &[Facet], group: Vec<u32>) -> (Vec<u32>, Vec<u32>) {
    let Facet { corners, normal, .. } = facets[group[0] as usize];
    let edges = [0, 1, 2].map(|k| corners[(k + 1) % 3] - corners[k]);
    let across = edges.map(|edge| normal.cross(edge).normalize_or_zero());
    let extent = |i: u32, axis: DVec3| {
        let along = facets[i as usize].corners.map(|c| c.dot(axis));
        [along.iter().copied().fold(f64::MAX, f64::min), along.iter().copied().fold(f64::MIN, f64::max)]
    };
    let middle = group.len() / 2;
    let cut = |axis: DVec3| {
        let mut sorted: Vec<([f64; 2], u32)> = group.iter().map(|&i| (extent(i, axis), i)).collect();
        sorted.sort_by(|(a, i), (b, j)| (a[0] + a[1]).total_cmp(&(b[0] + b[1])).then(i.cmp(j)));
        let slack = CROSSES * (sorted[sorted.len() - 1].0[1] - sorted[0].0[0]);
        // The lowest end of all triangles from each place on.
        let mut lowest = vec![f64::MAX; sorted.len() + 1];
        (0..sorted.len()).rev().for_each(|k| lowest[k] = lowest[k + 1].min(sorted[k].0[0]));
        let mut highest = f64::MIN;
        let free = (1..sorted.len()).filter(|&k| {
            highest = highest.max(sorted[k - 1].0[1]);
            highest <= lowest[k] + slack
        });
        let at = free.min_by_key(|k| k.abs_diff(middle));
        let high = sorted.split_off(at.unwrap_or(middle));
        let numbers = |part: Vec<([f64; 2], u32)>| part.into_iter().map(|(_, i)| i).collect();
        (at.map_or(usize::MAX, |at| at.abs_diff(middle)), (numbers(sorted), numbers(high)))
    };
    let [a, b, c] = across.map(cut);
    let best = [b, c].into_iter().fold(a, |best, other| if other.0 < best.0 { other } else { best });
    best.1
}

/// Appends the convex polygons that some triangles of one plane form: all of them one, or else those of its [`halves`].
fn cut_into_convex(facets: &[Facet], group: Vec<u32>, polygons: &mut Vec<Polygon>) {
    if let [triangle] = group[..] {
        polygons.push(Polygon::single(triangle));
        return;
    }
    let fits = |polygon: &Polygon| polygon.corners.len() <= CORNERS && polygon.outline.len() <= OUTLINE;
    if let Some(polygon) = merged(facets, &group).filter(fits) {
        polygons.push(polygon);
        return;
    }
    let (mut low, mut high) = halves(facets, group);
    low.sort_unstable();
    high.sort_unstable();
    cut_into_convex(facets, low, polygons);
    cut_into_convex(facets, high, polygons);
}
