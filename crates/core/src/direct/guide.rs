//! Which part of a lamp rays from points go to: that from which light arrives around.
//!
//! A lamp is the unit square, cut into cells. Rays of triangles tell from which cells light arrives there. Triangles that are close to each other
//! and face the same way see about the same, and many rays of all of them together tell which cells are dark for sure. Points of these
//! triangles send no rays to them: of a sky behind walls, all go to its openings.

use crate::model::Facet;
use glam::DVec3;
use std::collections::{BTreeMap, HashMap};

/// Cells along a side of the unit square, and all of them.
const SIDE: usize = 8;
pub const CELLS: usize = SIDE * SIDE;
/// Digits of a coordinate below those of its cell.
const DIGITS: u32 = 29;

/// Groups along the largest side of the scene.
const GROUPS: f64 = 16.0;
/// Rays of a group to a cell and those around, none of which has arrived, after which none ever does. What is lost so of their light is below
/// 1 in e times as many, a hundredth.
const ENOUGH: u32 = 32;

/// The cell of a place of the unit square, in units of 2^-32.
fn cell_of([s, t]: [u32; 2]) -> usize {
    (s >> DIGITS) as usize * SIDE + (t >> DIGITS) as usize
}

/// The cells from which some light arrives at a triangle, and those from which some does not: a bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize, serde::Serialize)]
pub struct Mask {
    arrives: u64,
    stops: u64,
}

impl Mask {
    pub fn add(&mut self, place: [u32; 2], arrives: bool) {
        *(if arrives { &mut self.arrives } else { &mut self.stops }) |= 1 << cell_of(place);
    }

    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// Cells of a lamp that are not dark for sure, in ascending order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Open(u64);

impl Open {
    /// All of the lamp.
    pub const ALL: Self = Self(u64::MAX);

    /// Of the numbers of triangles at which some light of each cell arrives, and of those at which some does not.
    fn of([arrives, stops]: &[[u32; CELLS]; 2]) -> Self {
        let is_dark = |cell: usize| {
            let near = |k: usize| k.saturating_sub(1)..(k + 2).min(SIDE);
            let around = || near(cell / SIDE).flat_map(|s| near(cell % SIDE).map(move |t| s * SIDE + t));
            around().all(|k| arrives[k] == 0) && around().map(|k| stops[k]).sum::<u32>() >= ENOUGH
        };
        Self((0..CELLS).filter(|&cell| !is_dark(cell)).fold(0, |open, cell| open | 1 << cell))
    }

    /// Whether nothing is.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether all of the lamp is.
    pub fn is_all(self) -> bool {
        self == Self::ALL
    }

    pub fn has(self, cell: usize) -> bool {
        self.0 >> cell & 1 != 0
    }

    /// From a place of the unit square to one of the open cells, which fills them as evenly, in units of 2^-32.
    pub fn place(self, [s, t]: [u32; 2]) -> [u32; 2] {
        if self.is_all() {
            return [s, t];
        }
        let along = u64::from(s) * u64::from(self.0.count_ones());
        let mut open = self.0;
        (0..along >> 32).for_each(|_| open &= open - 1);
        in_cell(open.trailing_zeros() as usize, [along as u32, t])
    }
}

/// A place in a cell, from one of the unit square, in units of 2^-32.
fn in_cell(cell: usize, [s, t]: [u32; 2]) -> [u32; 2] {
    [(cell / SIDE, s), (cell % SIDE, t)].map(|(k, within)| (k as u32) << DIGITS | within >> (32 - DIGITS))
}

/// The middle of a cell.
pub fn middle(cell: usize) -> [u32; 2] {
    in_cell(cell, [1 << 31; 2])
}

/// The open cells of lamps for groups of receivers.
#[derive(Clone, Debug, Default)]
pub struct Guides {
    group_of: Vec<u32>,
    /// By group and lamp.
    open: HashMap<[u32; 2], Open>,
}

impl Guides {
    /// `masks`: of receivers, by their numbers, what they see of lamps, by theirs.
    pub fn new<'a>(facets: &[Facet], masks: impl Iterator<Item = (usize, usize, &'a Mask)>) -> Self {
        let (low, high) = antirad_scene::bounds(facets.iter().flat_map(|facet| facet.corners));
        let size = ((high - low).max_element() / GROUPS).max(f64::MIN_POSITIVE);
        let mut numbers = BTreeMap::new();
        let group = |facet: &Facet| {
            let place = ((facet.centroid - low) / size).floor().to_array().map(|x| x as u32);
            let count = numbers.len() as u32;
            *numbers.entry((place, side(facet.normal))).or_insert(count)
        };
        let group_of: Vec<u32> = facets.iter().map(group).collect();
        let mut counts = HashMap::<[u32; 2], [[u32; CELLS]; 2]>::new();
        for (receiver, lamp, mask) in masks.filter(|(.., mask)| !mask.is_empty()) {
            let counts = counts.entry([group_of[receiver], lamp as u32]).or_insert([[0; CELLS]; 2]);
            for (counts, bits) in counts.iter_mut().zip([mask.arrives, mask.stops]) {
                counts.iter_mut().enumerate().for_each(|(cell, count)| *count += (bits >> cell & 1) as u32);
            }
        }
        let open = counts.iter().map(|(&key, counts)| (key, Open::of(counts))).collect();
        Self { group_of, open }
    }

    /// What is open of a lamp for points of a receiver.
    pub fn open(&self, receiver: usize, lamp: usize) -> Open {
        let open = |&group: &u32| self.open.get(&[group, lamp as u32]).copied();
        self.group_of.get(receiver).and_then(open).unwrap_or(Open::ALL)
    }
}

/// The axis that a direction is closest to, and whether it goes along it.
fn side(normal: DVec3) -> (usize, bool) {
    let axis = normal.abs().max_position();
    (axis, normal[axis] > 0.0)
}

#[cfg(test)]
mod tests {
    use super::super::sampling::sobol;
    use super::*;

    /// Light that arrives through one corner: rays fill it, and what is beside it, evenly, and leave out the rest.
    #[test]
    fn rays_go_where_light_arrives() {
        let facets = [Facet::new([DVec3::ZERO, DVec3::Z, DVec3::X])];
        let mut mask = Mask::default();
        (0..CELLS).for_each(|cell| mask.add(middle(cell), cell / SIDE < 3 && cell % SIDE < 3));
        let few = Guides::new(&facets, [(0, 0, &mask)].into_iter());
        assert!(few.open(0, 0).has(CELLS / 2), "too few rays to be sure");
        let guides = Guides::new(&facets, std::iter::repeat_n((0, 0, &mask), 20));
        assert!(guides.open(0, 1).is_all() && guides.open(1, 0).is_all());
        let open = guides.open(0, 0);
        let mut counts = [0; CELLS];
        (0..1 << 10).for_each(|k| counts[cell_of(open.place(sobol(k)))] += 1);
        for (cell, count) in counts.into_iter().enumerate() {
            let is_open = cell / SIDE < 4 && cell % SIDE < 4;
            assert_eq!((open.has(cell), count), (is_open, if is_open { 1 << 6 } else { 0 }), "{cell}");
        }
    }
}
