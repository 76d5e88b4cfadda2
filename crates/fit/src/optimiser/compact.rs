//! The compact limited-memory BFGS Hessian B = D - W M Wᵀ, from the latest steps s and gradient differences y (Byrd,
//! Nocedal and Schnabel 1994).
//!
//! D is diagonal and updated in every step (Gilbert and Lemaréchal 1989). The unknowns of a fit differ widely in influence,
//! such as a visible lamp and a dark corner; the usual multiple of the identity takes several times as many steps.

use super::dot;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// Entries of D are at least this fraction of the largest.
const LEAST_SHARE: f64 = 1e-12;

/// Curvatures of a given Hessian are at least this fraction of the largest: what pictures do not show has none.
const LEAST_CURVATURE: f64 = 1e-7;

/// Entries of a given diagonal that are unknown, as a share of the mean of the others: what no picture shows acts by the light
/// that it reflects.
const UNKNOWN: f64 = 1e-2;

/// Pairs (s, y), the oldest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Memory {
    pub s: Vec<Vec<f64>>,
    pub y: Vec<Vec<f64>>,
    /// D, the initial Hessian.
    pub diagonal: Vec<f64>,
    /// Number of pairs, the oldest ones, that come from a given Hessian.
    given: usize,
    /// Whether D is known from the start.
    informed: bool,
}

/// W = [Y, D S] and M, for products.
pub(super) struct Compact<'a> {
    memory: &'a Memory,
    /// D S.
    scaled: Vec<Vec<f64>>,
    middle: DMatrix<f64>,
}

impl Memory {
    pub fn new(unknowns: usize) -> Self {
        Self { s: Vec::new(), y: Vec::new(), diagonal: vec![1.0; unknowns], given: 0, informed: false }
    }

    /// Whether nothing is known of the Hessian.
    pub fn is_blank(&self) -> bool {
        self.s.is_empty() && !self.informed
    }

    /// A memory with a given diagonal, whose entries of 0 are unknown; see [`Self::of_hessian`] for `longest`. `None` if nothing is
    /// known, or an entry is not finite.
    pub fn of_diagonal(diagonal: &[f64], gradient: &[f64], longest: f64) -> Option<Self> {
        let known: Vec<f64> = diagonal.iter().copied().filter(|d| *d > 0.0).collect();
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        if diagonal.len() != gradient.len() || !mean.is_finite() {
            return None;
        }
        let entry = |(d, g): (&f64, &f64)| {
            let d = if *d > 0.0 { *d } else { UNKNOWN * mean };
            d.max(LEAST_CURVATURE * mean).max(g.abs() / longest)
        };
        let diagonal = diagonal.iter().zip(gradient).map(entry).collect();
        Some(Self { diagonal, informed: true, ..Self::new(gradient.len()) })
    }

    /// A memory whose model has the given Hessian (row by row): its eigenvectors as steps. Where the Hessian is so flat that
    /// a step against `gradient` would change the unknowns by more than `longest`, the model is made steeper. `None` if the
    /// Hessian is not finite, or zero.
    pub fn of_hessian(hessian: &[f64], gradient: &[f64], longest: f64) -> Option<Self> {
        let n = gradient.len();
        if hessian.len() != n * n || !hessian.iter().all(|h| h.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(DMatrix::from_row_slice(n, n, hessian));
        let largest = eigen.eigenvalues.max();
        if !(largest > 0.0 && largest.is_finite()) {
            return None;
        }
        let mut memory =
            Self { s: Vec::new(), y: Vec::new(), diagonal: vec![largest; n], given: n, informed: true };
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            let s: Vec<f64> = vector.iter().copied().collect();
            let steepness = value.max(LEAST_CURVATURE * largest).max(dot(&s, gradient).abs() / longest);
            memory.y.push(s.iter().map(|s| steepness * s).collect());
            memory.s.push(s);
        }
        Some(memory)
    }

    /// Adds a pair and drops all but the latest `length`, and those of a given Hessian. A pair without positive curvature is skipped: it would make the
    /// model unbounded.
    pub fn push(&mut self, s: Vec<f64>, y: Vec<f64>, length: usize) {
        let (sy, ss, yy) = (dot(&s, &y), dot(&s, &s), dot(&y, &y));
        if !(sy > 1e-10 * (ss * yy).sqrt() && (yy / sy).is_finite()) {
            return;
        }
        if self.is_blank() {
            // So far D is only the initial guess.
            self.diagonal.fill(yy / sy);
        }
        if self.given == 0 {
            self.learn(&s, &y, sy);
        }
        self.s.push(s);
        self.y.push(y);
        if self.s.len() > length + self.given {
            self.s.remove(self.given);
            self.y.remove(self.given);
        }
    }

    /// The diagonal of the BFGS update of D, scaled first to be exact along y.
    fn learn(&mut self, s: &[f64], y: &[f64], sy: f64) {
        let factor = y.iter().zip(&self.diagonal).map(|(y, d)| y * y / d).sum::<f64>() / sy;
        let along = s.iter().zip(&self.diagonal).map(|(s, d)| s * s * d).sum::<f64>();
        let update = |((d, s), y): ((&f64, &f64), &f64)| factor * (d - (d * s).powi(2) / along) + y * y / sy;
        let learnt: Vec<f64> = self.diagonal.iter().zip(s).zip(y).map(update).collect();
        // Rounding may leave entries that are not positive.
        let largest = learnt.iter().copied().fold(0.0, f64::max);
        if largest.is_finite() && largest > 0.0 {
            self.diagonal = learnt.into_iter().map(|d| d.max(LEAST_SHARE * largest)).collect();
        }
    }

    /// `None` if rounding has made the middle matrix singular: the memory is then useless.
    pub fn compact(&self) -> Option<Compact<'_>> {
        let k = self.s.len();
        let scaled: Vec<Vec<f64>> =
            self.s.iter().map(|s| s.iter().zip(&self.diagonal).map(|(s, d)| s * d).collect()).collect();
        // [-diag Lᵀ; L SᵀDS], with diag the diagonal of SᵀY and L its strictly lower part.
        let inverse = DMatrix::from_fn(2 * k, 2 * k, |i, j| match (i < k, j < k) {
            (true, true) if i == j => -dot(&self.s[i], &self.y[i]),
            (true, true) => 0.0,
            (false, true) if i - k > j => dot(&self.s[i - k], &self.y[j]),
            (true, false) if j - k > i => dot(&self.s[j - k], &self.y[i]),
            (false, false) => dot(&self.s[i - k], &scaled[j - k]),
            _ => 0.0,
        });
        let middle = if k == 0 { inverse } else { inverse.try_inverse()? };
        middle.iter().all(|m| m.is_finite()).then_some(Compact { memory: self, scaled, middle })
    }
}

impl Compact<'_> {
    /// Columns of W.
    pub fn width(&self) -> usize {
        self.middle.nrows()
    }

    /// D.
    pub fn diagonal(&self) -> &[f64] {
        &self.memory.diagonal
    }

    /// Columns of W.
    fn columns(&self) -> impl Iterator<Item = &Vec<f64>> {
        self.memory.y.iter().chain(&self.scaled)
    }

    pub fn middle(&self) -> &DMatrix<f64> {
        &self.middle
    }

    /// Row `i` of W.
    pub fn row(&self, i: usize) -> DVector<f64> {
        DVector::from_iterator(self.width(), self.columns().map(|column| column[i]))
    }

    /// Wᵀ v.
    pub fn transposed(&self, v: &[f64]) -> DVector<f64> {
        DVector::from_iterator(self.width(), self.columns().map(|column| dot(column, v)))
    }

    /// M v.
    pub fn times_middle(&self, v: &DVector<f64>) -> DVector<f64> {
        &self.middle * v
    }

    /// Adds W v, for the rows listed.
    pub fn add_rows(&self, v: &DVector<f64>, rows: &[usize], to: &mut [f64]) {
        for (column, factor) in self.columns().zip(v.iter()) {
            for (to, &row) in to.iter_mut().zip(rows) {
                *to += factor * column[row];
            }
        }
    }

    /// Wᵀ D⁻¹ W over the rows listed.
    pub fn gram(&self, rows: &[usize]) -> DMatrix<f64> {
        let columns: Vec<&Vec<f64>> = self.columns().collect();
        let mut gram = DMatrix::zeros(self.width(), self.width());
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns.iter().enumerate().take(i + 1) {
                let product = rows.iter().map(|&r| a[r] * b[r] / self.memory.diagonal[r]).sum();
                gram[(i, j)] = product;
                gram[(j, i)] = product;
            }
        }
        gram
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// B from the rank-two updates, one after the other.
    fn dense(memory: &Memory) -> DMatrix<f64> {
        let mut b = DMatrix::from_diagonal(&DVector::from_column_slice(&memory.diagonal));
        for (s, y) in memory.s.iter().zip(&memory.y) {
            let (s, y) = (DVector::from_column_slice(s), DVector::from_column_slice(y));
            let bs = &b * &s;
            b += &y * y.transpose() / y.dot(&s) - &bs * bs.transpose() / s.dot(&bs);
        }
        b
    }

    #[test]
    fn is_the_bfgs_matrix() {
        let n = 5;
        let mut memory = Memory::new(n);
        let wave = |a: f64, b: f64| (0..n).map(|i| (a + b * i as f64).sin()).collect::<Vec<f64>>();
        for k in 0..4 {
            let s = wave(k as f64, 1.3);
            let y = s.iter().enumerate().map(|(i, s)| s * (1.0 + i as f64) + 0.1 * (k as f64)).collect();
            memory.push(s, y, 3);
        }
        assert_eq!(memory.s.len(), 3);
        let compact = memory.compact().expect("regular");
        let b = dense(&memory);
        for i in 0..n {
            let mut unit = vec![0.0; n];
            unit[i] = 1.0;
            let mut column: Vec<f64> = unit.iter().zip(&memory.diagonal).map(|(u, d)| u * d).collect();
            let inner = -compact.times_middle(&compact.transposed(&unit));
            compact.add_rows(&inner, &(0..n).collect::<Vec<_>>(), &mut column);
            for (j, value) in column.iter().enumerate() {
                assert!((value - b[(j, i)]).abs() < 1e-10 * memory.diagonal[0], "{i} {j}");
            }
        }
    }

    #[test]
    fn a_given_hessian_is_that_of_the_model() {
        let n = 4;
        let root = DMatrix::from_fn(n, n, |i, j| {
            (1.0 + i as f64 * 1.7 + j as f64 * 0.6).sin() + f64::from(u8::from(i == j))
        });
        let hessian = &root * root.transpose();
        let memory = Memory::of_hessian(hessian.as_slice(), &[0.0; 4], 1.0).expect("a memory");
        assert!((dense(&memory) - &hessian).norm() < 1e-12 * hessian.norm());
        // A later pair is exact along its step, whatever was given.
        let mut memory = memory;
        memory.push(vec![1.0, 2.0, 0.0, 0.0], vec![3.0, 1.0, 0.5, 0.0], 10);
        let s = DVector::from_column_slice(&memory.s[4]);
        assert!((dense(&memory) * s - DVector::from_column_slice(&memory.y[4])).norm() < 1e-10);
        // Flat along the second unknown: steps are limited.
        let memory = Memory::of_hessian(&[2.0, 0.0, 0.0, 0.0], &[0.0, 0.3], 0.5).expect("a memory");
        assert!((dense(&memory)[(1, 1)] - 0.6).abs() < 1e-12);
        assert!(Memory::of_hessian(&[f64::NAN, 0.0, 0.0, 1.0], &[0.0; 2], 1.0).is_none());
        assert!(Memory::of_hessian(&[0.0; 4], &[1.0; 2], 1.0).is_none());
    }

    #[test]
    fn pairs_without_curvature_are_left_out() {
        let mut memory = Memory::new(2);
        memory.push(vec![1.0, 0.0], vec![-1.0, 0.0], 5);
        memory.push(vec![0.0, 0.0], vec![0.0, 0.0], 5);
        memory.push(vec![1.0, 0.0], vec![0.0, 1.0], 5);
        assert_eq!((memory.s.len(), memory.diagonal), (0, vec![1.0; 2]));
    }
}
