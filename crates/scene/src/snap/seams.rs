//! Gaps: open edges of a mesh that run along each other, and points there that belong together.

use super::super::Edges;
use super::{NONE, Surface};
use antirad_base::parallel;
use antirad_rays::Boxes;
use glam::DVec3;

/// In distances: how far the ends of two edges may be apart that belong together, no farther than the edges are long.
const GAP: f64 = 1.5;
/// In distances: how far the points of a joint may be apart.
const WIDEST: f64 = 3.0;
/// Open points without a partner edge belong together within a distance, and within this share of the edges around them.
const OF_EDGE: f64 = 0.5;

/// An edge of a single triangle, in the direction in which that runs along it.
struct Open {
    ends: [u32; 2],
    places: [DVec3; 2],
    reach: f64,
}

impl Open {
    fn middle(&self) -> DVec3 {
        self.places[0].midpoint(self.places[1])
    }

    /// How far apart two edges are, as the sum of the squares of their ends' distances, and which ends belong together. Edges of sheets
    /// that agree about the front run opposite ways.
    fn apart(&self, other: &Self) -> Option<(f64, [[u32; 2]; 2])> {
        let reach = self.reach.min(other.reach);
        [[1, 0], [0, 1]].into_iter().find_map(|[first, second]| {
            let squares = [(0, first), (1, second)]
                .map(|(own, their)| self.places[own as usize].distance_squared(other.places[their]));
            squares.iter().all(|s| *s <= reach * reach).then(|| {
                let ends = [[self.ends[0], other.ends[first]], [self.ends[1], other.ends[second]]];
                (squares[0] + squares[1], ends)
            })
        })
    }
}

/// Per point, the joint that it belongs to; joints are numbered in the order of their first points.
pub(super) fn joined(surface: &Surface) -> Vec<u32> {
    let mut open: Vec<Open> = Edges::of(surface.triangles.iter().copied())
        .iter()
        .filter(|edge| edge.len() == 1)
        .flat_map(|edge| edge.directed().collect::<Vec<_>>())
        .map(|(_, ends)| {
            let places = ends.map(|p| surface.points[p as usize]);
            let reach = (GAP * surface.distance).min(places[0].distance(places[1]));
            Open { ends, places, reach }
        })
        .collect();
    let mut joints = Union::new(surface);
    let mut pairs = pairs(&open);
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut taken = vec![false; open.len()];
    for (_, [one, other], ends) in pairs {
        let free = !taken[one as usize] && !taken[other as usize];
        if free && ends.iter().all(|&[a, b]| joints.may_join(a, b)) {
            ends.iter().for_each(|&[a, b]| joints.join(a, b));
            taken[one as usize] = true;
            taken[other as usize] = true;
        }
    }
    let mut taken = taken.into_iter();
    open.retain(|_| !taken.next().unwrap_or(false));
    join_points(surface, &open, &mut joints);
    joints.numbered()
}

/// Pairs of edges within reach: how far they are apart, their places in the list, and which of their ends belong together.
fn pairs(open: &[Open]) -> Vec<(f64, [u32; 2], [[u32; 2]; 2])> {
    let near = within(open.iter().map(|edge| (edge.middle(), edge.reach)));
    let of_edge = |one: u32| {
        let edge = &open[one as usize];
        let mut found = Vec::new();
        near.meet(&[edge.middle()], |other| {
            if other != one {
                let pair = [one.min(other), one.max(other)];
                let [first, second] = pair.map(|k| &open[k as usize]);
                found.extend(first.apart(second).map(|(apart, ends)| (apart, pair, ends)));
            }
            true
        });
        found
    };
    let mut all = parallel::flat_map(0..open.len() as u32, of_edge);
    all.sort_by_key(|(_, pair, _)| *pair);
    all.dedup_by_key(|(_, pair, _)| *pair);
    all
}

/// Places with a reach each, found from any place within it.
fn within(places: impl Iterator<Item = (DVec3, f64)>) -> Boxes {
    Boxes::around(&places.map(|(place, reach)| [place - reach, place + reach]).collect::<Vec<_>>())
}

/// Joins open points that are nearest to each other.
fn join_points(surface: &Surface, open: &[Open], joints: &mut Union) {
    let mut reach = vec![f64::INFINITY; surface.points.len()];
    for edge in open {
        let length = OF_EDGE * edge.places[0].distance(edge.places[1]);
        edge.ends.iter().for_each(|&p| reach[p as usize] = reach[p as usize].min(length));
    }
    let points: Vec<u32> =
        (0..surface.points.len() as u32).filter(|&p| reach[p as usize].is_finite()).collect();
    let place = |k: u32| surface.points[points[k as usize] as usize];
    let reach_of = |k: u32| reach[points[k as usize] as usize].min(surface.distance);
    let near = within((0..points.len() as u32).map(|k| (place(k), reach_of(k))));
    let nearest = |k: u32| {
        let mut best = (f64::INFINITY, NONE);
        near.meet(&[place(k)], |other| {
            let apart = place(k).distance(place(other));
            if other != k && apart <= reach_of(k).min(reach_of(other)) && (apart, other) < best {
                best = (apart, other);
            }
            true
        });
        best.1
    };
    let nearest: Vec<u32> = parallel::map(0..points.len() as u32, nearest);
    for (k, &other) in (0..).zip(&nearest) {
        if other != NONE && k < other && nearest[other as usize] == k {
            let [a, b] = [k, other].map(|k| points[k as usize]);
            if joints.may_join(a, b) {
                joints.join(a, b);
            }
        }
    }
}

/// Sets of points that belong together. No two corners of a triangle do.
struct Union<'a> {
    surface: &'a Surface,
    around: super::super::Fans,
    /// Per point, the first point of its set.
    first: Vec<u32>,
    /// Per first point, all points of the set.
    members: Vec<Vec<u32>>,
}

impl<'a> Union<'a> {
    fn new(surface: &'a Surface) -> Self {
        let count = surface.points.len();
        Self {
            surface,
            around: super::super::Fans::of(count, surface.triangles.iter().copied()),
            first: (0..count as u32).collect(),
            members: (0..count as u32).map(|p| vec![p]).collect(),
        }
    }

    fn members(&self, point: u32) -> &[u32] {
        &self.members[self.first[point as usize] as usize]
    }

    fn may_join(&self, a: u32, b: u32) -> bool {
        let set = self.first[b as usize];
        if self.first[a as usize] == set {
            return true;
        }
        let place = |p: u32| self.surface.points[p as usize];
        self.members(a).iter().all(|&own| {
            let mut corners =
                self.around.around(own).iter().flat_map(|&t| self.surface.triangles[t as usize]);
            !corners.any(|p| self.first[p as usize] == set)
                && self
                    .members(b)
                    .iter()
                    .all(|&their| place(own).distance(place(their)) <= WIDEST * self.surface.distance)
        })
    }

    fn join(&mut self, a: u32, b: u32) {
        let [a, b] = [a, b].map(|p| self.first[p as usize]);
        if a != b {
            let moved = std::mem::take(&mut self.members[a.max(b) as usize]);
            moved.iter().for_each(|&p| self.first[p as usize] = a.min(b));
            self.members[a.min(b) as usize].extend(moved);
        }
    }

    fn numbered(self) -> Vec<u32> {
        let mut number = vec![NONE; self.first.len()];
        let mut next = 0;
        let number_of = |&first: &u32| {
            let own = &mut number[first as usize];
            if *own == NONE {
                *own = next;
                next += 1;
            }
            *own
        };
        self.first.iter().map(number_of).collect()
    }
}
