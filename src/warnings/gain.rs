//! How far light that a blocker holds back may miss where it should be taken away.
//!
//! What arrives at a blocker from one direction is spread over the bins around it, and leaves its back over their whole
//! solid angle s_b. A receiver at distance d that sees the blocker under a/d² is to lose what arrived exactly along the
//! line between the two; if a/d² is well below s_b, many blockers share what is spread and the sum is right. Else one
//! blocker takes away up to a/(d² s_b) times what it should from the receivers in one direction, and nothing from
//! others. That factor is the gain here, with the pieces of the near field in place of the whole blocker.

use super::distance::between;
use crate::model::{Block, Facet, QUARTER_RANGE, coplanar_tolerance, far_weight, morton, reaches};
use crate::plan::{PADDING, PAIR_BACK, Plan};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::f64::consts::PI;

/// Strongest gains that are remembered per receiver.
const STRONGEST: usize = 4;

/// Of each receiver its strongest gains.
type Strongest = Vec<Vec<Gain>>;

/// Gain from the back of a blocker to the front of a receiver. Index = triangle of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    pub blocker: u32,
    pub receiver: u32,
    pub gain: f64,
}

/// What pairs of a blocker and a receiver behind it say, summed up by either.
#[derive(Clone, Debug, Default)]
pub struct Gains {
    /// Of each receiver the strongest, from the strongest on; those above the limit alone.
    pub strongest: Strongest,
    /// Of each blocker the strongest towards receivers above the limit, if there is one.
    pub of_blocker: Vec<Option<Gain>>,
}

impl Gains {
    /// All pairs that can exchange antiradiance and whose gain is above `limit`, but those where surfaces meet: towards the
    /// place where a blocker touches a receiver, gains stay the same however fine the mesh is, and what shrinks is the area
    /// concerned.
    pub fn above(limit: f64, plan: &Plan) -> Self {
        let search = Search::new(limit, plan);
        let meeting = Nearest::new(search.meeting());
        let to_meeting: Vec<f64> =
            plan.facets.par_iter().map(|facet| meeting.distance(facet.centroid)).collect();
        let meets = |blocker: usize, receiver: usize, apart: f64| {
            to_meeting[blocker].max(to_meeting[receiver]) <= apart
        };
        let count = plan.facets.len();
        let mut gains = Self { strongest: vec![Vec::new(); count], of_blocker: vec![None; count] };
        let tiles: Vec<(Strongest, HashMap<u32, Gain>)> = (0..search.tiles.len())
            .into_par_iter()
            .map(|to| {
                let mut of_blocker: HashMap<u32, Gain> = HashMap::new();
                let mut strongest = Vec::new();
                for (receiver, blockers) in search.pairs(to) {
                    let mut all: Vec<Gain> = blockers
                        .filter_map(|blocker| search.gain(blocker, receiver))
                        .filter(|g| {
                            let (i, j) = (g.blocker as usize, g.receiver as usize);
                            !meets(i, j, plan.facets[i].centroid.distance(plan.facets[j].centroid))
                        })
                        .collect();
                    for g in &all {
                        let best = of_blocker.entry(g.blocker).or_insert(*g);
                        if g.gain > best.gain {
                            *best = *g;
                        }
                    }
                    all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
                    all.truncate(STRONGEST);
                    strongest.push(all);
                }
                (strongest, of_blocker)
            })
            .collect();
        for (strongest, of_blocker) in tiles {
            for list in strongest {
                if let Some(receiver) = list.first().map(|g| g.receiver) {
                    gains.strongest[receiver as usize] = list;
                }
            }
            for (blocker, g) in of_blocker {
                let best = &mut gains.of_blocker[blocker as usize];
                if best.is_none_or(|best| g.gain > best.gain) {
                    *best = Some(g);
                }
            }
        }
        gains
    }
}

/// Walks over pairs that may have a gain above a limit, tile by tile.
struct Search<'a> {
    plan: &'a Plan,
    limit: f64,
    /// The smallest solid angle of a bin, sr.
    finest: f64,
    tiles: Vec<Block>,
    /// The largest triangle of each tile.
    areas: Vec<f64>,
    tolerance: f64,
}

impl<'a> Search<'a> {
    fn new(limit: f64, plan: &'a Plan) -> Self {
        let runs = || plan.layout.order.chunks(plan.layout.tile as usize);
        let facets = |slots: &'a [u32]| real(slots).map(|i| &plan.facets[i as usize]);
        Self {
            plan,
            limit,
            finest: plan.bins.solid_angle.iter().copied().fold(f64::INFINITY, f64::min),
            tiles: runs().map(|slots| Block::around(facets(slots))).collect(),
            areas: runs().map(|slots| facets(slots).map(|f| f.area).fold(0.0, f64::max)).collect(),
            tolerance: coplanar_tolerance(&plan.facets),
        }
    }

    fn of_tile(&self, tile: usize) -> impl Iterator<Item = u32> + Clone + use<'a> {
        let size = self.plan.layout.tile as usize;
        real(&self.plan.layout.order[tile * size..(tile + 1) * size])
    }

    /// The receivers of a tile, each with blockers that may be near.
    fn pairs(&self, to: usize) -> impl Iterator<Item = (u32, impl Iterator<Item = u32>)> {
        let all = 0..self.tiles.len() as u32;
        let near: Vec<u32> = self
            .plan
            .interactions()
            .by_receiver
            .far
            .passing(to as u32, &all, PAIR_BACK)
            .map(|from| from as usize)
            .filter(|&from| {
                let apart = self.tiles[from].distance_squared(&self.tiles[to]);
                self.areas[from] > self.limit * self.finest * apart
            })
            .flat_map(|from| self.of_tile(from))
            .filter(|&blocker| self.plan.classes[blocker as usize].blocker)
            .collect();
        self.of_tile(to)
            .map(move |receiver| (receiver, near.clone().into_iter().filter(move |&i| i != receiver)))
    }

    /// Middles of pairs of a blocker and what it should keep dark that touch.
    fn meeting(&self) -> Vec<DVec3> {
        let facet = |i: u32| &self.plan.facets[i as usize];
        let reach = |f: &Facet| f.corners.iter().map(|&c| c.distance(f.centroid)).fold(0.0, f64::max);
        let touch = |blocker: u32, receiver: u32| {
            let (from, to) = (facet(blocker), facet(receiver));
            (from.centroid.distance(to.centroid) <= reach(from) + reach(to)
                && self.passes(from, to)
                && between(from.corners, to.corners).length() <= self.tolerance)
                .then(|| from.centroid.midpoint(to.centroid))
        };
        (0..self.tiles.len())
            .into_par_iter()
            .flat_map_iter(|to| {
                self.pairs(to)
                    .flat_map(|(receiver, near)| near.filter_map(move |blocker| touch(blocker, receiver)))
                    .collect::<Vec<_>>()
            })
            .collect()
    }

    /// True where antiradiance goes from centroid to centroid.
    fn passes(&self, from: &Facet, to: &Facet) -> bool {
        let between = to.centroid - from.centroid;
        between.dot(from.normal) < 0.0
            && between.dot(to.normal) < 0.0
            && reaches(from, to, -1.0, self.tolerance)
    }

    /// a cos_i / (d² s_b), with the pieces that the transport cuts the blocker into, if it is above the limit.
    fn gain(&self, blocker: u32, receiver: u32) -> Option<Gain> {
        let plan = self.plan;
        let (from, to) = (&plan.facets[blocker as usize], &plan.facets[receiver as usize]);
        let between = to.centroid - from.centroid;
        let r2 = between.length_squared();
        if from.area <= self.limit * self.finest * r2 {
            return None;
        }
        let range = 0.5 * plan.accuracy.subsample * (from.extent + to.extent);
        let (far, middle) = (far_weight(r2, range), far_weight(r2, range * QUARTER_RANGE));
        let piece = from.area * (far + (1.0 - far) * (middle / 4.0 + (1.0 - middle) / 16.0));
        let back = -between / r2.sqrt();
        let solid_angle = piece * back.dot(from.normal) / (r2 + piece / PI);
        if solid_angle <= self.limit * self.finest || !self.passes(from, to) {
            return None;
        }
        let taps = plan.bins.taps(from.to_local(back));
        let bin: f64 = taps.iter().map(|&(b, t)| t * plan.bins.solid_angle[b]).sum();
        let gain = solid_angle / bin;
        (gain > self.limit).then_some(Gain { blocker, receiver, gain })
    }
}

fn real(slots: &[u32]) -> impl Iterator<Item = u32> + Clone {
    slots.iter().copied().filter(|&i| i != PADDING)
}

/// Distances to the nearest of some points, which are kept in runs of neighbours.
struct Nearest {
    runs: Vec<(DVec3, DVec3, Vec<DVec3>)>,
}

impl Nearest {
    const RUN: usize = 64;

    fn new(mut points: Vec<DVec3>) -> Self {
        let (low, high) = bounds(&points);
        let size = (high - low).max_element().max(f64::MIN_POSITIVE);
        points.sort_by_cached_key(|&p| morton((p - low) / size));
        let run = |points: &[DVec3]| {
            let (low, high) = bounds(points);
            (low, high, points.to_vec())
        };
        Self { runs: points.chunks(Self::RUN).map(run).collect() }
    }

    /// Infinite where there is no point.
    fn distance(&self, from: DVec3) -> f64 {
        let mut nearest = f64::INFINITY;
        for (low, high, points) in &self.runs {
            if (*low - from).max(from - *high).max(DVec3::ZERO).length_squared() < nearest {
                nearest = points.iter().map(|p| p.distance_squared(from)).fold(nearest, f64::min);
            }
        }
        nearest.sqrt()
    }
}

fn bounds(points: &[DVec3]) -> (DVec3, DVec3) {
    let around = |(low, high): (DVec3, DVec3), &p: &DVec3| (low.min(p), high.max(p));
    points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), around)
}
