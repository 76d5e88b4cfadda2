//! Where a cluster may stand for its triangles.
//!
//! Seen from a distance r, a cluster with variance σ² of its centroids and δ² of its frames is wrong by about
//! w (σ/r) (σ/r + δ) of the mean irradiance, w being its share of that irradiance; where bins are read or filled, by
//! w ((σ/r)² + δ²) / Ω, since a bin resolves its solid angle Ω and no more. Where a curved cluster is seen edge-on, the error is of
//! first order, w δ. Lamps off its centre by d count like triangles at that distance, w (d/r)²: the first moment of light covers
//! the rest. Light decides, not angle alone: small, dim and inclined sources need little care.

use super::moments::Moments;
use super::sources::ENTRY_BITS;
use super::volumes::{Place, VolumeTree};
use super::{ClusterInput, LIST};
use crate::model::facet::Facet;
use crate::model::hierarchy::{Hierarchy, Node, Sight};
use crate::model::order::{BoundedRun, PADDING};
use crate::model::passing::{PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;

/// Square of the largest σ/r over the error: the light of a cluster is linear in its plane, and what is missing tends to have the
/// same sign everywhere, so that these errors add up.
const WIDE: f64 = 5.0;
/// The same where bins are read or filled: light per bin is that of the centroid.
const WIDE_IN_BINS: f64 = 2.5;
/// Square of the largest σ/r over the solid angle of a bin, where bins are read or filled and derivatives are wanted: these see how
/// light changes from bin to bin.
const WIDE_IN_SLOPES: f64 = 0.02;
/// Largest σ/r, and δ, for any error: beyond, higher orders count.
pub const WIDEST: f64 = 0.2;
/// Length of lists with volumes over that without, up to which there are volumes: they err more than clusters of one normal.
const WORTH: f64 = 0.75;
/// One list of so many is looked at to tell.
const SAMPLED: usize = 16;
/// δ below which a cluster counts as flat.
const FLAT: f64 = 1e-3;

/// A branch as the test sees it.
struct Branch {
    /// Its index, unless its triangles are of several classes.
    index: Option<u32>,
    facet: Facet,
    /// σ, σ², δ.
    size: f64,
    spread: f64,
    turn: f64,
    offset: f64,
    /// Vector area, and its product with the mean brightness.
    area: f64,
    light: f64,
    blocker: bool,
    glossy: bool,
}

/// A group of receivers.
pub struct Receivers<'a> {
    pub node: &'a Node,
    pub centre: DVec3,
    pub radius: f64,
    bins: bool,
}

impl Receivers<'_> {
    /// Whether any pair with triangles in a box may be within the near field; `area`: their largest characteristic area.
    pub fn are_near(&self, bounds: &BoundedRun, area: f64, half_range: f64) -> bool {
        self.node.bounds.distance_squared(bounds) <= half_range * (self.node.characteristic_area + area)
    }
}

/// How much of a branch volumes stand for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Taken {
    Nothing,
    Some,
    All,
}

/// The triangles that volumes stand for, by position, ascending.
struct TakenRuns(Vec<Range<u32>>);

impl TakenRuns {
    /// Adds a run behind all others; with one that ends where it begins it makes up one.
    fn add(&mut self, run: Range<u32>) {
        match self.0.last_mut() {
            Some(last) if last.end == run.start => last.end = run.end,
            _ => self.0.push(run),
        }
    }

    fn of(&self, place: &Place) -> Taken {
        let (mut all, mut some) = (place.all, false);
        for [first, last] in place.runs() {
            let next = self.0.partition_point(|run| run.end <= first);
            let meets = self.0.get(next).filter(|run| run.start <= last);
            some |= meets.is_some();
            all &= meets.is_some_and(|run| run.start <= first && last < run.end);
        }
        match (all, some) {
            (true, true) => Taken::All,
            (_, true) => Taken::Some,
            (_, false) => Taken::Nothing,
        }
    }
}

pub struct Acceptance<'a> {
    input: &'a ClusterInput<'a>,
    tree: &'a Hierarchy,
    receivers: Hierarchy,
    branches: Vec<Branch>,
    volumes: Option<VolumeTree<'a>>,
    /// By branch.
    places: Vec<Place>,
}

impl<'a> Acceptance<'a> {
    /// `index`: the cluster of each node, if it is one.
    pub fn new(input: &'a ClusterInput<'a>, tree: &'a Hierarchy, index: &[Option<u32>]) -> Self {
        let &ClusterInput { facets, order, leaf, .. } = input;
        let nodes = tree.nodes();
        let mut moments = vec![Moments::default(); nodes.len()];
        for at in (0..nodes.len()).rev() {
            let triangles = || nodes[at].slots(leaf as usize, order).iter().filter(|&&i| i != PADDING);
            moments[at] = match tree.branches(at) {
                Some([a, b]) => moments[a] + moments[b],
                None => {
                    triangles().map(|&i| Moments::of(&facets[i as usize], input.brightness[i as usize])).sum()
                }
            };
        }
        let branch = |(at, moments): (usize, &Moments)| {
            let first = nodes[at].slots(leaf as usize, order)[0];
            let class = input.classes.get(first as usize).copied().unwrap_or_default();
            let real = moments.area > 0.0;
            let spread = if real { moments.spread() } else { 0.0 };
            let area = moments.vector_area();
            Branch {
                index: index[at],
                facet: moments.facet(),
                size: spread.sqrt(),
                spread,
                turn: if real { moments.turn().sqrt() } else { 0.0 },
                offset: if real { moments.offset() } else { 0.0 },
                area,
                light: if real { area * moments.brightness / moments.area } else { 0.0 },
                blocker: class.blocker,
                glossy: class.glossy,
            }
        };
        let branches: Vec<Branch> = moments.iter().enumerate().map(branch).collect();
        let receivers = Hierarchy::new(facets, order, LIST as usize, input.tolerance);
        let volumes =
            input.most_volumes.map(|most| VolumeTree::new(input, most, &planes(tree, &branches, input)));
        let places = volumes.as_ref().map_or(Vec::new(), |volumes| places(tree, volumes, input));
        Self { input, tree, receivers, branches, volumes, places }
    }

    /// The sources of each group of receivers; volumes have the indices from `volumes` on, by their number in the tree. `None` if
    /// there are too many.
    pub fn lists(&self, volumes: u32) -> Option<Vec<Vec<u32>>> {
        let last = u64::from(volumes) + self.volumes.as_ref().map_or(0, VolumeTree::count) as u64;
        if self.input.leaf == 0 || last >= 1 << (u32::BITS - ENTRY_BITS) {
            return None;
        }
        let groups: Vec<&Node> = self.receivers.leaf_nodes().collect();
        let volumes = Some(volumes).filter(|_| self.volumes_pay(&groups));
        Some(groups.into_par_iter().map(|node| self.list(node, volumes)).collect())
    }

    /// Whether volumes shorten some of the lists enough.
    fn volumes_pay(&self, groups: &[&Node]) -> bool {
        let sample: Vec<&Node> = groups.iter().copied().step_by(SAMPLED).collect();
        let length = |volumes: Option<u32>| -> usize {
            sample.par_iter().map(|node| self.list(node, volumes).len()).sum()
        };
        self.volumes.is_some() && length(Some(0)) as f64 <= WORTH * length(None) as f64
    }

    /// The tree that volumes were chosen from.
    pub fn into_volumes(self) -> Option<VolumeTree<'a>> {
        self.volumes
    }

    /// Without volumes where `volumes` is `None`.
    fn list(&self, node: &Node, volumes: Option<u32>) -> Vec<u32> {
        let &ClusterInput { order, classes, .. } = self.input;
        let slots = node.slots(LIST as usize, order);
        let Some(class) = classes.get(slots[0] as usize) else { return Vec::new() };
        let half = 0.5 * (node.bounds.max - node.bounds.min);
        let to = Receivers {
            node,
            centre: node.bounds.min.midpoint(node.bounds.max),
            radius: half.length(),
            bins: class.has_bins(),
        };
        let (taken, mut entries) =
            volumes.map_or((TakenRuns(Vec::new()), Vec::new()), |first| self.volumes(&to, first));
        self.others(&to, &taken, |entry| entries.push(entry));
        entries.sort_unstable();
        entries
    }

    /// Calls `with` with the entry of each cluster and each triangle that no volume stands for.
    fn others(&self, to: &Receivers, taken: &TakenRuns, mut with: impl FnMut(u32)) {
        let &ClusterInput { order, leaf, .. } = self.input;
        self.tree.walk(|at, from| {
            let branch = &self.branches[at];
            let part = self.places.get(at).map_or(Taken::Nothing, |place| taken.of(place));
            if part == Taken::All {
                return false;
            }
            let passing = self.passing(to, from, branch);
            if passing == 0 || branch.area == 0.0 && branch.facet.area == 0.0 {
                return false;
            }
            let stands = |_: &u32| part == Taken::Nothing && self.stands_for(to, from, branch, passing);
            if let Some(index) = branch.index.filter(stands) {
                with(index << ENTRY_BITS | passing);
                return false;
            }
            if from.is_leaf() {
                let near = if self.is_near(to, from) { PAIR_NEAR } else { 0 };
                let first = from.leaves.start as u32 * leaf;
                for (&i, slot) in from.slots(leaf as usize, order).iter().zip(first..) {
                    if i == PADDING || part == Taken::Some && self.is_taken(taken, slot) {
                        continue;
                    }
                    let passing = self.of_triangle(to, i as usize, passing);
                    if passing != 0 {
                        with(slot << ENTRY_BITS | passing | near);
                    }
                }
            }
            true
        });
    }

    fn is_taken(&self, taken: &TakenRuns, slot: u32) -> bool {
        let position = self.volumes.as_ref().and_then(|volumes| volumes.position(slot));
        taken.of(&Place::of(position)) == Taken::All
    }

    /// The triangles that volumes stand for, in place of some of the others, and the entries of these volumes.
    fn volumes(&self, to: &Receivers, first: u32) -> (TakenRuns, Vec<u32>) {
        let (mut taken, mut entries) = (TakenRuns(Vec::new()), Vec::new());
        let Some(volumes) = &self.volumes else { return (taken, entries) };
        volumes.choose(to, |number, bounds, at| {
            let seen = !self.input.cull || self.tree.sight(to.node, bounds, 1.0, true) != Sight::Nothing;
            if seen {
                entries.push((first + number) << ENTRY_BITS | PAIR_FRONT | PAIR_BACK);
            }
            taken.add(at.clone());
        });
        (taken, entries)
    }

    /// What a branch can send to a group at most.
    fn passing(&self, to: &Receivers, from: &Node, branch: &Branch) -> u32 {
        let back = if branch.index.is_none() || branch.blocker { PAIR_BACK } else { 0 };
        if !self.input.cull {
            return PAIR_FRONT | back;
        }
        let sight = |of: &Node, at: &Node, side: f64| self.tree.sight(of, &at.bounds, side, true);
        if sight(to.node, from, 1.0) == Sight::Nothing {
            return 0;
        }
        let seen = |side: f64, bit: u32| if sight(from, to.node, side) == Sight::Nothing { 0 } else { bit };
        seen(1.0, PAIR_FRONT) | if back == 0 { 0 } else { seen(-1.0, PAIR_BACK) }
    }

    /// What a triangle can send, of what its leaf can.
    fn of_triangle(&self, to: &Receivers, i: usize, passing: u32) -> u32 {
        let ClusterInput { facets, classes, cull, .. } = self.input;
        let can = |side: f64, bit: u32| match passing & bit != 0
            && (!cull || !self.tree.misses(&facets[i], &to.node.bounds, side))
        {
            true => bit,
            false => 0,
        };
        let back = if classes[i].blocker { can(-1.0, PAIR_BACK) } else { 0 };
        can(1.0, PAIR_FRONT) | back
    }

    /// Whether any pair may be within the near field.
    fn is_near(&self, to: &Receivers, from: &Node) -> bool {
        to.are_near(&from.bounds, from.characteristic_area, self.input.half_range)
    }

    fn stands_for(&self, to: &Receivers, from: &Node, branch: &Branch, passing: u32) -> bool {
        let facet = &branch.facet;
        let nearest = facet.centroid.clamp(to.node.bounds.min, to.node.bounds.max);
        let r2 = facet.centroid.distance_squared(nearest);
        let angle2 = branch.spread / r2;
        let bins = to.bins || passing & PAIR_BACK != 0 || branch.glossy;
        let wide = match bins {
            false => WIDE * self.input.error,
            true if self.input.slopes => WIDE_IN_SLOPES * self.input.bin,
            true => WIDE_IN_BINS * self.input.error,
        };
        let widest2 = wide.min(WIDEST * WIDEST);
        // In this form, a distance of zero accepts nothing.
        if !(angle2 <= widest2 && branch.turn <= WIDEST) || self.is_near(to, from) {
            return false;
        }
        let angle = angle2.sqrt();
        let edge_on = branch.turn > FLAT && passing & PAIR_FRONT != 0 && self.sees_back(to, from);
        let direction = (facet.centroid - to.centre).normalize_or_zero();
        let wide = (to.radius + branch.size) / r2.sqrt();
        let received = (Hierarchy::steepest(to.node, direction) + wide).clamp(0.0, 1.0);
        let sent = (facet.normal.dot(direction).abs() + wide + branch.turn).min(1.0);
        let light = if passing & PAIR_FRONT != 0 { branch.light } else { 0.0 };
        let back = if passing & PAIR_BACK != 0 { self.input.backs * branch.area } else { 0.0 };
        let share = received * sent * light.max(back) / (PI * r2);
        let second_order = angle * (angle + branch.turn);
        let turn = if passing & PAIR_BACK != 0 || branch.glossy { branch.turn } else { 0.0 };
        let in_bins = if bins { (angle2 + turn * turn) / self.input.bin } else { 0.0 };
        let turned = if edge_on { branch.turn } else { 0.0 };
        let uneven = if passing & PAIR_FRONT != 0 { branch.offset * branch.offset / r2 } else { 0.0 };
        share * second_order.max(in_bins).max(turned + uneven) <= self.input.error
    }

    fn sees_back(&self, to: &Receivers, from: &Node) -> bool {
        self.tree.sight(from, &to.node.bounds, -1.0, true) != Sight::Nothing
    }
}

/// By slot, the largest branch around it whose triangles lie in a plane and may be a cluster, or itself.
fn planes(tree: &Hierarchy, branches: &[Branch], input: &ClusterInput) -> Vec<u32> {
    let mut planes: Vec<u32> = (0..input.order.len() as u32).collect();
    tree.walk(|at, node| {
        let plane = branches[at].index.filter(|_| branches[at].turn <= FLAT);
        if let Some(index) = plane {
            let slots = node.leaves.start * input.leaf as usize..node.leaves.end * input.leaf as usize;
            planes[slots.start..slots.end.min(input.order.len())].fill(index);
        }
        plane.is_none()
    });
    planes
}

fn places(tree: &Hierarchy, volumes: &VolumeTree, input: &ClusterInput) -> Vec<Place> {
    let nodes = tree.nodes();
    let mut places = vec![Place::NOWHERE; nodes.len()];
    for at in (0..nodes.len()).rev() {
        places[at] = match tree.branches(at) {
            Some([a, b]) => places[a].with(places[b]),
            None => {
                let first = nodes[at].leaves.start as u32 * input.leaf;
                let slots = nodes[at].slots(input.leaf as usize, input.order).iter().zip(first..);
                let of = |(_, slot): (&u32, u32)| Place::of(volumes.position(slot));
                slots.filter(|(i, _)| **i != PADDING).map(of).fold(Place::NOWHERE, Place::with)
            }
        };
    }
    places
}
