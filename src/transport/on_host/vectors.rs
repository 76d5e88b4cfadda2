//! The algebra of states. Twin of glsl/combine.comp, dot.comp and project.comp, but that sums are in f64.

use super::on_threads;
use super::real::Real;
use crate::gpu::{BufferSlice, Device, GpuError};
use crate::scene::Precision;
use rayon::prelude::*;

/// Numbers that a thread processes at a time. Sums are taken per chunk, so this determines their rounding.
const CHUNK: usize = 1 << 13;
/// So many numbers take less time than to wake other threads.
const SMALL: usize = 8 * CHUNK;
/// Sums that are accumulated side by side.
const SUMS: usize = 8;

/// y = b y.
pub fn scale(device: &Device, precision: Precision, b: f64, y: BufferSlice) -> Result<Option<()>, GpuError> {
    match precision {
        Precision::F32 => device.edit_on_host([y], [], |[y], []| scaled(b as f32, y)),
        Precision::F64 => device.edit_on_host([y], [], |[y], []| scaled(b, y)),
    }
}

/// y = a x + b y. With b = 0, y may be undefined before.
pub fn combine(
    device: &Device,
    precision: Precision,
    (a, x): (f64, BufferSlice),
    (b, y): (f64, BufferSlice),
) -> Result<Option<()>, GpuError> {
    match precision {
        Precision::F32 => device.edit_on_host([y], [x], |[y], [x]| combined((a as f32, x), (b as f32, y))),
        Precision::F64 => device.edit_on_host([y], [x], |[y], [x]| combined((a, x), (b, y))),
    }
}

/// The same; then ⟨z, y⟩, or ⟨y, y⟩ without z.
pub fn combine_dot(
    device: &Device,
    precision: Precision,
    (a, x): (f64, BufferSlice),
    (b, y): (f64, BufferSlice),
    z: Option<BufferSlice>,
) -> Result<Option<f64>, GpuError> {
    let others = [x, z.unwrap_or(x)];
    let given = z.is_some();
    match precision {
        Precision::F32 => device.edit_on_host([y], others, |[y], [x, z]| {
            combined_product((a as f32, x), (b as f32, y), given.then_some(z))
        }),
        Precision::F64 => device
            .edit_on_host([y], others, |[y], [x, z]| combined_product((a, x), (b, y), given.then_some(z))),
    }
}

/// ⟨x, y⟩.
pub fn dot(
    device: &Device,
    precision: Precision,
    x: BufferSlice,
    y: BufferSlice,
) -> Result<Option<f64>, GpuError> {
    match precision {
        Precision::F32 => device.read_on_host([x, y], products::<f32>),
        Precision::F64 => device.read_on_host([x, y], products::<f64>),
    }
}

fn scaled<T: Real>(b: T, y: &mut [T]) {
    each_chunk(y, |_, y| y.iter_mut().for_each(|y| *y = b * *y));
}

fn combined<T: Real>((a, x): (T, &[T]), (b, y): (T, &mut [T])) {
    each_chunk(y, |first, y| combine_chunk((a, &x[first..]), (b, y)));
}

fn combined_product<T: Real>((a, x): (T, &[T]), (b, y): (T, &mut [T]), z: Option<&[T]>) -> f64 {
    let products = each_chunk(y, |first, y| {
        combine_chunk((a, &x[first..]), (b, y));
        product(z.map_or(y, |z| &z[first..first + y.len()]), y)
    });
    products.into_iter().sum()
}

fn products<T: Real>([x, y]: [&[T]; 2]) -> f64 {
    match x.len() <= SMALL {
        true => x.chunks(CHUNK).zip(y.chunks(CHUNK)).map(|(x, y)| product(x, y)).sum(),
        false => {
            let chunks = x.par_chunks(CHUNK).zip(y.par_chunks(CHUNK));
            on_threads(|| chunks.map(|(x, y)| product(x, y)).collect::<Vec<f64>>()).into_iter().sum()
        }
    }
}

/// Calls `with` with the place and the values of each chunk.
fn each_chunk<T: Real, R: Send>(y: &mut [T], with: impl Fn(usize, &mut [T]) -> R + Sync) -> Vec<R> {
    let with = |(number, y): (usize, &mut [T])| with(number * CHUNK, y);
    match y.len() <= SMALL {
        true => y.chunks_mut(CHUNK).enumerate().map(with).collect(),
        false => on_threads(|| y.par_chunks_mut(CHUNK).enumerate().map(with).collect()),
    }
}

fn combine_chunk<T: Real>((a, x): (T, &[T]), (b, y): (T, &mut [T])) {
    match b == T::ZERO {
        true => y.iter_mut().zip(x).for_each(|(y, x)| *y = a * *x),
        false => y.iter_mut().zip(x).for_each(|(y, x)| *y = a * *x + b * *y),
    }
}

/// Σ x y in f64.
fn product<T: Real>(x: &[T], y: &[T]) -> f64 {
    let mut sums = [0.0; SUMS];
    let ((x, rest_x), (y, rest_y)) = (x.as_chunks::<SUMS>(), y.as_chunks::<SUMS>());
    for (x, y) in x.iter().zip(y) {
        for ((sum, &x), &y) in sums.iter_mut().zip(x).zip(y) {
            *sum += x.into() * y.into();
        }
    }
    let rest: f64 = rest_x.iter().zip(rest_y).map(|(&x, &y)| x.into() * y.into()).sum();
    sums.into_iter().sum::<f64>() + rest
}
