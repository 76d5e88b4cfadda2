//! Where a receiver is sampled, so that the mean over it is right where a penumbra crosses it.

use crate::model::quarters;
use glam::DVec3;

/// Barycentric coordinates and weights of seven points that integrate polynomials of degree five over a triangle exactly (J. Radon,
/// 1948).
const POINTS: [([f64; 3], f64); 7] = {
    const A: f64 = 0.101_286_507_323_456_34;
    const B: f64 = 0.470_142_064_105_115_1;
    const AA: f64 = 1.0 - 2.0 * A;
    const BB: f64 = 1.0 - 2.0 * B;
    const WA: f64 = 0.125_939_180_544_827_15;
    const WB: f64 = 0.132_394_152_788_506_18;
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

/// Error of the mean at which a cell is not cut further, as a fraction of the largest value.
const TOLERANCE: f64 = 2e-3;
/// Each cut has half the length.
const DEEPEST: u32 = 5;

/// The mean of a function over a triangle; `function` takes a point and its weight. Cells in which it is not smooth are cut into quarters.
pub struct Quadrature {
    tolerance: f64,
    deepest: u32,
}

impl Default for Quadrature {
    fn default() -> Self {
        Self { tolerance: TOLERANCE, deepest: DEEPEST }
    }
}

/// The barycentric coordinates of the corners of a cell.
type Cell = [DVec3; 3];

const WHOLE: Cell = [DVec3::X, DVec3::Y, DVec3::Z];

/// A point of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub barycentric: DVec3,
    /// Share of the triangle's area that it stands for.
    pub weight: f64,
}

impl Quadrature {
    /// Every cell cut `depth` times: the points do not depend on the function.
    pub fn uniform(depth: u32) -> Self {
        Self { tolerance: 0.0, deepest: depth }
    }

    /// The samples of a triangle, and the values that `function` has there. Cells are cut where the samples say that it is not smooth.
    pub fn samples(&self, function: &mut dyn FnMut(DVec3) -> f64) -> Vec<(Sample, f64)> {
        let mut cells: Vec<(Cell, u32)> = vec![(WHOLE, 0)];
        let mut samples = Vec::new();
        let mut largest = 0.0_f64;
        while let Some((cell, depth)) = cells.pop() {
            let weight = 0.25_f64.powi(depth as i32);
            let values = POINTS.map(|(b, w)| {
                let barycentric = cell[0] * b[0] + cell[1] * b[1] + cell[2] * b[2];
                (Sample { barycentric, weight: weight * w }, function(barycentric))
            });
            largest = values.iter().fold(largest, |largest, (_, value)| largest.max(value.abs()));
            let cut = depth < self.deepest
                && (self.tolerance == 0.0
                    || error(&values.map(|(_, value)| value)) * weight.sqrt() > self.tolerance * largest);
            if cut {
                cells.extend(quarters(cell).map(|cell| (cell, depth + 1)));
            } else {
                samples.extend(values);
            }
        }
        samples
    }
}

/// The largest difference of the mean from those that the two triples of points give, which are exact for polynomials of degree one.
fn error(values: &[f64; 7]) -> f64 {
    let mean: f64 = POINTS.iter().zip(values).map(|((_, w), v)| w * v).sum();
    let triple = |from: usize| (values[from] + values[from + 1] + values[from + 2]) / 3.0;
    (triple(1) - mean).abs().max((triple(4) - mean).abs()).max((values[0] - mean).abs())
}
