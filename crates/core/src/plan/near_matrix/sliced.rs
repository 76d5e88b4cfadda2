//! A sparse matrix in sliced ELLPACK (SELL-C-σ; Kreutzer, Hager, Wellein, Fehske and Bishop, SIAM J. Sci. Comput. 2014),
//! which kernels read with neighbouring lanes on neighbouring words, and whose lanes have rows of similar length.

use super::blocks::{Blocks, IncidentPart, OutgoingPart};
use super::rows::{Row, Rows};
use antirad_base::parallel;
use antirad_scene::Precision;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::ops::Range;
use std::sync::Arc;

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
    pub weights: Weights,
}

/// Weights in the precision of operators, which the CPU reads in place.
#[derive(Clone, Debug)]
pub enum Weights {
    /// Single precision.
    F32(Arc<Vec<f32>>),
    /// Double precision.
    F64(Arc<Vec<f64>>),
}

impl Default for Weights {
    fn default() -> Self {
        Self::F32(Arc::default())
    }
}

impl Weights {
    /// Bytes of all weights.
    pub fn bytes(&self) -> u64 {
        match self {
            Self::F32(weights) => size_of_val(&weights[..]) as u64,
            Self::F64(weights) => size_of_val(&weights[..]) as u64,
        }
    }

    /// How many there are, without those that fill up slices.
    pub fn count(&self) -> u64 {
        match self {
            Self::F32(weights) => weights.iter().filter(|weight| **weight != 0.0).count() as u64,
            Self::F64(weights) => weights.iter().filter(|weight| **weight != 0.0).count() as u64,
        }
    }

    /// The weights as numbers in memory.
    pub fn as_bytes(&self) -> &[u8] {
        match self {
            Self::F32(weights) => bytemuck::cast_slice(&weights[..]),
            Self::F64(weights) => bytemuck::cast_slice(&weights[..]),
        }
    }
}

impl Block {
    /// Whether it connects diffuse radiance with irradiance.
    pub fn is_diffuse(&self) -> bool {
        (self.incident, self.outgoing) == (IncidentPart::Irradiance, OutgoingPart::Diffuse)
    }
}

impl SlicedMatrix {
    /// Makes slices of the rows of some blocks, each multiplied by `factor`, a function of block and row.
    pub fn new(
        rows: &Rows,
        blocks: &Blocks,
        precision: Precision,
        factor: impl Fn(&Row) -> f64 + Sync,
    ) -> Self {
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
        for slice in &slices {
            let indices = slice.iter().map(|row| row.index).chain(std::iter::repeat(NO_ROW));
            matrix.rows.extend(indices.take(SLICE as usize));
        }
        let columns = |row: &Row| rows.entries(row).map(|(column, _)| column);
        matrix.columns = filled(&slices, columns);
        let weights = |row: &Row| {
            let factor = factor(row);
            rows.entries(row).map(move |(_, weight)| factor * weight)
        };
        matrix.weights = match precision {
            Precision::F32 => {
                Weights::F32(Arc::new(filled(&slices, |row| weights(row).map(|weight| weight as f32))))
            }
            Precision::F64 => Weights::F64(Arc::new(filled(&slices, weights))),
        };
        matrix
    }

    /// The transposed blocks that are `wanted`, of those columns that are `own`; each row is multiplied by `factor`.
    pub fn transposed(
        &self,
        wanted: impl Fn(&Block) -> bool,
        factor: impl Fn(&Block, u32) -> f64,
        own: impl Fn(&Block, u32) -> bool,
    ) -> Self {
        let mut turned = Self { starts: vec![0], ..Self::default() };
        // Of each entry its place in the transposed matrix.
        let mut sources = Vec::new();
        for block in self.blocks.iter().filter(|block| wanted(block)) {
            let mut lengths: Vec<u32> = Vec::new();
            self.each_entry(block, |_, column, _| {
                let column = column as usize;
                lengths.resize(lengths.len().max(column + 1), 0);
                lengths[column] += 1;
            });
            let mut columns: Vec<u32> = (0..lengths.len() as u32).collect();
            columns.retain(|&column| lengths[column as usize] > 0 && own(block, column));
            columns.sort_unstable_by_key(|&column| (Reverse(lengths[column as usize]), column));
            let first = turned.starts.len() as u32 - 1;
            // Where the next entry of each column goes.
            let mut next = vec![usize::MAX; lengths.len()];
            for slice in columns.chunks(SLICE as usize) {
                let start = turned.starts.last().copied().unwrap_or(0);
                for (lane, &column) in slice.iter().enumerate() {
                    next[column as usize] = (start * SLICE) as usize + lane;
                }
                turned.starts.push(start + lengths[slice[0] as usize]);
                let rows = slice.iter().copied().chain(std::iter::repeat(NO_ROW));
                turned.rows.extend(rows.take(SLICE as usize));
            }
            let slices = first..turned.starts.len() as u32 - 1;
            turned.blocks.push(Block { slices, ..block.clone() });
            sources.push((block, next));
        }
        let count = turned.starts.last().map_or(0, |&end| end as usize * SLICE as usize);
        turned.columns = vec![0; count];
        turned.weights = match &self.weights {
            Weights::F32(from) => Weights::F32(Arc::new(self.turned(
                sources,
                &mut turned.columns,
                |at, by| (f64::from(from[at]) * by) as f32,
                factor,
            ))),
            Weights::F64(from) => Weights::F64(Arc::new(self.turned(
                sources,
                &mut turned.columns,
                |at, by| from[at] * by,
                factor,
            ))),
        };
        turned
    }

    /// The weights of transposed blocks, and their columns. `next`: where the first entry of each column of a block goes.
    fn turned<T: Clone + Default>(
        &self,
        blocks: Vec<(&Block, Vec<usize>)>,
        columns: &mut [u32],
        weight: impl Fn(usize, f64) -> T,
        factor: impl Fn(&Block, u32) -> f64,
    ) -> Vec<T> {
        let mut weights = vec![T::default(); columns.len()];
        for (block, mut next) in blocks {
            self.each_entry(block, |row, column, at| {
                let next = &mut next[column as usize];
                if *next != usize::MAX {
                    columns[*next] = row;
                    weights[*next] = weight(at, factor(block, row));
                    *next += SLICE as usize;
                }
            });
        }
        weights
    }

    /// Calls `call` with the row, the column and the place of each entry of a block that does not fill up a slice.
    fn each_entry(&self, block: &Block, mut call: impl FnMut(u32, u32, usize)) {
        let is_zero = |at: usize| match &self.weights {
            Weights::F32(weights) => weights[at] == 0.0,
            Weights::F64(weights) => weights[at] == 0.0,
        };
        for slice in block.slices.clone() {
            let entries = self.starts[slice as usize] * SLICE..self.starts[slice as usize + 1] * SLICE;
            let rows = &self.rows[(slice * SLICE) as usize..][..SLICE as usize];
            for (at, row) in entries.zip(rows.iter().cycle()).map(|(at, &row)| (at as usize, row)) {
                if row != NO_ROW && !is_zero(at) {
                    call(row, self.columns[at], at);
                }
            }
        }
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

/// The values of the entries of each row, slice after slice, filled up with zeros.
fn filled<T, I>(slices: &[&[&Row]], values: impl Fn(&Row) -> I + Sync) -> Vec<T>
where
    T: Clone + Default + Send,
    I: Iterator<Item = T>,
{
    const LANES: usize = SLICE as usize;
    let count = |slice: &[&Row]| slice[0].length as usize * LANES;
    let mut all = vec![T::default(); slices.iter().map(|slice| count(slice)).sum()];
    let mut rest = &mut all[..];
    let mut parts = Vec::with_capacity(slices.len());
    for slice in slices {
        let (own, others) = rest.split_at_mut(count(slice));
        parts.push(own);
        rest = others;
    }
    parallel::each(slices.iter().zip(parts), |(slice, to)| {
        for (lane, row) in slice.iter().enumerate() {
            to[lane..].iter_mut().step_by(LANES).zip(values(row)).for_each(|(to, value)| *to = value);
        }
    });
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(index: u32, first: u32, length: u32) -> Row {
        Row { block: 0, index, first, length }
    }

    #[test]
    fn slices_hold_one_entry_of_each_row_after_the_other() {
        let rows = [row(7, 0, 2), row(4, 2, 1)];
        let slice: Vec<&Row> = rows.iter().collect();
        let values = |row: &Row| (row.first..row.first + row.length).map(|at| at + 1);
        let all: Vec<u32> = filled(&[&slice], values);
        let mut expected = [0; 2 * SLICE as usize];
        (expected[0], expected[1], expected[SLICE as usize]) = (1, 3, 2);
        assert_eq!(all, expected);
    }
}
