//! Tiles: runs of triangles of one class, and what can pass between two of them.

use super::classes::Class;
use super::order::Block;
use crate::reference::Facet;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Triangle index of the slots that only fill up a tile.
pub const PADDING: u32 = u32::MAX;

/// Light can leave the fronts of the sources and arrive at fronts of the receivers.
pub const PAIR_FRONT: u32 = 1;
/// Antiradiance can leave the backs of the sources and arrive at fronts of the receivers.
pub const PAIR_BACK: u32 = 2;
/// Some pair may be so close that the near field has a share in it.
pub const PAIR_NEAR: u32 = 4;
/// Tile pairs per word of [`TilePairs::flags`].
const PER_WORD: usize = 8;

/// A run of tiles of one class. Where states live on the device, the bins of its triangles stand in one page of each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// What all triangles of it need.
    pub class: Class,
    /// Numbers of its tiles.
    pub tiles: Range<u32>,
}

impl Group {
    /// The group cut after every `step` tiles.
    pub fn parts(&self, step: u32) -> impl Iterator<Item = Self> {
        let (class, end) = (self.class, self.tiles.end);
        let cuts = self.tiles.clone().step_by(step as usize);
        cuts.map(move |begin| Self { class, tiles: begin..begin.saturating_add(step).min(end) })
    }
}

/// The order in which the engine holds the triangles.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Triangles per tile.
    pub tile: u32,
    /// Triangle of each slot, or [`PADDING`].
    pub order: Vec<u32>,
    /// Runs of tiles of one class, those without bins first.
    pub groups: Vec<Group>,
}

impl Layout {
    /// Sorts triangles by class, keeping `order` within each, and fills up the last tile of each class.
    pub fn new(order: &[u32], classes: &[Class], tile: u32, page_tiles: u32) -> Self {
        let mut present: Vec<Class> = order.iter().map(|&i| classes[i as usize]).collect();
        // Those without bins come first.
        present.sort_unstable();
        present.dedup();
        let mut layout = Self { tile, order: Vec::new(), groups: Vec::new() };
        for class in present {
            let first = layout.tiles();
            layout.order.extend(order.iter().filter(|&&i| classes[i as usize] == class));
            layout.order.resize(layout.order.len().next_multiple_of(tile as usize), PADDING);
            layout.groups.push(Group { class, tiles: first..layout.tiles() });
        }
        layout.cut(page_tiles);
        layout
    }

    /// Cuts the groups whose triangles have bins anew: at every `page_tiles`th tile from the first one with bins on.
    pub fn cut(&mut self, page_tiles: u32) {
        let mut whole: Vec<Group> = Vec::new();
        for group in self.groups.drain(..) {
            match whole.last_mut() {
                Some(last) if last.class == group.class => last.tiles.end = group.tiles.end,
                _ => whole.push(group),
            }
        }
        let first = whole.iter().find(|g| g.class.has_bins()).map_or(0, |g| g.tiles.start);
        for Group { class, tiles } in whole {
            let mut begin = tiles.start;
            while begin < tiles.end {
                let page = begin.saturating_sub(first) / page_tiles + 1;
                let next = first.saturating_add(page.saturating_mul(page_tiles));
                let end = if class.has_bins() { next.min(tiles.end) } else { tiles.end };
                self.groups.push(Group { class, tiles: begin..end });
                begin = end;
            }
        }
    }

    /// Number of slots, padding included.
    pub fn slots(&self) -> u32 {
        self.order.len() as u32
    }

    /// Number of tiles.
    pub fn tiles(&self) -> u32 {
        self.slots() / self.tile
    }

    /// The slots of some tiles.
    pub fn slots_of(&self, tiles: &Range<u32>) -> Range<u32> {
        tiles.start * self.tile..tiles.end * self.tile
    }
}

/// Bounds of a tile.
#[derive(Clone, Debug)]
pub struct Tile {
    bounds: Block,
    /// Of each triangle: normal n and height ⟨n, x⟩ of its plane.
    planes: Vec<(DVec3, f64)>,
    /// Largest extent, m².
    extent: f64,
}

impl Tile {
    fn new(facets: &[&Facet]) -> Self {
        Self {
            bounds: Block::around(facets.iter().copied()),
            planes: facets.iter().map(|f| (f.normal, f.normal.dot(f.centroid))).collect(),
            extent: facets.iter().map(|f| f.extent).fold(0.0, f64::max),
        }
    }

    /// True where a part of the box of `other` lies above (`side` = 1) or below (`side` = -1) the plane of some triangle
    /// of this tile, by more than `tolerance`.
    fn sees(&self, other: &Self, side: f64, tolerance: f64) -> bool {
        self.planes.iter().any(|&(normal, height)| {
            let farthest = -other.bounds.lowest(-side * normal);
            farthest - side * height > tolerance
        })
    }
}

/// What can pass between tiles: four bits for each pair of them.
#[derive(Clone, Debug)]
pub struct TilePairs {
    /// Words per receiver tile.
    pub row_words: u32,
    /// Rows of receivers; eight sources to a word, the lowest bits first.
    pub flags: Vec<u32>,
}

impl TilePairs {
    /// Finds what can pass. Never loses a pair whose contribution is more than rounding; with `cull` off, loses none.
    pub fn new(layout: &Layout, facets: &[Facet], half_range: f64, tolerance: f64, cull: bool) -> Self {
        let tiles: Vec<Tile> = layout
            .order
            .chunks(layout.tile as usize)
            .map(|slots| {
                let real = slots.iter().filter(|&&i| i != PADDING).map(|&i| &facets[i as usize]);
                Tile::new(&real.collect::<Vec<_>>())
            })
            .collect();
        let mut blockers = vec![false; tiles.len()];
        for group in &layout.groups {
            blockers[group.tiles.start as usize..group.tiles.end as usize].fill(group.class.blocker);
        }
        let row_words = tiles.len().div_ceil(PER_WORD);
        let pair = |receiver: &Tile, s: usize| {
            let source = &tiles[s];
            let near = source.bounds.distance_squared(&receiver.bounds)
                <= half_range * (source.extent + receiver.extent);
            let near = if near { PAIR_NEAR } else { 0 };
            let back = if blockers[s] { PAIR_BACK } else { 0 };
            if !cull {
                return PAIR_FRONT | back | near;
            }
            if !receiver.sees(source, 1.0, tolerance) {
                return 0;
            }
            let front = if source.sees(receiver, 1.0, tolerance) { PAIR_FRONT } else { 0 };
            let back = if back != 0 && source.sees(receiver, -1.0, tolerance) { back } else { 0 };
            if front | back == 0 { 0 } else { front | back | near }
        };
        let mut flags = vec![0u32; tiles.len() * row_words];
        flags.par_chunks_mut(row_words.max(1)).zip(&tiles).for_each(|(row, receiver)| {
            for s in 0..tiles.len() {
                row[s / PER_WORD] |= pair(receiver, s) << (4 * (s % PER_WORD));
            }
        });
        Self { row_words: row_words as u32, flags }
    }

    /// The bits of a pair: [`PAIR_FRONT`], [`PAIR_BACK`], [`PAIR_NEAR`].
    pub fn get(&self, receiver: u32, source: u32) -> u32 {
        let word = self.flags[(receiver * self.row_words) as usize + source as usize / PER_WORD];
        word >> (4 * (source as usize % PER_WORD)) & 15
    }

    /// True where some pair has one of these bits.
    pub fn any(&self, receivers: &Range<u32>, sources: &Range<u32>, bits: u32) -> bool {
        receivers.clone().any(|r| sources.clone().any(|s| self.get(r, s) & bits != 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cuts_fall_on_pages_and_classes_and_can_be_undone() {
        let plain = Class::default();
        let (glossy, blocker) = (Class { glossy: true, ..plain }, Class { blocker: true, ..plain });
        let classes: Vec<Class> = [(plain, 5), (glossy, 3), (blocker, 8)]
            .into_iter()
            .flat_map(|(class, tiles)| std::iter::repeat_n(class, 2 * tiles))
            .collect();
        let order: Vec<u32> = (0..classes.len() as u32).rev().collect();
        let tiles = |layout: &Layout| layout.groups.iter().map(|g| g.tiles.clone()).collect::<Vec<_>>();
        let mut layout = Layout::new(&order, &classes, 2, 100);
        assert_eq!(tiles(&layout), [0..5, 5..8, 8..16]);
        layout.cut(4);
        assert_eq!(tiles(&layout), [0..5, 5..8, 8..9, 9..13, 13..16]);
        layout.cut(u32::MAX);
        assert_eq!(tiles(&layout), [0..5, 5..8, 8..16]);
        assert_eq!(layout.groups.iter().map(|g| g.class).collect::<Vec<_>>(), [plain, glossy, blocker]);
    }
}
