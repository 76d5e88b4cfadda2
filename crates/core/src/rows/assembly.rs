//! Rows of chunks as a sliced matrix. Chunks are given up as their rows find their places, so that both are never in memory as a whole.

use super::chunk::{Chunk, RECEIVERS};
use crate::plan::{Block, Blocks, NO_ROW, Row, SLICE, SlicedMatrix, Weights};
use antirad_base::parallel;
use antirad_scene::Precision;
use std::cmp::Reverse;
use std::sync::Arc;

/// Chunks whose rows are sorted by length together: enough that slices have few zeros.
const TOGETHER: usize = 4096 / RECEIVERS;

/// Rows of a slice, which are in one group of chunks.
struct Slice {
    group: usize,
    block: u32,
    width: u32,
    rows: Vec<Place>,
}

/// A row of a chunk of a group.
#[derive(Clone, Copy)]
struct Place {
    chunk: u32,
    row: Row,
    /// What a sum of weights counts there.
    factor: f64,
}

/// The matrix of the rows of chunks. `scale`: of a row, beside what rays count; `index`: of a row in memory.
pub fn matrix(
    chunks: Vec<Chunk>,
    blocks: &Blocks,
    precision: Precision,
    scale: impl Fn(&Row) -> f64,
    index: impl Fn(&Row) -> u32,
) -> SlicedMatrix {
    let mut slices: Vec<Slice> = Vec::new();
    for (group, chunks) in chunks.chunks(TOGETHER).enumerate() {
        let mut rows = places(chunks, &scale);
        rows.sort_unstable_by_key(|place| (place.row.block, Reverse(place.row.length), place.row.index));
        for of_block in rows.chunk_by(|a, b| a.row.block == b.row.block) {
            slices.extend(of_block.chunks(SLICE as usize).map(|rows| {
                let Row { block, length, .. } = rows[0].row;
                Slice { group, block, width: length, rows: rows.to_vec() }
            }));
        }
    }
    slices.sort_by_key(|slice| (slice.block, Reverse(slice.width)));
    let mut matrix = SlicedMatrix { starts: vec![0], ..SlicedMatrix::default() };
    for (slice, at) in slices.iter().zip(0..) {
        matrix.starts.push(matrix.starts.last().copied().unwrap_or(0) + slice.width);
        let (incident, outgoing) = blocks.parts(slice.block);
        match matrix.blocks.last_mut() {
            Some(last) if (last.incident, last.outgoing) == (incident, outgoing) => last.slices.end = at + 1,
            _ => matrix.blocks.push(Block { incident, outgoing, slices: at..at + 1 }),
        }
        let indices = slice.rows.iter().map(|place| index(&place.row)).chain(std::iter::repeat(NO_ROW));
        matrix.rows.extend(indices.take(SLICE as usize));
    }
    (matrix.columns, matrix.weights) = match precision {
        Precision::F32 => {
            let (columns, weights) = filled(chunks, &slices, |weight| weight as f32);
            (columns, Weights::F32(Arc::new(weights)))
        }
        Precision::F64 => {
            let (columns, weights) = filled(chunks, &slices, |weight| weight);
            (columns, Weights::F64(Arc::new(weights)))
        }
    };
    matrix
}

fn places(chunks: &[Chunk], scale: &impl Fn(&Row) -> f64) -> Vec<Place> {
    let mut places = Vec::new();
    for (chunk, number) in chunks.iter().zip(0..) {
        for receiver in &chunk.receivers {
            let place =
                |row: &Row| Place { chunk: number, row: *row, factor: receiver.per_ray() * scale(row) };
            places.extend(chunk.rows_of(receiver).iter().map(place));
        }
    }
    places
}

/// Columns and weights, slice after slice, filled up with zeros.
fn filled<T: Clone + Copy + Default + Send>(
    chunks: Vec<Chunk>,
    slices: &[Slice],
    weight: impl Fn(f64) -> T + Sync,
) -> (Vec<u32>, Vec<T>) {
    const LANES: usize = SLICE as usize;
    let size = |slice: &Slice| slice.width as usize * LANES;
    let count = slices.iter().map(size).sum();
    // Zeros take no memory until they are written.
    let (mut columns, mut weights) = (vec![0; count], vec![T::default(); count]);
    let (mut columns_left, mut weights_left) = (&mut columns[..], &mut weights[..]);
    let groups = chunks.len().div_ceil(TOGETHER);
    let mut of_groups: Vec<_> = (0..groups).map(|_| Vec::new()).collect();
    for slice in slices {
        let (own_columns, others) = columns_left.split_at_mut(size(slice));
        columns_left = others;
        let (own_weights, others) = weights_left.split_at_mut(size(slice));
        weights_left = others;
        of_groups[slice.group].push((slice, own_columns, own_weights));
    }
    let mut chunks = chunks.into_iter();
    for of_group in of_groups {
        let group: Vec<Chunk> = chunks.by_ref().take(TOGETHER).collect();
        parallel::each(of_group, |(slice, columns, weights)| {
            for (lane, Place { chunk, row, factor }) in slice.rows.iter().enumerate() {
                let to = columns[lane..].iter_mut().step_by(LANES);
                let to = to.zip(weights[lane..].iter_mut().step_by(LANES));
                for ((column, weight_to), (from, by)) in to.zip(group[*chunk as usize].entries(row)) {
                    *column = from;
                    *weight_to = weight(factor * f64::from(by));
                }
            }
        });
    }
    (columns, weights)
}
