//! A sparse matrix in sliced ELLPACK (SELL-C-σ; Kreutzer, Hager, Wellein, Fehske and Bishop, SIAM J. Sci. Comput. 2014),
//! which kernels read with neighbouring lanes on neighbouring words, and whose lanes have rows of similar length.

use super::blocks::{Blocks, IncidentPart, OutgoingPart};
use super::rows::{Row, Rows};
use antirad_base::parallel;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::ops::Range;

/// Rows of a slice.
pub const SLICE: u32 = 32;
/// Index in place of a row at the end of a block's last slice.
pub const NO_ROW: u32 = u32::MAX;

/// A block: consecutive slices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// What one side of the matrix is.
    pub incident: IncidentPart,
    /// What the other side is.
    pub outgoing: OutgoingPart,
    /// The slices of the block, in descending order of their width.
    pub slices: Range<u32>,
}

/// Rows of each block in descending order of length, [`SLICE`] to a slice. A slice is as wide as its longest row; the
/// others are filled up with zeros.
#[derive(Clone, Debug, Default)]
pub struct SlicedMatrix {
    /// The blocks, in ascending order of their index.
    pub blocks: Vec<Block>,
    /// Offset of each slice, in units of [`SLICE`] entries; then the end of the last.
    pub starts: Vec<u32>,
    /// The row of each lane of each slice, or [`NO_ROW`].
    pub rows: Vec<u32>,
    /// Columns: slice after slice, in each the first of all rows, then the second.
    pub columns: Vec<u32>,
    /// Weights, in the order of `columns`.
    pub weights: Vec<f64>,
}

impl SlicedMatrix {
    /// Makes slices of the rows of some blocks, each multiplied by `factor`, a function of block and row.
    pub fn new(rows: &Rows, blocks: &Blocks, factor: impl Fn(&Row) -> f64 + Sync) -> Self {
        let mut sorted: Vec<&Row> = rows.rows.iter().collect();
        sorted.par_sort_unstable_by_key(|row| (row.block, Reverse(row.length), row.index));
        let by_block = sorted.chunk_by(|a, b| a.block == b.block);
        let slices: Vec<&[&Row]> = by_block.flat_map(|block| block.chunks(SLICE as usize)).collect();
        let mut matrix = Self { starts: vec![0], ..Self::default() };
        for (slice, at) in slices.iter().zip(0..) {
            let start = matrix.starts.last().copied().unwrap_or(0);
            matrix.starts.push(start + slice[0].length);
            let (incident, outgoing) = blocks.parts(slice[0].block);
            match matrix.blocks.last_mut() {
                Some(last) if (last.incident, last.outgoing) == (incident, outgoing) => {
                    last.slices.end = at + 1
                }
                _ => matrix.blocks.push(Block { incident, outgoing, slices: at..at + 1 }),
            }
        }
        let filled: Vec<(Vec<u32>, Vec<f64>)> = parallel::map(&slices, |slice| fill(rows, slice, &factor));
        for (slice, (columns, weights)) in slices.iter().zip(filled) {
            let indices = slice.iter().map(|row| row.index).chain(std::iter::repeat(NO_ROW));
            matrix.rows.extend(indices.take(SLICE as usize));
            matrix.columns.extend(columns);
            matrix.weights.extend(weights);
        }
        matrix
    }

    /// Renumbers the rows of each block, so that they count from `first` of the block on.
    pub fn moved(mut self, first: impl Fn(&Block) -> u32) -> Self {
        for block in &self.blocks {
            let first = first(block);
            let rows = (block.slices.start * SLICE) as usize..(block.slices.end * SLICE) as usize;
            self.rows[rows].iter_mut().filter(|row| **row != NO_ROW).for_each(|row| *row -= first);
        }
        self
    }

    /// Entries of a block, filled up.
    pub fn entries(&self, block: &Block) -> u64 {
        let steps = self.starts[block.slices.end as usize] - self.starts[block.slices.start as usize];
        u64::from(steps) * u64::from(SLICE)
    }

    /// Width of a slice.
    pub fn width(&self, slice: u32) -> u32 {
        self.starts[slice as usize + 1] - self.starts[slice as usize]
    }
}

/// Columns and weights of a slice.
fn fill(rows: &Rows, slice: &[&Row], factor: &(impl Fn(&Row) -> f64 + Sync)) -> (Vec<u32>, Vec<f64>) {
    let lanes = SLICE as usize;
    let count = slice[0].length as usize * lanes;
    let (mut columns, mut weights) = (vec![0; count], vec![0.0; count]);
    for (lane, row) in slice.iter().enumerate() {
        let factor = factor(row);
        for (k, (column, weight)) in rows.entries(row).enumerate() {
            columns[k * lanes + lane] = column;
            weights[k * lanes + lane] = factor * weight;
        }
    }
    (columns, weights)
}
