//! The algebra of states. Twin of crates/core/glsl/combine.comp, dot.comp and project.comp, but that sums are in f64.

use super::real::Real;
use super::state::Vector;
use antirad_base::parallel;
use antirad_base::ranks::{RankError, Ranks};

/// Numbers that a thread processes at a time. Sums are taken per chunk, so this determines their rounding.
const CHUNK: usize = 1 << 13;
/// So many numbers take less time than to wake other threads.
const SMALL: usize = 8 * CHUNK;
/// Sums that are accumulated side by side.
const SUMS: usize = 8;

/// y = 0.
pub fn clear<T: Real>(y: &mut Vector<T>) {
    y.parts_mut().for_each(|y| fill(y, T::ZERO));
}

/// y = a everywhere.
pub fn fill<T: Real>(y: &mut [T], a: T) {
    each_chunk(y, |_, y| y.fill(a));
}

/// y = b y.
pub fn scale<T: Real>(b: f64, y: &mut Vector<T>) {
    let b = T::of(b);
    y.parts_mut().for_each(|y| drop(each_chunk(y, |_, y| y.iter_mut().for_each(|y| *y = b * *y))));
}

/// y = a x + b y. With b = 0, y may be undefined before.
pub fn combine<T: Real>((a, x): (f64, &Vector<T>), (b, y): (f64, &mut Vector<T>)) {
    let (a, b) = (T::of(a), T::of(b));
    for (x, y) in x.parts().zip(y.parts_mut()) {
        each_chunk(y, |first, y| combine_chunk((a, &x[first..]), (b, y)));
    }
}

/// y = Σ aᵢ xᵢ + y.
pub fn accumulate<T: Real>(terms: &[(f64, &Vector<T>)], y: &mut Vector<T>) {
    for (part, y) in y.parts_mut().enumerate() {
        let terms: Vec<(T, &[T])> =
            terms.iter().filter_map(|(a, x)| Some((T::of(*a), x.parts().nth(part)?))).collect();
        each_chunk(y, |first, y| {
            terms.iter().for_each(|(a, x)| combine_chunk((*a, &x[first..]), (T::ONE, y)));
        });
    }
}

/// y = a x + b y; then ⟨z, y⟩, or ⟨y, y⟩ without z, of all ranks.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn combine_dot<T: Real>(
    ranks: &Ranks,
    (a, x): (f64, &Vector<T>),
    (b, y): (f64, &mut Vector<T>),
    z: Option<&Vector<T>>,
) -> Result<f64, RankError> {
    let (a, b) = (T::of(a), T::of(b));
    let mut sum = 0.0;
    for (part, (x, y)) in x.parts().zip(y.parts_mut()).enumerate() {
        let z = z.and_then(|z| z.parts().nth(part));
        let products = each_chunk(y, |first, y| {
            combine_chunk((a, &x[first..]), (b, y));
            product(z.map_or(y, |z| &z[first..first + y.len()]), y)
        });
        sum += if counts(ranks, part) { products.into_iter().sum() } else { 0.0 };
    }
    of_all(ranks, sum)
}

/// ⟨x, y⟩ of all ranks.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn dot<T: Real>(ranks: &Ranks, x: &Vector<T>, y: &Vector<T>) -> Result<f64, RankError> {
    let parts = x.parts().zip(y.parts()).enumerate().filter(|(part, _)| counts(ranks, *part));
    of_all(ranks, parts.map(|(_, (x, y))| products(x, y)).sum())
}

/// Each rank holds its own bins; the first sums up irradiance, which is part 0.
fn counts(ranks: &Ranks, part: usize) -> bool {
    part > 0 || ranks.rank() == 0
}

fn of_all(ranks: &Ranks, own: f64) -> Result<f64, RankError> {
    Ok(ranks.each([own.to_bits()])?.into_iter().map(|[bits]| f64::from_bits(bits)).sum())
}

fn products<T: Real>(x: &[T], y: &[T]) -> f64 {
    match x.len() <= SMALL {
        true => x.chunks(CHUNK).zip(y.chunks(CHUNK)).map(|(x, y)| product(x, y)).sum(),
        false => {
            let chunks = x.chunks(CHUNK).zip(y.chunks(CHUNK));
            parallel::map(chunks, |(x, y)| product(x, y)).into_iter().sum()
        }
    }
}

/// Calls `with` with the place and the values of each chunk.
fn each_chunk<T: Real, R: Send>(y: &mut [T], with: impl Fn(usize, &mut [T]) -> R + Sync) -> Vec<R> {
    let with = |(number, y): (usize, &mut [T])| with(number * CHUNK, y);
    match y.len() <= SMALL {
        true => y.chunks_mut(CHUNK).enumerate().map(with).collect(),
        false => parallel::map(y.chunks_mut(CHUNK).enumerate(), with),
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
            *sum += Into::<f64>::into(x) * Into::<f64>::into(y);
        }
    }
    let rest = rest_x.iter().zip(rest_y).map(|(&x, &y)| Into::<f64>::into(x) * Into::<f64>::into(y));
    sums.into_iter().sum::<f64>() + rest.sum::<f64>()
}
