//! The test that decides whether a cluster may stand for its triangles as one source.
//!
//! Seen from a distance r, a cluster with variance σ² of its centroids and δ² of its frames is wrong by about
//! w (σ/r) (σ/r + δ) of the mean irradiance, w being its share of that irradiance; where bins are read or filled, by
//! w ((σ/r)² + δ²) / Ω, since a bin resolves its solid angle Ω and no more. Where a curved cluster is seen edge-on, the error is of
//! first order, w δ. Lamps off its centre by d count like triangles at that distance, w (d/r)²: the first moment of light covers
//! the rest. Light decides, not angle alone: small, dim and inclined sources need little care.

use super::moments::{Cuts, Moments};
use super::sources::ENTRY_BITS;
use super::volumes::{Place, VolumeTree};
use super::{ClusterInput, LIST, MOVED};
use crate::model::class::{Class, coplanar_tolerance};
use crate::model::facet::Facet;
use crate::model::hierarchy::{Hierarchy, Node, Sight};
use crate::model::order::{BoundedRun, PADDING};
use crate::model::passing::{PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use antirad_base::parallel;
use glam::DVec3;
use std::f64::consts::{PI, SQRT_2};
use std::ops::Range;

/// Square of the largest σ/r over the error: the light of a cluster is linear in its plane, and what is missing tends to have the
/// same sign everywhere, so that these errors add up.
const WIDE: f64 = 5.0;
/// Square of the largest σ/r over the error, where bins are read or filled: light per bin is that of the
/// centroid.
const WIDE_IN_BINS: f64 = 2.5;
/// Square of the largest σ/r over the solid angle of a bin, where bins are read or filled and derivatives are wanted: these see how
/// light changes from bin to bin.
const WIDE_IN_SLOPES: f64 = 0.02;
/// Square of the largest δ over the error, where bins of the cluster are read: its share of the light alone would let any curved cluster
/// pass where there are very many.
const TURNED_IN_BINS: f64 = 4.0;
/// Largest σ/r, and δ, for any error: beyond, higher orders count.
pub const WIDEST: f64 = 0.2;
/// Length of lists with volumes over that without, up to which there are volumes: they err more than clusters of one normal.
const WORTH: f64 = 0.75;
/// One branch of receivers of so many is looked at to tell, but so many at least and at most: lists without volumes are several times as long.
const SAMPLED: usize = 16;
const SAMPLES: [usize; 2] = [8, 24];
/// δ below which a cluster counts as flat.
const FLAT: f64 = 1e-3;

/// A branch as the test sees it.
struct Branch {
    /// Index of the cluster; `None` if the triangles are of several groups.
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

impl Branch {
    /// Whether any of its triangles may be a blocker.
    fn may_block(&self) -> bool {
        self.index.is_none() || self.blocker
    }
}

/// A group of receivers.
pub struct Receivers<'a> {
    /// Number of the node in the tree of receivers.
    at: usize,
    pub node: &'a Node,
    pub centre: DVec3,
    pub radius: f64,
    bins: bool,
}

/// Whether any pair of triangles in a branch and in a box may be within the near field; `area`: the largest characteristic area in the
/// box.
pub fn are_near(to: &Node, bounds: &BoundedRun, area: f64, half_range: f64) -> bool {
    to.bounds.distance_squared(bounds) <= half_range * (to.characteristic_area + area)
}

/// Groups that walk along the tree together.
const AT_ONCE: usize = 8;

/// What becomes the list of a group.
struct List<'a> {
    to: Receivers<'a>,
    taken: TakenRuns,
    entries: Vec<u32>,
}

/// How much of a branch volumes stand for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Taken {
    Nothing,
    Some,
    All,
}

/// How a branch and some receivers lie to each other. What is decided holds of its branches, too, and for some of the receivers.
#[derive(Clone, Copy)]
struct Seen {
    /// No pair is within the near field.
    apart: bool,
    /// All of the branch extends above the plane of each receiver.
    above: bool,
    /// Whether the receivers extend to the fronts, and to the backs, of its planes.
    sides: [Sight; 2],
}

impl Seen {
    const UNKNOWN: Self = Self { apart: false, above: false, sides: [Sight::Unknown; 2] };

    /// Whether any light of a branch may arrive.
    fn any(&self, branch: &Branch) -> bool {
        self.sides[0] != Sight::Nothing || self.sides[1] != Sight::Nothing && branch.may_block()
    }

    /// What either tells.
    fn or(self, other: Self) -> Self {
        let either = |k: usize| match self.sides[k] {
            Sight::Unknown => other.sides[k],
            known => known,
        };
        Self {
            apart: self.apart || other.apart,
            above: self.above || other.above,
            sides: [either(0), either(1)],
        }
    }
}

/// How a branch and some receivers lie to each other in two geometries: the one that lists are chosen for,
/// and the current one, which differs where vertices have moved.
#[derive(Clone, Copy)]
struct Sights {
    chosen: Seen,
    now: Seen,
}

impl Sights {
    const UNKNOWN: Self = Self { chosen: Seen::UNKNOWN, now: Seen::UNKNOWN };

    /// What either tells.
    fn or(self, other: Self) -> Self {
        Self { chosen: self.chosen.or(other.chosen), now: self.now.or(other.now) }
    }
}

/// What holds of a branch for a group.
#[derive(Clone, Copy)]
struct Known {
    /// Begin and end of the runs of [`TakenRuns`] that may meet the branch; an empty range if none does.
    taken: [u32; 2],
    sights: Sights,
}

impl Known {
    /// Whether no volume stands for any of its triangles.
    fn is_free(&self) -> bool {
        self.taken[0] >= self.taken[1]
    }
}

const SIDES: [(f64, u32); 2] = [(1.0, PAIR_FRONT), (-1.0, PAIR_BACK)];

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

    /// How much of a place is taken, and a window on the runs that contains all that meet it; `among`: one of a place around it.
    fn of(&self, place: &Place, among: [u32; 2]) -> (Taken, [u32; 2]) {
        let runs = &self.0[among[0] as usize..among[1] as usize];
        let (mut all, mut some) = (place.all, false);
        let mut window = [among[1], among[0]];
        for [first, last] in place.runs() {
            let next = runs.partition_point(|run| run.end <= first);
            let behind = next + runs[next..].partition_point(|run| run.start <= last);
            let meets = runs[next..behind].first();
            some |= meets.is_some();
            all &= meets.is_some_and(|run| run.start <= first && last < run.end);
            window = [window[0].min(among[0] + next as u32), window[1].max(among[0] + behind as u32)];
        }
        match (all, some) {
            (true, true) => (Taken::All, window),
            (_, true) => (Taken::Some, window),
            (_, false) => (Taken::Nothing, [0, 0]),
        }
    }

    /// Whether a triangle is taken; `among`: the window of a place around it.
    fn contain(&self, position: u32, among: [u32; 2]) -> bool {
        let runs = &self.0[among[0] as usize..among[1] as usize];
        let next = runs.partition_point(|run| run.end <= position);
        runs.get(next).is_some_and(|run| run.start <= position)
    }

    /// The window on all.
    fn all(&self) -> [u32; 2] {
        [0, self.0.len() as u32]
    }
}

/// The trees of sources and receivers around triangles at some time.
pub struct Trees {
    pub sources: Hierarchy,
    receivers: Hierarchy,
}

impl Trees {
    pub fn new(input: &ClusterInput, cuts: &Cuts) -> Self {
        let &ClusterInput { facets, order, leaf, .. } = input;
        let tolerance = coplanar_tolerance(facets);
        Self {
            sources: Hierarchy::cut_by(facets, order, leaf as usize, tolerance, |leaves| cuts.cut(leaves)),
            receivers: Hierarchy::new(facets, order, LIST as usize, tolerance),
        }
    }

    /// Both trees with the same branches, bounded around triangles that have moved.
    fn moved(&self, input: &ClusterInput, facets: &[Facet]) -> Self {
        let tolerance = coplanar_tolerance(facets);
        let moved =
            |tree: &Hierarchy, leaf: u32| tree.around_moved(facets, input.order, leaf as usize, tolerance);
        Self { sources: moved(&self.sources, input.leaf), receivers: moved(&self.receivers, LIST) }
    }

    /// What bounds tell of a branch and receivers; `half_range`: of the near field; `cull`: whether it matters who sees whom.
    fn look(
        &self,
        to: &Node,
        from: &Node,
        branch: &Branch,
        seen: Seen,
        (half_range, cull): (f64, bool),
    ) -> Seen {
        let apart = seen.apart || !are_near(to, &from.bounds, from.characteristic_area, half_range);
        if !cull {
            return Seen { apart, ..seen };
        }
        let above = seen.above
            || match self.sources.sight(to, &from.bounds, 1.0, false) {
                Sight::Nothing => return Seen { apart, sides: [Sight::Nothing; 2], ..seen },
                Sight::Unknown => false,
                Sight::Each => true,
            };
        let mut sides = seen.sides;
        for (sight, (side, bit)) in sides.iter_mut().zip(SIDES) {
            if *sight == Sight::Unknown && (bit == PAIR_FRONT || branch.may_block() || branch.turn > FLAT) {
                *sight = self.sources.sight(from, &to.bounds, side, to.is_leaf());
            }
        }
        Seen { apart, above, sides }
    }
}

pub struct Acceptance<'a> {
    input: &'a ClusterInput<'a>,
    /// What is chosen depends on these alone.
    chosen: &'a Trees,
    /// What light can pass depends on these, if triangles have moved.
    now: Option<Trees>,
    /// Half of the range, as that of the near field, that clusters keep from receivers.
    kept_range: f64,
    /// The leaves of the tree of receivers, the groups.
    groups: Vec<usize>,
    branches: Vec<Branch>,
    volumes: Option<VolumeTree<'a>>,
    /// Per branch of the tree of sources, where its triangles are in the tree of volumes; empty without
    /// volumes.
    places: Vec<Place>,
}

impl<'a> Acceptance<'a> {
    /// `index`: the cluster of each node, if it is one.
    pub fn new(input: &'a ClusterInput<'a>, chosen: &'a Trees, index: &[Option<u32>]) -> Self {
        let &ClusterInput { facets, order, leaf, .. } = input;
        let tree = &chosen.sources;
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
        let volumes =
            input.most_volumes.map(|most| VolumeTree::new(input, most, &planes(tree, &branches, input)));
        let places = volumes.as_ref().map_or(Vec::new(), |volumes| places(tree, volumes, input));
        let leaves = chosen.receivers.nodes().iter().enumerate().filter(|(_, node)| node.is_leaf());
        let groups = leaves.map(|(at, _)| at).collect();
        let now = input.moved.map(|facets| chosen.moved(input, facets));
        let half_range = input.half_range;
        let kept_range = if input.slopes { (half_range.sqrt() + SQRT_2 * MOVED).powi(2) } else { half_range };
        Self { input, chosen, now, kept_range, groups, branches, volumes, places }
    }

    /// The sources of each group of receivers; volumes have the indices from `volumes` on, by their number in the tree. `None` if
    /// there are too many.
    pub fn lists(&self, volumes: u32) -> Option<Vec<Vec<u32>>> {
        let last = u64::from(volumes) + self.volumes.as_ref().map_or(0, VolumeTree::count) as u64;
        if self.input.leaf == 0 || last >= 1 << (u32::BITS - ENTRY_BITS) {
            return None;
        }
        let mut together = Vec::new();
        self.chosen.receivers.walk(|at, node| {
            let few = node.leaves.len() <= AT_ONCE;
            together.extend(few.then_some(at));
            !few
        });
        let volumes = Some(volumes).filter(|_| self.volumes_pay(&together));
        Some(parallel::flat_map(together, |at| self.lists_of(at, volumes)))
    }

    /// Whether volumes shorten some of the lists enough.
    fn volumes_pay(&self, receivers: &[usize]) -> bool {
        let [least, most] = SAMPLES;
        let samples = (receivers.len() / SAMPLED).clamp(least, most);
        let step = (receivers.len() / samples).max(1);
        let sample: Vec<usize> = receivers.iter().copied().step_by(step).collect();
        let length = |volumes: Option<u32>| -> usize {
            let of = |&at: &usize| self.lists_of(at, volumes).iter().map(Vec::len).sum::<usize>();
            parallel::map(&sample, of).into_iter().sum()
        };
        self.volumes.is_some() && length(Some(0)) as f64 <= WORTH * length(None) as f64
    }

    /// The tree that volumes were chosen from.
    pub fn into_volumes(self) -> Option<VolumeTree<'a>> {
        self.volumes
    }

    /// The lists of the groups in a branch of receivers, which walk along the tree together: then they read its branches, of which most
    /// are in no cache, once, and what holds for all is found once. Without volumes where `volumes` is `None`.
    fn lists_of(&self, receivers: usize, volumes: Option<u32>) -> Vec<Vec<u32>> {
        let groups = &self.groups[self.chosen.receivers.nodes()[receivers].leaves.clone()];
        let mut lists: Vec<List> = groups.iter().map(|&at| self.list(at, volumes)).collect();
        let mut known = [None; AT_ONCE];
        for (known, list) in known.iter_mut().zip(&lists) {
            let first = Known { taken: list.taken.all(), sights: Sights::UNKNOWN };
            *known = self.class_of(list.to.node).map(|_| first);
        }
        self.chosen.sources.descend((Sights::UNKNOWN, known), |at, from, (sights, mut known)| {
            let sights = self.look(receivers, at, sights)?;
            for (known, list) in known.iter_mut().zip(&mut lists) {
                let so_far = known.map(|known| Known { sights: known.sights.or(sights), ..known });
                *known = so_far.and_then(|known| self.visit(list, at, from, known));
            }
            known.iter().any(Option::is_some).then_some((sights, known))
        });
        let sorted = |List { mut entries, .. }: List| {
            entries.sort_unstable();
            entries
        };
        lists.into_iter().map(sorted).collect()
    }

    /// The class of a group; `None` if it is all padding.
    fn class_of(&self, node: &Node) -> Option<&Class> {
        self.input.classes.get(node.slots(LIST as usize, self.input.order)[0] as usize)
    }

    /// The list of a group, with its volumes.
    fn list(&self, at: usize, volumes: Option<u32>) -> List<'_> {
        let node = &self.chosen.receivers.nodes()[at];
        let class = self.class_of(node);
        let half = 0.5 * (node.bounds.max - node.bounds.min);
        let to = Receivers {
            at,
            node,
            centre: node.bounds.min.midpoint(node.bounds.max),
            radius: half.length(),
            bins: class.is_some_and(|class| class.has_bins()),
        };
        let mut list = List { to, taken: TakenRuns(Vec::new()), entries: Vec::new() };
        if let Some((volumes, first)) = self.volumes.as_ref().zip(volumes).filter(|_| class.is_some()) {
            let List { to, taken, entries } = &mut list;
            volumes.choose(to, |number, bounds, at| {
                if !self.input.cull || self.chosen.sources.sight(node, bounds, 1.0, true) != Sight::Nothing {
                    entries.push((first + number) << ENTRY_BITS | PAIR_FRONT | PAIR_BACK);
                }
                taken.add(at.clone());
            });
        }
        list
    }

    /// Adds a branch to a list, or those of its triangles that no volume stands for; or returns what holds of its branches, which are
    /// to be visited.
    fn visit(&self, list: &mut List, at: usize, from: &Node, known: Known) -> Option<Known> {
        let &ClusterInput { order, leaf, .. } = self.input;
        let List { to, taken, entries } = list;
        let branch = &self.branches[at];
        let (part, window) = match self.places.get(at) {
            Some(place) if !known.is_free() => taken.of(place, known.taken),
            _ => (Taken::Nothing, [0, 0]),
        };
        if part == Taken::All || branch.area == 0.0 && branch.facet.area == 0.0 {
            return None;
        }
        let known = Known { taken: window, sights: self.look(to.at, at, known.sights)? };
        let Sights { chosen, now } = known.sights;
        let passing = self.passing(branch, &now);
        let stands = |_: &u32| known.is_free() && now.apart && self.stands_for(to, from, branch, chosen);
        if let Some(index) = branch.index.filter(stands) {
            entries.push(index << ENTRY_BITS | passing);
            return None;
        }
        if from.is_leaf() {
            let near = if now.apart { 0 } else { PAIR_NEAR };
            let first = from.leaves.start as u32 * leaf;
            for (&i, slot) in from.slots(leaf as usize, order).iter().zip(first..) {
                let position = || self.volumes.as_ref().and_then(|volumes| volumes.position(slot));
                let is_taken = |at| taken.contain(at, known.taken);
                if i == PADDING || !known.is_free() && position().is_some_and(is_taken) {
                    continue;
                }
                let passing = self.of_triangle(to, i as usize, passing, &now);
                if passing != 0 {
                    entries.push(slot << ENTRY_BITS | passing | near);
                }
            }
        }
        Some(known)
    }

    /// What bounds tell of receivers and a branch, by number; `None` if none of these can see it now.
    fn look(&self, to: usize, from: usize, sights: Sights) -> Option<Sights> {
        let &ClusterInput { half_range, cull, .. } = self.input;
        let branch = &self.branches[from];
        let at = |trees: &Trees, seen: Seen, half_range: f64| {
            let (to, from) = (&trees.receivers.nodes()[to], &trees.sources.nodes()[from]);
            trees.look(to, from, branch, seen, (half_range, cull))
        };
        let chosen = at(self.chosen, sights.chosen, self.kept_range);
        let now = match &self.now {
            None => chosen,
            Some(trees) => at(trees, sights.now, half_range),
        };
        now.any(branch).then_some(Sights { chosen, now })
    }

    /// What a branch can send to a group at most.
    fn passing(&self, branch: &Branch, seen: &Seen) -> u32 {
        let can = |(seen, (_, bit)): (&Sight, (f64, u32))| {
            let sends = bit == PAIR_FRONT || branch.may_block();
            if sends && *seen != Sight::Nothing { bit } else { 0 }
        };
        seen.sides.iter().zip(SIDES).map(can).sum()
    }

    /// What a triangle can send, of what its leaf can.
    fn of_triangle(&self, to: &Receivers, i: usize, passing: u32, seen: &Seen) -> u32 {
        let ClusterInput { facets, moved, classes, cull, .. } = self.input;
        let facets = moved.unwrap_or(facets);
        let trees = self.now.as_ref().unwrap_or(self.chosen);
        let bounds = &trees.receivers.nodes()[to.at].bounds;
        let can = |(seen, (side, bit)): (&Sight, (f64, u32))| {
            let sends = passing & bit != 0 && (bit == PAIR_FRONT || classes[i].blocker);
            let seen = || !cull || *seen == Sight::Each || !trees.sources.misses(&facets[i], bounds, side);
            if sends && seen() { bit } else { 0 }
        };
        seen.sides.iter().zip(SIDES).map(can).sum()
    }

    /// Whether a cluster may stand for a branch, by the triangles that lists are chosen for.
    fn stands_for(&self, to: &Receivers, from: &Node, branch: &Branch, seen: Seen) -> bool {
        // Where nothing could pass then, anything may since.
        let seen = if seen.any(branch) { seen } else { Seen { sides: [Sight::Unknown; 2], ..seen } };
        let passing = self.passing(branch, &seen);
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
        let bins_are_read = passing & PAIR_BACK != 0 || branch.glossy;
        let turned = if bins_are_read { branch.turn } else { 0.0 };
        let most_turned2 = match self.input.slopes {
            true => WIDEST * WIDEST,
            false => (TURNED_IN_BINS * self.input.error).min(WIDEST * WIDEST),
        };
        let flat = branch.turn <= WIDEST && turned * turned <= most_turned2;
        // In this form, a distance of zero accepts nothing.
        if !(angle2 <= widest2 && flat && seen.apart) {
            return false;
        }
        let angle = angle2.sqrt();
        let sees_back = || match self.input.cull {
            true => seen.sides[1] != Sight::Nothing,
            false => self.chosen.sources.sight(from, &to.node.bounds, -1.0, true) != Sight::Nothing,
        };
        let edge_on = branch.turn > FLAT && passing & PAIR_FRONT != 0 && sees_back();
        let direction = (facet.centroid - to.centre).normalize_or_zero();
        let wide = (to.radius + branch.size) / r2.sqrt();
        let received = (Hierarchy::steepest(to.node, direction) + wide).clamp(0.0, 1.0);
        let sent = (facet.normal.dot(direction).abs() + wide + branch.turn).min(1.0);
        let light = if passing & PAIR_FRONT != 0 { branch.light } else { 0.0 };
        let back = if passing & PAIR_BACK != 0 { self.input.backs * branch.area } else { 0.0 };
        let share = received * sent * light.max(back) / (PI * r2);
        let second_order = angle * (angle + branch.turn);
        let in_bins = if bins { (angle2 + turned * turned) / self.input.bin } else { 0.0 };
        let inclined = if edge_on { branch.turn } else { 0.0 };
        let uneven = if passing & PAIR_FRONT != 0 { branch.offset * branch.offset / r2 } else { 0.0 };
        share * second_order.max(in_bins).max(inclined + uneven) <= self.input.error
    }
}

/// Per slot, the index of the largest cluster around it whose triangles lie in a plane, or the slot itself.
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
