//! Quadrature over a receiver: its points are placed so that the mean is right where a penumbra crosses it.

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
        let of_cell = POINTS.map(|(b, w)| Sample {
            barycentric: cell[0] * b[0] + cell[1] * b[1] + cell[2] * b[2],
            weight: weight * w,
        });
        if cut(weight, depth, &of_cell) {
            cells.extend(quarters(cell).map(|cell| (cell, depth + 1)));
        } else {
            samples.extend(of_cell);
        }
    }
    samples
}

/// The mean of a function over a triangle. Cells are cut where the samples say that the function is not smooth, unless it is far below
/// the value that is `usual` on other triangles, to which errors are compared then. They are cut `least` times in any case.
pub fn mean(usual: f64, least: u32, function: &mut dyn FnMut(DVec3) -> f64) -> (f64, Cuts) {
    let (mut kept, mut largest) = (Vec::new(), usual);
    let mut cuts = Vec::new();
    walk(|weight, depth, samples| {
        let values = samples.map(|sample| function(sample.barycentric));
        largest = values.iter().fold(largest, |largest, value| largest.max(value.abs()));
        let uneven = || depth < DEEPEST && error(&values) * weight.sqrt() > TOLERANCE * largest;
        let cut = depth < least || uneven();
        if !cut {
            kept.extend(samples.iter().zip(values).map(|(sample, value)| sample.weight * value));
        }
        cuts.push(cut);
        cut
    });
    // In the order of `samples`: with the same cuts, means are the same to the last bit.
    (kept.iter().sum(), if cuts.len() > 1 { Cuts(cuts) } else { Cuts::default() })
}

/// The samples of a triangle with given cuts.
pub fn samples(cuts: &Cuts) -> Vec<Sample> {
    let mut cuts = cuts.0.iter();
    walk(|_, _, _| cuts.next().is_some_and(|cut| *cut))
}

/// The largest difference of the mean from those that the two triples of points and the centroid give, which are exact for polynomials
/// of degree one.
fn error(values: &[f64; 7]) -> f64 {
    let mean: f64 = POINTS.iter().zip(values).map(|((_, w), v)| w * v).sum();
    let triple = |from: usize| (values[from] + values[from + 1] + values[from + 2]) / 3.0;
    (triple(1) - mean).abs().max((triple(4) - mean).abs()).max((values[0] - mean).abs())
}
