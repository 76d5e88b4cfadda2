//! The compact limited-memory BFGS Hessian from the latest steps s and gradient differences y (Byrd, Nocedal and Schnabel 1994):
//! B = B_0 - V M Vᵀ with V = [Y, B_0 S].
//!
//! B_0 is a diagonal D, which is updated in every step (Gilbert and Lemaréchal 1989). The unknowns of a fit differ widely in influence,
//! such as a visible lamp and a dark corner; the usual multiple of the identity takes several times as many steps. Where the Hessian H
//! within a subspace is known, that of P z for few z, B_0 = D + D P A Pᵀ D with A = D_c⁻¹ (H - D_c) D_c⁻¹ and D_c = Pᵀ D P: the block BFGS
//! update of D, so that Pᵀ B_0 P = H.

use super::{CoarseHessian, dot};
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// Entries of D are at least this fraction of the largest.
const LEAST_SHARE: f64 = 1e-12;

/// Curvatures of a given Hessian are at least this fraction of the largest: what pictures do not show has none.
const LEAST_CURVATURE: f64 = 1e-7;

/// Entries of a given diagonal that are unknown, as a share of the mean of the others: what no picture shows acts by the light
/// that it reflects.
const UNKNOWN: f64 = 1e-2;

/// What is known of the Hessian: the pairs (s, y), the oldest first, and the model before them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Memory {
    pub s: Vec<Vec<f64>>,
    pub y: Vec<Vec<f64>>,
    /// D.
    pub diagonal: Vec<f64>,
    /// P and H.
    coarse: Option<CoarseHessian>,
    /// Whether D is known from the start.
    informed: bool,
}

/// B = D - W M Wᵀ with W = [Y, B_0 S, D P], for products.
pub(super) struct Compact<'a> {
    memory: &'a Memory,
    /// B_0 S.
    scaled: Vec<Vec<f64>>,
    middle: DMatrix<f64>,
}

impl Memory {
    pub fn new(unknowns: usize) -> Self {
        Self { s: Vec::new(), y: Vec::new(), diagonal: vec![1.0; unknowns], coarse: None, informed: false }
    }

    /// Whether nothing is known of the Hessian.
    pub fn is_blank(&self) -> bool {
        self.s.is_empty() && !self.informed
    }

    /// A memory with a given diagonal, whose entries of 0 are unknown, and a Hessian within a subspace, which is left out if it is not finite,
    /// or zero; see [`Self::of_hessian`] for `longest`. `None` if nothing is known of the diagonal, or an entry is not finite.
    pub fn of_diagonal(
        diagonal: &[f64],
        coarse: Option<CoarseHessian>,
        gradient: &[f64],
        longest: f64,
    ) -> Option<Self> {
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
        let coarse = coarse.and_then(|coarse| {
            let hessian = steepened(&coarse.hessian, &coarse.restricted(gradient), longest)?;
            Some(CoarseHessian { hessian, ..coarse })
        });
        Some(Self { diagonal, coarse, informed: true, ..Self::new(gradient.len()) })
    }

    /// A memory whose model has the given Hessian (row by row). Where the Hessian is so flat that a step against `gradient` would change
    /// the unknowns by more than `longest`, the model is made steeper. `None` if the Hessian is not finite, or zero.
    pub fn of_hessian(hessian: &[f64], gradient: &[f64], longest: f64) -> Option<Self> {
        let n = gradient.len();
        let steep = steepened(hessian, gradient, longest)?;
        let diagonal = (0..n).map(|i| steep[i * n + i]).collect();
        let coarse = CoarseHessian { of: (0..n as u32).collect(), hessian: steep };
        Some(Self { diagonal, coarse: Some(coarse), informed: true, ..Self::new(n) })
    }

    /// Adds a pair and drops all but the latest `length`. A pair without positive curvature is skipped: it would make the model unbounded.
    pub fn push(&mut self, s: Vec<f64>, y: Vec<f64>, length: usize) {
        let (sy, ss, yy) = (dot(&s, &y), dot(&s, &s), dot(&y, &y));
        if !(sy > 1e-10 * (ss * yy).sqrt() && (yy / sy).is_finite()) {
            return;
        }
        if self.is_blank() {
            // So far D is only the initial guess.
            self.diagonal.fill(yy / sy);
        }
        // Of a whole Hessian nothing is left to learn.
        if self.coarse.as_ref().is_none_or(|coarse| coarse.len() < s.len()) {
            self.learn(&s, &y, sy);
        }
        self.s.push(s);
        self.y.push(y);
        if self.s.len() > length {
            self.s.remove(0);
            self.y.remove(0);
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

    /// A, if a Hessian is known within a subspace.
    fn correction(&self) -> Option<DMatrix<f64>> {
        let coarse = self.coarse.as_ref()?;
        let m = coarse.len();
        let diagonal = coarse.restricted(&self.diagonal);
        let entry = |i: usize, j: usize| {
            let h = coarse.hessian[i * m + j] - if i == j { diagonal[i] } else { 0.0 };
            h / (diagonal[i] * diagonal[j])
        };
        Some(DMatrix::from_fn(m, m, entry))
    }

    /// `None` if rounding has made the middle matrix singular: the memory is then useless.
    pub fn compact(&self) -> Option<Compact<'_>> {
        let k = self.s.len();
        let correction = self.correction();
        let first = |s: &Vec<f64>| -> Vec<f64> {
            let mut product: Vec<f64> = s.iter().zip(&self.diagonal).map(|(s, d)| s * d).collect();
            if let (Some(coarse), Some(correction)) = (&self.coarse, &correction) {
                let along = correction * DVector::from_vec(coarse.restricted(&product));
                let members = product.iter_mut().zip(&self.diagonal).zip(&coarse.of);
                members.for_each(|((to, d), &z)| *to += d * along[z as usize]);
            }
            product
        };
        let scaled: Vec<Vec<f64>> = self.s.iter().map(first).collect();
        // [-diag Lᵀ; L SᵀB_0 S], with diag the diagonal of SᵀY and L its strictly lower part.
        let inverse = DMatrix::from_fn(2 * k, 2 * k, |i, j| match (i < k, j < k) {
            (true, true) if i == j => -dot(&self.s[i], &self.y[i]),
            (true, true) => 0.0,
            (false, true) if i - k > j => dot(&self.s[i - k], &self.y[j]),
            (true, false) if j - k > i => dot(&self.s[j - k], &self.y[i]),
            (false, false) => dot(&self.s[i - k], &scaled[j - k]),
            _ => 0.0,
        });
        let of_pairs = if k == 0 { inverse } else { inverse.try_inverse()? };
        let m = correction.as_ref().map_or(0, DMatrix::nrows);
        let mut middle = DMatrix::zeros(2 * k + m, 2 * k + m);
        middle.view_mut((0, 0), (2 * k, 2 * k)).copy_from(&of_pairs);
        if let Some(correction) = correction {
            middle.view_mut((2 * k, 2 * k), (m, m)).copy_from(&-correction);
        }
        middle.iter().all(|m| m.is_finite()).then_some(Compact { memory: self, scaled, middle })
    }
}

/// A Hessian (row by row) with curvatures that are positive, and large enough for steps against `gradient` to change no unknown by more than
/// `longest`. `None` if the Hessian is not finite, or zero.
fn steepened(hessian: &[f64], gradient: &[f64], longest: f64) -> Option<Vec<f64>> {
    let n = gradient.len();
    if hessian.len() != n * n || !hessian.iter().all(|h| h.is_finite()) {
        return None;
    }
    let mut eigen = SymmetricEigen::new(DMatrix::from_row_slice(n, n, hessian));
    let largest = eigen.eigenvalues.max();
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    for (value, vector) in eigen.eigenvalues.iter_mut().zip(eigen.eigenvectors.column_iter()) {
        let slope = vector.iter().zip(gradient).map(|(v, g)| v * g).sum::<f64>();
        *value = value.max(LEAST_CURVATURE * largest).max(slope.abs() / longest);
    }
    Some(eigen.recompose().as_slice().to_vec())
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

    /// The columns of [Y, B_0 S].
    fn columns(&self) -> impl Iterator<Item = &Vec<f64>> {
        self.memory.y.iter().chain(&self.scaled)
    }

    /// The column of D P in which a row is not zero.
    fn coarse_column(&self, row: usize) -> Option<usize> {
        self.memory.coarse.as_ref().map(|coarse| 2 * self.scaled.len() + coarse.of[row] as usize)
    }

    pub fn middle(&self) -> &DMatrix<f64> {
        &self.middle
    }

    /// Row `i` of W.
    pub fn row(&self, i: usize) -> DVector<f64> {
        let mut row = DVector::zeros(self.width());
        row.iter_mut().zip(self.columns()).for_each(|(to, column)| *to = column[i]);
        if let Some(column) = self.coarse_column(i) {
            row[column] = self.memory.diagonal[i];
        }
        row
    }

    /// Wᵀ v.
    pub fn transposed(&self, v: &[f64]) -> DVector<f64> {
        let mut product = DVector::zeros(self.width());
        product.iter_mut().zip(self.columns()).for_each(|(to, column)| *to = dot(column, v));
        for (i, (v, d)) in v.iter().zip(&self.memory.diagonal).enumerate() {
            if let Some(column) = self.coarse_column(i) {
                product[column] += d * v;
            }
        }
        product
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
        for (to, &row) in to.iter_mut().zip(rows) {
            if let Some(column) = self.coarse_column(row) {
                *to += self.memory.diagonal[row] * v[column];
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
        for &row in rows {
            if let Some(of) = self.coarse_column(row) {
                gram[(of, of)] += self.memory.diagonal[row];
                for (i, column) in columns.iter().enumerate() {
                    gram[(i, of)] += column[row];
                    gram[(of, i)] += column[row];
                }
            }
        }
        gram
    }

    /// B v.
    pub fn times(&self, v: &[f64]) -> Vec<f64> {
        let mut product: Vec<f64> = v.iter().zip(self.diagonal()).map(|(v, d)| d * v).collect();
        let inner = -self.times_middle(&self.transposed(v));
        self.add_rows(&inner, &(0..v.len()).collect::<Vec<_>>(), &mut product);
        product
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// B from the formula of B_0 and the rank-two updates, one after the other.
    fn dense(memory: &Memory) -> DMatrix<f64> {
        let d = DMatrix::from_diagonal(&DVector::from_column_slice(&memory.diagonal));
        let mut b = d.clone();
        if let Some(coarse) = &memory.coarse {
            let (n, m) = (coarse.of.len(), coarse.len());
            let p = DMatrix::from_fn(n, m, |i, j| f64::from(u8::from(coarse.of[i] as usize == j)));
            let h = DMatrix::from_row_slice(m, m, &coarse.hessian);
            let of_d = (p.transpose() * &d * &p).try_inverse().expect("positive");
            b += &d * &p * (&of_d * h * &of_d - &of_d) * p.transpose() * &d;
        }
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
        is_model(&memory, 1e-10);
    }

    /// That products with B are those with the dense matrix.
    fn is_model(memory: &Memory, tolerance: f64) {
        let (compact, b) = (memory.compact().expect("regular"), dense(memory));
        for i in 0..b.nrows() {
            let mut unit = vec![0.0; b.nrows()];
            unit[i] = 1.0;
            for (j, value) in compact.times(&unit).iter().enumerate() {
                assert!((value - b[(j, i)]).abs() < tolerance * b.norm(), "{i} {j}");
            }
        }
    }

    /// Within the subspace B is the given Hessian, and a later pair is exact along its step.
    #[test]
    fn a_hessian_within_a_subspace() {
        let coarse = CoarseHessian { of: vec![0, 1, 0, 0, 1], hessian: vec![5.0, -2.0, -2.0, 3.0] };
        let diagonal = [1.0, 2.0, 0.5, 4.0, 3.0];
        let memory = Memory::of_diagonal(&diagonal, Some(coarse.clone()), &[0.0; 5], 1.0);
        let mut memory = memory.expect("a memory");
        is_model(&memory, 1e-12);
        let b = dense(&memory);
        let p = DMatrix::from_fn(5, 2, |i, j| f64::from(u8::from(coarse.of[i] as usize == j)));
        let h = DMatrix::from_row_slice(2, 2, &coarse.hessian);
        assert!((p.transpose() * b * p - h).norm() < 1e-12);
        memory.push(vec![1.0, 0.5, 0.0, -0.2, 0.3], vec![3.0, 1.0, 0.5, 0.0, 0.7], 10);
        is_model(&memory, 1e-12);
        let s = DVector::from_column_slice(&memory.s[0]);
        assert!((dense(&memory) * s - DVector::from_column_slice(&memory.y[0])).norm() < 1e-12);
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
        let s = DVector::from_column_slice(&memory.s[0]);
        assert!((dense(&memory) * s - DVector::from_column_slice(&memory.y[0])).norm() < 1e-10);
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
