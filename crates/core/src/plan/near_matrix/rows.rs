//! The weights of the near field, by row: what one receiver, or one of its bins, receives from each of its close sources.

use super::blocks::Blocks;
use crate::model::{Bins, Class, ClosePair, Facet, PADDING, Piece, orthonormal_basis};
use crate::plan::{NearPairs, TileLayout};
use antirad_base::parallel;
use glam::{DMat3, DVec3};

/// Geometry that the weights depend on.
pub struct Geometry<'a> {
    pub layout: &'a TileLayout,
    pub facets: &'a [Facet],
    pub classes: &'a [Class],
    pub bins: &'a Bins,
    /// Half of `near_field`.
    pub half_range: f64,
    /// Squared distance from a plane that counts as in it, per characteristic area:
    /// [`ClosePair::coincident`].
    pub coincident: f64,
    /// Sines below this are rounding, where there is no azimuth.
    pub pole: f64,
}

/// A row of one block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// Index of the block: [`Blocks::index`].
    pub block: u32,
    /// Row within the block.
    pub index: u32,
    /// Index of the first entry of the row, and the number of entries.
    pub first: u32,
    pub length: u32,
}

/// Rows, those without entries left out, each with its entries in ascending order of the source's slot.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    pub rows: Vec<Row>,
    pub columns: Vec<u32>,
    pub weights: Vec<f64>,
}

impl Rows {
    /// The rows of some receivers, in the order of their slots, then of their bins.
    pub fn of(geometry: &Geometry, blocks: &Blocks, near: &NearPairs, receivers: &[u32]) -> Self {
        Self::by_receiver(geometry, blocks, receivers, |sums, slot, rows| sums.receiver(near, slot, rows))
    }

    /// The rows that `add` appends for each of some receivers, in their order.
    pub fn by_receiver(
        geometry: &Geometry,
        blocks: &Blocks,
        receivers: &[u32],
        add: impl Fn(&mut Sums, u32, &mut Self) + Sync,
    ) -> Self {
        let parts = parallel::map(receivers.chunks(RECEIVERS), |receivers| {
            let mut rows = Self::default();
            let mut sums = Sums::new(geometry, blocks);
            receivers.iter().for_each(|&slot| add(&mut sums, slot, &mut rows));
            rows
        });
        let mut all = Self::default();
        for mut part in parts {
            let before = all.columns.len() as u32;
            part.rows.iter_mut().for_each(|row| row.first += before);
            all.rows.append(&mut part.rows);
            all.columns.append(&mut part.columns);
            all.weights.append(&mut part.weights);
        }
        all
    }

    /// The entries of a row.
    pub fn entries<'a>(&'a self, row: &Row) -> impl Iterator<Item = (u32, f64)> + use<'a> {
        let entries = row.first as usize..(row.first + row.length) as usize;
        self.columns[entries.clone()].iter().copied().zip(self.weights[entries].iter().copied())
    }

    /// The transposed blocks: rows and columns exchanged in each.
    pub fn transposed(&self) -> Self {
        let mut by_block: Vec<&Row> = self.rows.iter().collect();
        by_block.sort_by_key(|row| row.block);
        let mut turned = Self {
            rows: Vec::new(),
            columns: vec![0; self.columns.len()],
            weights: vec![0.0; self.columns.len()],
        };
        let mut before = 0;
        for block in by_block.chunk_by(|a, b| a.block == b.block) {
            let columns = || block.iter().flat_map(|row| self.entries(row)).map(|(column, _)| column);
            let count = columns().max().map_or(0, |most| most as usize + 1);
            let mut lengths = vec![0; count];
            columns().for_each(|column| lengths[column as usize] += 1);
            let mut next = vec![0; count];
            for ((index, &length), next) in (0..).zip(&lengths).zip(&mut next) {
                *next = before as usize;
                if length > 0 {
                    turned.rows.push(Row { block: block[0].block, index, first: before, length });
                }
                before += length;
            }
            for row in block {
                for (column, weight) in self.entries(row) {
                    let at = &mut next[column as usize];
                    turned.columns[*at] = row.index;
                    turned.weights[*at] = weight;
                    *at += 1;
                }
            }
        }
        turned
    }
}

/// Receivers that a thread processes at a time.
const RECEIVERS: usize = 16;

/// Marks bins that a pair has not met.
const NONE: u32 = u32::MAX;

/// The bins that the pieces of a pair use at one end, numbered from 1 in the order of their appearance; 0 is what has
/// no direction.
struct Used {
    number: Vec<u32>,
    bins: Vec<u32>,
}

impl Used {
    fn new(bins: usize) -> Self {
        Self { number: vec![NONE; bins], bins: Vec::new() }
    }

    fn number(&mut self, bin: usize) -> u32 {
        if self.number[bin] == NONE {
            self.bins.push(bin as u32);
            self.number[bin] = self.bins.len() as u32;
        }
        self.number[bin]
    }

    fn clear(&mut self) {
        self.bins.drain(..).for_each(|bin| self.number[bin as usize] = NONE);
    }
}

/// A piece, with the bilinear weights at both ends and the numbers of their bins.
struct Tapped {
    piece: Piece,
    receiver: [(u32, f64); 4],
    source: [(u32, f64); 4],
}

/// Sums up the rows of one receiver at a time.
pub struct Sums<'a> {
    geometry: &'a Geometry<'a>,
    blocks: &'a Blocks,
    /// Entries by row of the receiver, irradiance first, and within a row by the outgoing light of the
    /// blocks.
    lists: Vec<Vec<(u32, f64)>>,
    /// The lists that have entries.
    filled: Vec<u32>,
    pieces: Vec<Tapped>,
    /// Bins of the receiver; bins of the source, of its back first, then of its front.
    rows: Used,
    columns: Used,
    /// Sums of the current pair, by row and column.
    sums: Vec<f64>,
}

impl<'a> Sums<'a> {
    pub fn new(geometry: &'a Geometry<'a>, blocks: &'a Blocks) -> Self {
        let bins = geometry.bins.count();
        Self {
            geometry,
            blocks,
            lists: vec![Vec::new(); (1 + bins) * blocks.outgoing() as usize],
            filled: Vec::new(),
            pieces: Vec::new(),
            rows: Used::new(bins),
            columns: Used::new(2 * bins),
            sums: Vec::new(),
        }
    }

    /// Appends the rows of a receiver.
    fn receiver(&mut self, near: &NearPairs, slot: u32, rows: &mut Rows) {
        let Geometry { layout, facets, classes, half_range, coincident, .. } = *self.geometry;
        let triangle = |slot: u32| layout.order[slot as usize] as usize;
        let sources = near.of(slot, &(0..layout.slots()));
        if sources.is_empty() || layout.order[slot as usize] == PADDING {
            return;
        }
        let j = triangle(slot);
        let basis = orthonormal_basis(facets[j].normal);
        for &source in sources {
            let i = triangle(source);
            let pair = ClosePair {
                source: &facets[i],
                receiver: &facets[j],
                class: classes[i],
                receiver_bins: classes[j].has_bins(),
                half_range,
                coincident,
            };
            self.pair(source, (j, &basis), |tap| pair.pieces(tap));
        }
        self.finish(slot, rows);
    }

    /// Moves the sums of a receiver to rows.
    pub fn finish(&mut self, slot: u32, rows: &mut Rows) {
        let group = self.blocks.group_of(slot);
        self.filled.sort_unstable();
        let outgoing = self.blocks.outgoing();
        for &list in &self.filled {
            let (row, from) = (list / outgoing, list % outgoing);
            let (block, index) = self.blocks.row(group, slot, row.checked_sub(1), from);
            let entries = &mut self.lists[list as usize];
            let (first, length) = (rows.columns.len() as u32, entries.len() as u32);
            rows.rows.push(Row { block, index, first, length });
            rows.columns.extend(entries.iter().map(|(column, _)| column));
            rows.weights.extend(entries.drain(..).map(|(_, weight)| weight));
        }
        self.filled.clear();
    }

    /// Adds a pair: the slot of the source, the receiver with its frame, and what calls a function with each piece.
    pub fn pair(
        &mut self,
        source: u32,
        (receiver, basis): (usize, &DMat3),
        pieces: impl FnOnce(&mut dyn FnMut(Piece)),
    ) {
        self.tap(self.geometry.layout.order[source as usize] as usize, (receiver, basis), pieces);
        self.sum_up();
        self.append(source);
    }

    /// Lists the pieces of a pair of triangles with their bilinear weights.
    fn tap(
        &mut self,
        source: usize,
        (receiver, basis): (usize, &DMat3),
        of_pair: impl FnOnce(&mut dyn FnMut(Piece)),
    ) {
        let Self { pieces, rows, columns, .. } = self;
        let Geometry { facets, classes, bins, pole, .. } = *self.geometry;
        let source = orthonormal_basis(facets[source].normal);
        let taps = |used: &mut Used, first: usize, direction: DVec3| {
            bins.taps_beside(pole, direction).map(|(bin, weight)| (used.number(first + bin), weight))
        };
        pieces.clear();
        rows.clear();
        columns.clear();
        of_pair(&mut |piece| {
            let receiver = match classes[receiver].has_bins() {
                true => taps(rows, 0, basis.transpose() * -piece.direction),
                false => [(0, 0.0); 4],
            };
            let source = match (piece.binned > 0.0, piece.front) {
                (false, _) => [(0, 0.0); 4],
                // Light that leaves the back was incident from the opposite direction.
                (true, false) => taps(columns, 0, source.transpose() * -piece.direction),
                (true, true) => taps(columns, bins.count(), source.transpose() * piece.direction),
            };
            pieces.push(Tapped { piece, receiver, source });
        });
    }

    /// Sums up the pieces of a pair by bins of both ends.
    fn sum_up(&mut self) {
        let width = 1 + self.columns.bins.len();
        self.sums.clear();
        self.sums.resize((1 + self.rows.bins.len()) * width, 0.0);
        let mut add = |(row, weight): (u32, f64), Tapped { piece, source, .. }: &Tapped| {
            let row = &mut self.sums[row as usize * width..][..width];
            row[0] += weight * piece.diffuse;
            // J is the identity on the state, and antiradiance counts negative.
            let binned = weight * if piece.front { piece.binned } else { -piece.binned };
            if binned != 0.0 {
                source.iter().for_each(|&(column, tap)| row[column as usize] += binned * tap);
            }
        };
        for tapped in &self.pieces {
            add((0, 1.0), tapped);
            if !self.rows.bins.is_empty() {
                tapped.receiver.iter().for_each(|&tap| add(tap, tapped));
            }
        }
    }

    /// Appends the sums of a pair to the lists of the receiver.
    fn append(&mut self, source: u32) {
        let bins = self.geometry.bins.count();
        let group = self.blocks.group_of(source);
        let outgoing = self.blocks.outgoing();
        let width = 1 + self.columns.bins.len();
        for (number, values) in self.sums.chunks_exact(width).enumerate() {
            let row = number.checked_sub(1).map_or(0, |n| 1 + self.rows.bins[n]);
            for (number, &weight) in values.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
                let bin = number.checked_sub(1).map(|n| self.columns.bins[n] as usize);
                let (from, column) =
                    self.blocks.column(group, source, bin.map(|bin| (bin / bins, bin % bins)));
                let list = row * outgoing + from;
                let entries = &mut self.lists[list as usize];
                if entries.is_empty() {
                    self.filled.push(list);
                }
                entries.push((column, weight));
            }
        }
    }
}
