//! The limited-memory Hessian B = θ I - W M Wᵀ of the BFGS formula, from the latest steps s and changes y of the
//! gradient (Byrd, Nocedal, Schnabel 1994).

use super::dot;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Steps and changes, the oldest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Memory {
    pub s: Vec<Vec<f64>>,
    pub y: Vec<Vec<f64>>,
    /// The scale of the Hessian where nothing is known.
    pub theta: f64,
}

/// W = [Y, θ S] and M, ready to be multiplied with.
pub(super) struct Compact<'a> {
    memory: &'a Memory,
    middle: DMatrix<f64>,
}

impl Memory {
    pub fn new(theta: f64) -> Self {
        Self { s: Vec::new(), y: Vec::new(), theta }
    }

    /// Adds a pair and forgets what is older than `length` pairs. A pair without positive curvature is left out: it
    /// would make the model unbounded.
    pub fn push(&mut self, s: Vec<f64>, y: Vec<f64>, length: usize) {
        let (sy, ss, yy) = (dot(&s, &y), dot(&s, &s), dot(&y, &y));
        if !(sy > 1e-10 * (ss * yy).sqrt() && (yy / sy).is_finite()) {
            return;
        }
        self.theta = yy / sy;
        self.s.push(s);
        self.y.push(y);
        if self.s.len() > length {
            self.s.remove(0);
            self.y.remove(0);
        }
    }

    /// `None` where rounding has made the middle matrix singular: then the memory is of no use.
    pub fn compact(&self) -> Option<Compact<'_>> {
        let k = self.s.len();
        // [-D Lᵀ; L θ SᵀS], with D and L the diagonal of SᵀY and what lies below it.
        let inverse = DMatrix::from_fn(2 * k, 2 * k, |i, j| match (i < k, j < k) {
            (true, true) if i == j => -dot(&self.s[i], &self.y[i]),
            (true, true) => 0.0,
            (false, true) if i - k > j => dot(&self.s[i - k], &self.y[j]),
            (true, false) if j - k > i => dot(&self.s[j - k], &self.y[i]),
            (false, false) => self.theta * dot(&self.s[i - k], &self.s[j - k]),
            _ => 0.0,
        });
        let middle = if k == 0 { inverse } else { inverse.try_inverse()? };
        middle.iter().all(|m| m.is_finite()).then_some(Compact { memory: self, middle })
    }
}

impl Compact<'_> {
    /// Columns of W.
    pub fn width(&self) -> usize {
        self.middle.nrows()
    }

    pub fn theta(&self) -> f64 {
        self.memory.theta
    }

    pub fn middle(&self) -> &DMatrix<f64> {
        &self.middle
    }

    /// Row `i` of W.
    pub fn row(&self, i: usize) -> DVector<f64> {
        let Memory { s, y, theta } = self.memory;
        DVector::from_iterator(self.width(), y.iter().map(|y| y[i]).chain(s.iter().map(|s| theta * s[i])))
    }

    /// Wᵀ v.
    pub fn transposed(&self, v: &[f64]) -> DVector<f64> {
        let Memory { s, y, theta } = self.memory;
        let products = y.iter().map(|y| dot(y, v)).chain(s.iter().map(|s| theta * dot(s, v)));
        DVector::from_iterator(self.width(), products)
    }

    /// M v.
    pub fn times_middle(&self, v: &DVector<f64>) -> DVector<f64> {
        &self.middle * v
    }

    /// Adds W v, for the rows listed.
    pub fn add_rows(&self, v: &DVector<f64>, rows: &[usize], to: &mut [f64]) {
        let Memory { s, y, theta } = self.memory;
        let k = s.len();
        for (column, factor) in v.iter().enumerate() {
            let (vector, factor) =
                if column < k { (&y[column], *factor) } else { (&s[column - k], theta * factor) };
            for (to, &row) in to.iter_mut().zip(rows) {
                *to += factor * vector[row];
            }
        }
    }

    /// Wᵀ W over the rows listed.
    pub fn gram(&self, rows: &[usize]) -> DMatrix<f64> {
        let Memory { s, y, theta } = self.memory;
        let k = s.len();
        let column = |c: usize| if c < k { (&y[c], 1.0) } else { (&s[c - k], *theta) };
        let mut gram = DMatrix::zeros(2 * k, 2 * k);
        for i in 0..2 * k {
            for j in 0..=i {
                let ((a, fa), (b, fb)) = (column(i), column(j));
                let product = fa * fb * rows.iter().map(|&r| a[r] * b[r]).sum::<f64>();
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
    fn dense(memory: &Memory, n: usize) -> DMatrix<f64> {
        let mut b = DMatrix::identity(n, n) * memory.theta;
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
        let mut memory = Memory::new(1.0);
        let wave = |a: f64, b: f64| (0..n).map(|i| (a + b * i as f64).sin()).collect::<Vec<f64>>();
        for k in 0..4 {
            let s = wave(k as f64, 1.3);
            let y = s.iter().enumerate().map(|(i, s)| s * (1.0 + i as f64) + 0.1 * (k as f64)).collect();
            memory.push(s, y, 3);
        }
        assert_eq!(memory.s.len(), 3);
        let compact = memory.compact().expect("regular");
        let b = dense(&memory, n);
        for i in 0..n {
            let mut unit = vec![0.0; n];
            unit[i] = 1.0;
            let mut column: Vec<f64> = unit.iter().map(|u| u * memory.theta).collect();
            let inner = -compact.times_middle(&compact.transposed(&unit));
            compact.add_rows(&inner, &(0..n).collect::<Vec<_>>(), &mut column);
            for (j, value) in column.iter().enumerate() {
                assert!((value - b[(j, i)]).abs() < 1e-10 * memory.theta, "{i} {j}");
            }
        }
    }

    #[test]
    fn pairs_without_curvature_are_left_out() {
        let mut memory = Memory::new(2.0);
        memory.push(vec![1.0, 0.0], vec![-1.0, 0.0], 5);
        memory.push(vec![0.0, 0.0], vec![0.0, 0.0], 5);
        memory.push(vec![1.0, 0.0], vec![0.0, 1.0], 5);
        assert_eq!((memory.s.len(), memory.theta), (0, 2.0));
    }
}
