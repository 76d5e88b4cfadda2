//! y += M x, with M a block of the near field. Twin of crates/core/glsl/near_matrix.comp.

use super::real::Real;
use crate::backend::{Cpu, Lease};
use crate::plan::{Block, NO_ROW, SLICE, SlicedMatrix};
use antirad_base::parallel;
use antirad_base::usage::OverBudget;
use std::sync::Arc;

/// So many entries take less time than to wake other threads.
const SMALL: u64 = 1 << 14;

/// Parts of a block with sums of their own, at most; entries of a part for each number of a sum, at least.
const SCATTERED: u64 = 32;
const WORTH: u64 = 2;
/// Sums that a thread adds up at a time.
const CHUNK: usize = 1 << 10;

/// The matrix from outgoing to incident light, or its transpose.
pub struct NearMatrix<T> {
    pub matrix: Arc<SlicedMatrix>,
    weights: Arc<Vec<T>>,
    /// The memory of the matrix, which the plan holds.
    _arrays: [Lease; 4],
}

impl<T: Real> NearMatrix<T> {
    pub fn new(cpu: &Cpu, matrix: &Arc<SlicedMatrix>) -> Result<Self, OverBudget> {
        let list = |label: &str, words: &[u32]| cpu.lease(label, size_of_val(words) as u64);
        Ok(Self {
            matrix: matrix.clone(),
            weights: T::weights(&matrix.weights),
            _arrays: [
                cpu.lease("near matrix: weights", matrix.weights.bytes())?,
                list("near matrix: starts", &matrix.starts)?,
                list("near matrix: rows", &matrix.rows)?,
                list("near matrix: columns", &matrix.columns)?,
            ],
        })
    }

    /// Adds the product of a block with `x` to `y`, each with the numbers of a value in memory: 4 per slot, or per bin as many as
    /// channels.
    pub fn multiply(&self, block: &Block, (x, from): (&[T], usize), (y, to): (&mut [T], usize)) {
        let sums: Vec<[[T; 3]; SLICE as usize]> = match from {
            1 => self.each_slice(block, |slice| self.sums(slice, |column| [x[column]; 3])),
            stride => {
                let light = |column: usize| [0, 1, 2].map(|channel| x[stride * column + channel]);
                self.each_slice(block, |slice| self.sums(slice, light))
            }
        };
        let rows = self.matrix.rows[(block.slices.start * SLICE) as usize..].iter();
        for (&row, sum) in rows.zip(sums.as_flattened()).filter(|(row, _)| **row != NO_ROW) {
            let own = &mut y[row as usize * to..][..to.min(3)];
            own.iter_mut().zip(sum).for_each(|(y, &sum)| *y += sum);
        }
    }

    /// Adds the product of the transpose of a block with `x` to `y`, each with 4 numbers per slot. Parts of the block have sums of their own,
    /// always the same ones, which are added in their order.
    pub fn multiply_transposed(&self, block: &Block, x: &[T], y: &mut [T]) {
        const SLOT: usize = 4;
        let slices = block.slices.clone();
        let parts = (self.matrix.entries(block) / (WORTH * y.len() as u64).max(1)).clamp(1, SCATTERED);
        let first = |part: u64| slices.start + (part * slices.len() as u64 / parts) as u32;
        let sums = parallel::map(0..parts as usize, |part| {
            let mut sums = vec![[T::ZERO; 3]; y.len() / SLOT];
            for slice in first(part as u64)..first(part as u64 + 1) {
                self.scatter(slice, x, &mut sums);
            }
            sums
        });
        parallel::each(y.chunks_mut(SLOT * CHUNK).enumerate(), |(chunk, y)| {
            for (slot, y) in y.chunks_exact_mut(SLOT).enumerate() {
                for sums in &sums {
                    let sum = sums[chunk * CHUNK + slot];
                    y.iter_mut().zip(sum).for_each(|(y, sum)| *y += sum);
                }
            }
        });
    }

    /// Adds what the rows of a slice pass back to columns.
    fn scatter(&self, slice: u32, x: &[T], sums: &mut [[T; 3]]) {
        const LANES: usize = SLICE as usize;
        let [begin, end] =
            [slice, slice + 1].map(|slice| self.matrix.starts[slice as usize] as usize * LANES);
        let rows = &self.matrix.rows[slice as usize * LANES..][..LANES];
        let of_row = |&row: &u32| match row {
            NO_ROW => [T::ZERO; 3],
            row => [0, 1, 2].map(|channel| x[4 * row as usize + channel]),
        };
        let own: Vec<[T; 3]> = rows.iter().map(of_row).collect();
        let (weights, columns) = (&self.weights[begin..end], &self.matrix.columns[begin..end]);
        for (weights, columns) in weights.chunks_exact(LANES).zip(columns.chunks_exact(LANES)) {
            for ((x, &weight), &column) in own.iter().zip(weights).zip(columns) {
                let sum = &mut sums[column as usize];
                *sum = [0, 1, 2].map(|channel| sum[channel] + weight * x[channel]);
            }
        }
    }

    fn each_slice<R: Send>(&self, block: &Block, of: impl Fn(u32) -> R + Send + Sync) -> Vec<R> {
        let slices = block.slices.clone();
        match self.matrix.entries(block) <= SMALL {
            true => slices.map(of).collect(),
            false => parallel::map(slices, of),
        }
    }

    /// The sums of the rows of a slice.
    fn sums(&self, slice: u32, light: impl Fn(usize) -> [T; 3]) -> [[T; 3]; SLICE as usize] {
        const LANES: usize = SLICE as usize;
        let [begin, end] =
            [slice, slice + 1].map(|slice| self.matrix.starts[slice as usize] as usize * LANES);
        let mut sums = [[T::ZERO; 3]; LANES];
        let (weights, columns) = (&self.weights[begin..end], &self.matrix.columns[begin..end]);
        for (weights, columns) in weights.chunks_exact(LANES).zip(columns.chunks_exact(LANES)) {
            for ((sum, &weight), &column) in sums.iter_mut().zip(weights).zip(columns) {
                let light = light(column as usize);
                *sum = [0, 1, 2].map(|channel| sum[channel] + weight * light[channel]);
            }
        }
        sums
    }
}
