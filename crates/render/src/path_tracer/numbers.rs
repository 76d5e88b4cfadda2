//! Random numbers of paths, stratified, and the mean over paths.

use super::MonteCarloEstimate;
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::SplitMix64;

/// Least number of independent repetitions of an estimate, from which its standard error follows.
const REPETITIONS: u32 = 16;
/// Most cells along a side of the unit square, so that their orders take little memory.
const MOST_CELLS: u32 = 64;
/// The first pairs of numbers of a path, which are stratified: where it starts, the point on a light, the direction from there.
const STRATIFIED: usize = 3;

/// The numbers of one path, a function of seed, pixel or triangle, repetition and path alone: paths of the same seed in scenes
/// that differ little differ little.
pub struct Numbers {
    random: SplitMix64,
    /// The cell of each stratified pair.
    cells: [u32; STRATIFIED],
    /// Cells along each side of the unit square.
    side: u32,
    drawn: usize,
}

impl Numbers {
    /// Uniform in [0, 1).
    pub fn next(&mut self) -> f64 {
        self.random.random()
    }

    /// Uniform in the unit square.
    pub fn pair(&mut self) -> [f64; 2] {
        let [u, v] = [self.next(), self.next()];
        let cell = self.cells.get(self.drawn);
        self.drawn += 1;
        cell.map_or([u, v], |&cell| {
            let side = f64::from(self.side);
            [(f64::from(cell % self.side) + u) / side, (f64::from(cell / self.side) + v) / side]
        })
    }
}

/// The random numbers of a list of numbers (SplitMix64, Steele, Lea and Flood 2014), unrelated to those of other lists.
fn sequence(numbers: &[u64]) -> SplitMix64 {
    // Each output of SplitMix64 is a mixture of all bits of its state.
    let mixed = |seed: u64| SplitMix64::seed_from_u64(seed).random::<u64>();
    SplitMix64::seed_from_u64(numbers.iter().fold(0, |seed, number| mixed(seed ^ number)))
}

/// The number of repetitions, and of cells along each side of a square: one path for each cell and repetition.
fn strata(samples: u32) -> (u32, u32) {
    let side = (samples / REPETITIONS).isqrt().clamp(1, MOST_CELLS);
    (samples.div_ceil(side * side), side)
}

/// The mean of a function of a path's numbers over at least this many paths: repetitions, independent of each other, each
/// stratified in √n x √n cells, which different pairs of numbers meet in different random orders (Cook 1986).
pub fn estimate(
    samples: u32,
    [seed, place]: [u64; 2],
    mut value: impl FnMut(&mut Numbers) -> DVec3,
) -> MonteCarloEstimate {
    let (repetitions, side) = strata(samples);
    let cells = side * side;
    let mut orders: [Vec<u32>; STRATIFIED] = std::array::from_fn(|_| (0..cells).collect());
    let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
    for repetition in 0..repetitions {
        let key = [seed, place, u64::from(repetition)];
        let mut random = sequence(&key);
        orders.iter_mut().skip(1).for_each(|order| shuffle(order, &mut random));
        let mut mean = DVec3::ZERO;
        for path in 0..cells {
            let random = sequence(&[key[0], key[1], key[2], u64::from(path) + 1]);
            let cells = std::array::from_fn(|pair| orders[pair][path as usize]);
            mean += value(&mut Numbers { random, cells, side, drawn: 0 });
        }
        mean /= f64::from(cells);
        sum += mean;
        squares += mean * mean;
    }
    let n = f64::from(repetitions);
    let mean = sum / n;
    let variance = (squares / n - mean * mean).max(DVec3::ZERO) / (n - 1.0).max(1.0);
    MonteCarloEstimate { mean, error: variance.map(f64::sqrt) }
}

/// A random order (Fisher and Yates).
fn shuffle(order: &mut [u32], random: &mut SplitMix64) {
    for k in (1..order.len()).rev() {
        order.swap(k, ((k + 1) as f64 * random.random::<f64>()) as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stratified means of a smooth function are far better than independent ones, and the standard error
    /// says so.
    #[test]
    fn strata_reduce_the_error_and_the_standard_error_tells() {
        let f = |[u, v]: [f64; 2]| (3.0 * u).sin() * v.exp();
        let truth = (1.0 - 3.0_f64.cos()) / 3.0 * (1.0_f64.exp() - 1.0);
        let (mut squares, mut claimed) = (0.0, 0.0);
        for place in 0..200 {
            // Each pair alone is as well stratified as the first.
            let found = estimate(1024, [7, place], |numbers| {
                DVec3::from_array(std::array::from_fn(|_| f(numbers.pair())))
            });
            let errors = found.mean - truth;
            squares += errors.length_squared();
            claimed += found.error.length_squared();
        }
        let independent = 600.0 * 0.4 / 1024.0;
        assert!(squares <= 0.1 * independent, "{squares}, {independent}");
        assert!((0.8..=1.25).contains(&(squares / claimed)), "{squares}, {claimed}");
    }

    /// The first numbers of SplitMix64 for the seed 1234567: traced pictures depend on the sequence, which must survive updates of
    /// crates.
    #[test]
    fn the_sequence_of_splitmix64() {
        let mut random = SplitMix64::seed_from_u64(1_234_567);
        for bits in [6_457_827_717_110_365_317_u64, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423] {
            assert_eq!(random.random::<f64>(), (bits >> 11) as f64 / (1u64 << 53) as f64);
        }
    }

    /// Neighbouring lists give unrelated sequences: their first numbers are uniform.
    #[test]
    fn sequences_of_lists_are_unrelated() {
        let first = |numbers: [u64; 2]| sequence(&numbers).random::<f64>();
        let of = |k: u64| first([k / 100, k % 100]);
        let n = 10_000;
        let mean = (0..n).map(of).sum::<f64>() / n as f64;
        let products = (1..n).map(|k| (of(k) - 0.5) * (of(k - 1) - 0.5)).sum::<f64>() / n as f64;
        // Four standard errors: 0.29 % and 0.083 %.
        assert!((mean - 0.5).abs() <= 0.0116 && products.abs() <= 0.0034, "{mean}, {products}");
        assert_ne!(first([1, 2]), first([2, 1]));
    }

    #[test]
    fn any_number_of_samples_is_served() {
        for samples in [1, 2, 15, 16, 17, 63, 64, 100, 1000, 4096] {
            let mut paths = 0;
            let found = estimate(samples, [0, 0], |numbers| {
                paths += 1;
                DVec3::splat(numbers.next())
            });
            assert!(
                paths >= samples && f64::from(paths) <= 1.2 * f64::from(samples) + 1.0,
                "{samples}: {paths}"
            );
            assert!((found.mean - 0.5).abs().max_element() <= 0.5);
        }
    }
}
