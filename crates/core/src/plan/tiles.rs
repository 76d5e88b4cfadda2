//! Tiles of triangles of one class, 32 or 64 slots each, and the groups that they form.

use crate::model::{Class, PADDING};
use std::ops::Range;

/// A range of tiles of one class. Where states live on the device, each holds the bins of the group in one
/// page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// The class of its triangles.
    pub class: Class,
    /// Indices of its tiles.
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

/// The order of triangles in the engine.
#[derive(Clone, Debug)]
pub struct TileLayout {
    /// Triangles per tile.
    pub tile: u32,
    /// Triangle of each slot, or [`PADDING`].
    pub order: Vec<u32>,
    /// Ranges of tiles of one class, those without bins first.
    pub groups: Vec<Group>,
}

impl TileLayout {
    /// Sorts triangles by class, keeping `order` within each, and pads the last tile of each class.
    pub fn new(order: &[u32], classes: &[Class], tile: u32, page_tiles: u32) -> Self {
        let mut present: Vec<Class> = order.iter().map(|&i| classes[i as usize]).collect();
        // Classes without bins come first.
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

    /// Splits the groups with bins anew, at every `page_tiles`th tile from the first one with bins on.
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

    /// Number of slots of triangles of some classes, padding included.
    pub fn slots_where(&self, of: impl Fn(Class) -> bool) -> u32 {
        let groups = self.groups.iter().filter(|group| of(group.class));
        groups.map(|group| self.slots_of(&group.tiles).len() as u32).sum()
    }

    /// Number of tiles.
    pub fn tiles(&self) -> u32 {
        self.slots() / self.tile
    }

    /// The slots of a range of tiles.
    pub fn slots_of(&self, tiles: &Range<u32>) -> Range<u32> {
        tiles.start * self.tile..tiles.end * self.tile
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
        let tiles = |layout: &TileLayout| layout.groups.iter().map(|g| g.tiles.clone()).collect::<Vec<_>>();
        let mut layout = TileLayout::new(&order, &classes, 2, 100);
        assert_eq!(tiles(&layout), [0..5, 5..8, 8..16]);
        layout.cut(4);
        assert_eq!(tiles(&layout), [0..5, 5..8, 8..9, 9..13, 13..16]);
        layout.cut(u32::MAX);
        assert_eq!(tiles(&layout), [0..5, 5..8, 8..16]);
        assert_eq!(layout.groups.iter().map(|g| g.class).collect::<Vec<_>>(), [plain, glossy, blocker]);
    }
}
