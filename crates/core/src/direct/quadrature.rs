//! Quadrature over a receiver: its points are placed so that the mean is right where a penumbra crosses it.

use super::openness::Parts;
use super::sampling::Share;
use crate::model::quarters;
use glam::DVec3;

/// Barycentric coordinates and weights of seven points that integrate polynomials of degree five over a triangle exactly (J. Radon,
/// 1948).
pub const POINTS: [([f64; 3], f64); 7] = {
    const A: f64 = 0.101_286_507_323_456_34;
    const B: f64 = 0.470_142_064_105_115_1;
    const AA: f64 = 1.0 - 2.0 * A;
    const BB: f64 = 1.0 - 2.0 * B;
    const WA: f64 = 0.125_939_180_544_827_15;
    const WB: f64 = 0.132_394_152_788_506_2;
    const THIRD: f64 = 1.0 / 3.0;
    [
        ([THIRD, THIRD, THIRD], 0.225),
        ([AA, A, A], WA),
        ([A, AA, A], WA),
        ([A, A, AA], WA),
        ([BB, B, B], WB),
        ([B, BB, B], WB),
        ([B, B, BB], WB),
    ]
};

/// Error of the mean at which a cell is not cut further, as a fraction of the largest value or of what is usual.
const TOLERANCE: f64 = 5e-3;
/// Unevenness that noise alone makes in a cell, in standard errors of its values.
const NOISE: f64 = 2.0;
/// Cuts of a cell at most; each has half the length.
const DEEPEST: u32 = 5;

/// The barycentric coordinates of the corners of a cell.
type Cell = [DVec3; 3];

const WHOLE: Cell = [DVec3::X, DVec3::Y, DVec3::Z];

/// Which cells of a triangle are cut into quarters, in the order of a walk; none where the triangle is whole.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub struct Cuts(Vec<bool>);

impl Cuts {
    pub fn is_whole(&self) -> bool {
        self.0.is_empty()
    }
}

/// A point of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Barycentric coordinates.
    pub barycentric: DVec3,
    /// Share of the triangle's area that it stands for.
    pub weight: f64,
}

/// Calls `cut` with the weight and samples of each cell, which tells whether to cut it; keeps the samples of the others.
fn walk(mut cut: impl FnMut(f64, u32, &[Sample; 7]) -> bool) -> Vec<Sample> {
    let mut cells: Vec<(Cell, u32)> = vec![(WHOLE, 0)];
    let mut samples = Vec::new();
    while let Some((cell, depth)) = cells.pop() {
        let weight = 0.25_f64.powi(depth as i32);
        let own = of_cell(cell, weight);
        if cut(weight, depth, &own) {
            cells.extend(quarters(cell).map(|cell| (cell, depth + 1)));
        } else {
            samples.extend(own);
        }
    }
    samples
}

/// The samples of a cell with such a share of the triangle's area.
fn of_cell(cell: Cell, weight: f64) -> [Sample; 7] {
    POINTS.map(|(b, w)| Sample {
        barycentric: cell[0] * b[0] + cell[1] * b[1] + cell[2] * b[2],
        weight: weight * w,
    })
}

/// The mean of a function over a triangle. Cells are cut where the samples say that the function is not smooth, unless it is far below
/// the value that is `usual` on other triangles, to which errors are compared then. They are cut `least` times in any case.
pub fn mean(
    usual: f64,
    least: u32,
    parts: Option<&Parts>,
    function: &mut dyn FnMut(DVec3) -> f64,
) -> (f64, Cuts) {
    let (mut kept, mut largest) = (Vec::new(), usual);
    let mut cuts = Vec::new();
    walk(|weight, depth, samples| {
        let values = samples.map(|sample| function(sample.barycentric));
        largest = values.iter().fold(largest, |largest, value| largest.max(value.abs()));
        let uneven = || depth < DEEPEST && error(&values) * weight.sqrt() > TOLERANCE * largest;
        let cut = depth < least || uneven();
        if !cut {
            kept.extend(samples.iter().copied().zip(values));
        }
        cuts.push(cut);
        cut
    });
    // In the order of `samples`: with the same cuts, means are the same to the last bit.
    let (mut samples, values): (Vec<Sample>, Vec<f64>) = kept.into_iter().unzip();
    weigh(&mut samples, parts);
    let sum = samples.iter().zip(values).map(|(sample, value)| sample.weight * value).sum();
    (sum, if cuts.len() > 1 { Cuts(cuts) } else { Cuts::default() })
}

/// What functions are at points, by number and barycentric coordinates, with standard errors, where cells have such a share of the length
/// of their triangles.
pub type Values<'a, E> = dyn FnMut(&[(usize, DVec3)], f64) -> Result<Vec<Share>, E> + 'a;

/// A cell of one of several triangles: the values of its samples, and where the cells begin that it is cut into.
struct Known {
    values: [Share; 7],
    quarters: Option<usize>,
}

/// The means of functions over triangles, as [`mean`] finds them, but with all values of one depth asked for at once, and noise does not
/// count as unevenness. `usual`: that of each function; `parts`: the weights of the parts of its triangle.
pub fn means<'a, E>(
    usual: &[f64],
    parts: impl Fn(usize) -> Option<&'a Parts>,
    values: &mut Values<E>,
) -> Result<Vec<(Share, Cuts)>, E> {
    let mut largest = usual.to_vec();
    let mut cells: Vec<(usize, Cell)> = (0..usual.len()).map(|function| (function, WHOLE)).collect();
    let mut known: Vec<Known> = Vec::new();
    for depth in 0..=DEEPEST {
        let samples = |&(function, cell): &(usize, Cell)| {
            of_cell(cell, 1.0).map(|sample| (function, sample.barycentric))
        };
        let width = 0.5_f64.powi(depth as i32);
        let found = values(&cells.iter().flat_map(samples).collect::<Vec<_>>(), width)?;
        let (found, _) = found.as_chunks::<7>();
        for ((function, _), values) in cells.iter().zip(found) {
            let most = values.iter().map(|share| share.value.abs());
            largest[*function] = most.fold(largest[*function], f64::max);
        }
        let mut finer = Vec::new();
        let after = known.len() + cells.len();
        for (&(function, cell), &values) in cells.iter().zip(found) {
            let variance = values.iter().map(|share| share.error * share.error).sum::<f64>() / 7.0;
            let error = error(&values.map(|share| share.value)) - NOISE * variance.sqrt();
            let cut = depth < DEEPEST && error * width > TOLERANCE * largest[function];
            known.push(Known { values, quarters: cut.then_some(after + finer.len()) });
            if cut {
                finer.extend(quarters(cell).map(|cell| (function, cell)));
            }
        }
        cells = finer;
        if cells.is_empty() {
            break;
        }
    }
    Ok((0..usual.len()).map(|root| gathered(&known, root, parts(root))).collect())
}

/// The mean of the function whose whole triangle is the cell `root`.
fn gathered(known: &[Known], root: usize, parts: Option<&Parts>) -> (Share, Cuts) {
    let mut cells = vec![root];
    let mut cuts = Vec::new();
    let mut shares: Vec<Share> = Vec::new();
    let mut samples = walk(|_, _, _| {
        let Some(Known { values, quarters }) = cells.pop().and_then(|cell| known.get(cell)) else {
            return false;
        };
        cuts.push(quarters.is_some());
        match quarters {
            Some(first) => cells.extend(*first..first + 4),
            None => shares.extend(values),
        }
        quarters.is_some()
    });
    weigh(&mut samples, parts);
    let of = || samples.iter().zip(&shares);
    let mean = of().map(|(of, share)| of.weight * share.value).sum();
    let variance: f64 = of().map(|(of, share)| (of.weight * share.error).powi(2)).sum();
    (Share { value: mean, error: variance.sqrt() }, if cuts.len() > 1 { Cuts(cuts) } else { Cuts::default() })
}

/// The samples of a triangle with given cuts, and weights of its parts.
pub fn samples(cuts: &Cuts, parts: Option<&Parts>) -> Vec<Sample> {
    let mut cuts = cuts.0.iter();
    let mut samples = walk(|_, _, _| cuts.next().is_some_and(|cut| *cut));
    weigh(&mut samples, parts);
    samples
}

/// Multiplies samples by the weights of the parts that they lie in, and keeps their sum.
fn weigh(samples: &mut [Sample], parts: Option<&Parts>) {
    let Some(parts) = parts else { return };
    samples.iter_mut().for_each(|sample| sample.weight *= parts.weight(sample.barycentric));
    let sum: f64 = samples.iter().map(|sample| sample.weight).sum();
    samples.iter_mut().for_each(|sample| sample.weight /= sum);
}

/// The largest difference of the mean from those that the two triples of points and the centroid give, which are exact for polynomials
/// of degree one.
fn error(values: &[f64; 7]) -> f64 {
    let mean: f64 = POINTS.iter().zip(values).map(|((_, w), v)| w * v).sum();
    let triple = |from: usize| (values[from] + values[from + 1] + values[from + 2]) / 3.0;
    (triple(1) - mean).abs().max((triple(4) - mean).abs()).max((values[0] - mean).abs())
}
