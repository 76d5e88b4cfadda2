//! y += M x, with M a block of the near field. Twin of glsl/near_matrix.comp.

use super::on_threads;
use super::real::Real;
use crate::gpu::{BufferSlice, Device, GpuError};
use crate::plan::{Block, NO_ROW, SLICE, SlicedMatrix};
use crate::scene::Precision;
use rayon::prelude::*;

/// Slices that a thread takes at a time, at least.
const SLICES: usize = 8;

/// So many entries take less time than to wake other threads.
const SMALL: u64 = 1 << 14;

/// One side of a product.
#[derive(Clone, Copy)]
pub struct Side<'a> {
    /// Its values.
    pub values: BufferSlice<'a>,
    /// Numbers of a value in memory: 4 per slot, or per bin as many as channels.
    pub stride: usize,
}

/// The product with a block whose `weights` are on the device.
pub fn multiply(
    device: &Device,
    precision: Precision,
    (matrix, block): (&SlicedMatrix, &Block),
    weights: BufferSlice,
    from: Side,
    to: Side,
) -> Result<Option<()>, GpuError> {
    let (others, strides) = ([weights, from.values], [from.stride, to.stride]);
    match precision {
        Precision::F32 => device.edit_on_host([to.values], others, |[y], [weights, x]| {
            added::<f32>((matrix, block), weights, strides, x, y)
        }),
        Precision::F64 => device.edit_on_host([to.values], others, |[y], [weights, x]| {
            added::<f64>((matrix, block), weights, strides, x, y)
        }),
    }
}

fn added<T: Real>(
    (matrix, block): (&SlicedMatrix, &Block),
    weights: &[T],
    [from, to]: [usize; 2],
    x: &[T],
    y: &mut [T],
) {
    let sums: Vec<[[T; 3]; SLICE as usize]> = match from {
        1 => each_slice(matrix, block, |slice| sums(matrix, slice, weights, |column| [x[column]; 3])),
        stride => {
            let light = |column: usize| [0, 1, 2].map(|channel| x[stride * column + channel]);
            each_slice(matrix, block, |slice| sums(matrix, slice, weights, light))
        }
    };
    let rows = matrix.rows[(block.slices.start * SLICE) as usize..].iter();
    for (&row, sum) in rows.zip(sums.as_flattened()).filter(|(row, _)| **row != NO_ROW) {
        let own = &mut y[row as usize * to..][..to.min(3)];
        own.iter_mut().zip(sum).for_each(|(y, &sum)| *y += sum);
    }
}

fn each_slice<R: Send>(matrix: &SlicedMatrix, block: &Block, of: impl Fn(u32) -> R + Send + Sync) -> Vec<R> {
    let slices = block.slices.clone();
    match matrix.entries(block) <= SMALL {
        true => slices.map(of).collect(),
        false => on_threads(|| slices.into_par_iter().with_min_len(SLICES).map(of).collect()),
    }
}

/// The sums of the rows of a slice.
fn sums<T: Real>(
    matrix: &SlicedMatrix,
    slice: u32,
    weights: &[T],
    light: impl Fn(usize) -> [T; 3],
) -> [[T; 3]; SLICE as usize] {
    const LANES: usize = SLICE as usize;
    let [begin, end] = [slice, slice + 1].map(|slice| matrix.starts[slice as usize] as usize * LANES);
    let mut sums = [[T::ZERO; 3]; LANES];
    let (weights, columns) = (&weights[begin..end], &matrix.columns[begin..end]);
    for (weights, columns) in weights.chunks_exact(LANES).zip(columns.chunks_exact(LANES)) {
        for ((sum, &weight), &column) in sums.iter_mut().zip(weights).zip(columns) {
            let light = light(column as usize);
            *sum = [0, 1, 2].map(|channel| sum[channel] + weight * light[channel]);
        }
    }
    sums
}
