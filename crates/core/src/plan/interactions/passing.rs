//! What can pass between tiles, decided for whole branches of tiles where bounds suffice.

use super::far::{FarRuns, Row};
use super::{PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
use crate::model::{Facet, Hierarchy, Node, PADDING, Sight};
use crate::plan::PlanError;
use crate::plan::TileLayout;
use antirad_base::parallel;
use glam::DVec3;

/// Determines what can pass between tiles.
pub struct Passing<'a> {
    half_range: f64,
    tolerance: f64,
    cull: bool,
    tree: &'a Hierarchy,
    /// Leaf of each tile and, for each of its triangles, the normal n and height ⟨n, x⟩ of its plane.
    tiles: Vec<(&'a Node, Vec<(DVec3, f64)>)>,
    /// Number of blocker tiles before each tile.
    blockers: Vec<u32>,
}

impl<'a> Passing<'a> {
    pub fn new(
        layout: &TileLayout,
        facets: &[Facet],
        tree: &'a Hierarchy,
        half_range: f64,
        tolerance: f64,
        cull: bool,
    ) -> Self {
        let plane = |&i: &u32| {
            let Facet { normal, centroid, .. } = facets[i as usize];
            (normal, normal.dot(centroid))
        };
        let planes = layout
            .order
            .chunks(layout.tile as usize)
            .map(|slots| slots.iter().filter(|&&i| i != PADDING).map(plane).collect());
        let tiles: Vec<_> = tree.leaf_nodes().zip(planes).collect();
        let mut blockers = vec![0];
        for group in &layout.groups {
            let before = blockers.last().copied().unwrap_or(0);
            let each = u32::from(group.class.blocker);
            blockers.extend((1..=group.tiles.len() as u32).map(|k| before + k * each));
        }
        Self { half_range, tolerance, cull, tree, tiles, blockers }
    }

    /// Finds what the source tiles can send to each receiver tile. Never omits a pair that contributes more
    /// than rounding; without culling, omits none.
    ///
    /// # Errors
    /// Fails if the runs of tiles are more than 32-bit indices can address.
    pub fn runs(&self) -> Result<FarRuns, PlanError> {
        let rows: Vec<Row> = parallel::map(0..self.tiles.len(), |receiver| self.row(receiver));
        FarRuns::new(&rows)
    }

    fn row(&self, receiver: usize) -> Row {
        let mut row = Row::default();
        self.tree.walk(|_, sources| {
            let passing = self.branch_sends(receiver, sources);
            let passing = passing.or_else(|| sources.is_leaf().then(|| self.tile_sends(receiver, sources)));
            let Some(passing) = passing else { return true };
            row.extend(sources.leaves.end as u32, passing);
            false
        });
        row
    }

    /// What each tile of a branch can send, if bounds show that it is the same for all.
    fn branch_sends(&self, receiver: usize, sources: &Node) -> Option<u32> {
        let to = self.tiles[receiver].0;
        let [before, after] = [sources.leaves.start, sources.leaves.end].map(|tile| self.blockers[tile]);
        let blockers = (after - before) as usize;
        let sight = |of: &Node, at: &Node, side: f64| match self.cull {
            true => self.tree.sight(of, &at.bounds, side, at.is_leaf()),
            false => Sight::Each,
        };
        let received = sight(to, sources, 1.0);
        if received == Sight::Nothing {
            return Some(0);
        }
        let front = sight(sources, to, 1.0);
        let back = if blockers == 0 { Sight::Nothing } else { sight(sources, to, -1.0) };
        if front == Sight::Nothing && back == Sight::Nothing {
            return Some(0);
        }
        let some_block = back != Sight::Nothing && blockers < sources.leaves.len();
        if [received, front, back].contains(&Sight::Unknown) || some_block {
            return None;
        }
        let near = self.near(to, sources);
        if near && !sources.is_leaf() {
            return None;
        }
        let bit = |sight: Sight, bit: u32| if sight == Sight::Each { bit } else { 0 };
        Some(bit(front, PAIR_FRONT) | bit(back, PAIR_BACK) | if near { PAIR_NEAR } else { 0 })
    }

    /// What one tile can send, from the planes of its triangles.
    fn tile_sends(&self, receiver: usize, source: &Node) -> u32 {
        let (to, from) = (self.tiles[receiver].0, source.leaves.start);
        let sees = |tile: usize, other: &Node, side: f64| {
            self.tiles[tile].1.iter().any(|&(normal, height)| {
                let farthest = -other.bounds.lowest(-side * normal);
                farthest - side * height > self.tolerance
            })
        };
        if !sees(receiver, source, 1.0) {
            return 0;
        }
        let blocker = self.blockers[from] < self.blockers[from + 1];
        let front = if sees(from, to, 1.0) { PAIR_FRONT } else { 0 };
        let back = if blocker && sees(from, to, -1.0) { PAIR_BACK } else { 0 };
        match front | back {
            0 => 0,
            passing => passing | if self.near(to, source) { PAIR_NEAR } else { 0 },
        }
    }

    /// Whether any pair may be within the near field.
    fn near(&self, a: &Node, b: &Node) -> bool {
        a.bounds.distance_squared(&b.bounds)
            <= self.half_range * (b.characteristic_area + a.characteristic_area)
    }
}
