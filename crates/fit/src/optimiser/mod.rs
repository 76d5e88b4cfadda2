//! Bound-constrained minimisers as state machines: one step at a time, serialisable between steps.
//!
//! A failed step leaves the state unchanged, so that an interrupted fit repeats the step and reaches the same result, to
//! the last bit, as an uninterrupted one. Own code, because no maintained Rust crate has both bounds and a serialisable
//! state.

mod adam;
mod cauchy;
mod compact;
mod least_squares;
mod line_search;
mod quasi_newton;

pub use adam::{Adam, AdamOptions};
pub use least_squares::LeastSquares;
pub use quasi_newton::{QuasiNewton, QuasiNewtonOptions};

use serde::{Deserialize, Serialize};

/// The objective: value and gradient at a point. A value or gradient that is not finite marks an invalid point; the
/// optimiser then shortens the step. An error ends the step.
pub type Objective<'a, E> = dyn FnMut(&[f64]) -> Result<(f64, Vec<f64>), E> + 'a;

/// The product of the (constant) Hessian of a quadratic objective with a vector.
pub type Curvature<'a, E> = dyn FnMut(&[f64]) -> Result<Vec<f64>, E> + 'a;

/// The Hessian of the objective or an approximation of it (Gauss-Newton); `None` where it would cost too much.
pub type Hessian<'a, E> = dyn FnMut(&[f64]) -> Result<Option<KnownHessian>, E> + 'a;

/// What is known of a Hessian.
#[derive(Clone, Debug, PartialEq)]
pub enum KnownHessian {
    /// The whole Hessian, row by row.
    Whole(Vec<f64>),
    /// The diagonal of the Hessian, not negative, 0 where nothing is known; and the Hessian within a subspace. The optimiser starts from them.
    Diagonal(Vec<f64>, Option<CoarseHessian>),
}

/// The Hessian of few coarse unknowns z of an objective, where each unknown follows one of them: x = P z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoarseHessian {
    /// Per unknown, the coarse unknown that it follows.
    pub of: Vec<u32>,
    /// The Hessian by z, row by row.
    pub hessian: Vec<f64>,
}

impl CoarseHessian {
    /// Number of coarse unknowns.
    fn len(&self) -> usize {
        self.hessian.len().isqrt()
    }

    /// Pᵀ v.
    fn restricted(&self, v: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.len()];
        self.of.iter().zip(v).for_each(|(&z, v)| sums[z as usize] += v);
        sums
    }
}

/// A step failed. The state is unchanged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StepError<E> {
    #[error(
        "the objective is not finite at the starting point (value {value}); start from other values, or narrow the \
         bounds"
    )]
    /// The objective is not finite at the start.
    Start {
        /// Value of the objective at the start.
        value: f64,
    },
    /// A gradient or product has the wrong length.
    #[error("{got} derivatives for {expected} unknowns: a defect of the objective")]
    Length {
        /// Length of the gradient or product.
        got: usize,
        /// The number of unknowns.
        expected: usize,
    },
    /// A product with the Hessian is not finite. Unlike an objective, it admits no shorter step.
    #[error("the product with the Hessian is not finite; the model cannot be evaluated")]
    Curvature,
    /// The objective could not be evaluated.
    #[error(transparent)]
    Objective(E),
}

/// The outcome of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Objective after the step.
    pub value: f64,
    /// ‖P(x - g) - x‖∞ after the step, the norm of the projected gradient.
    pub gradient: f64,
    /// Largest change of an unknown in the step.
    pub length: f64,
    /// Evaluations of the objective and products with the Hessian in the step.
    pub evaluations: u32,
    /// False if no lower value could be found: the optimiser has reached the limit of rounding.
    pub progress: bool,
}

/// Box constraints; infinite where there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Lower bound per unknown; minus infinity if there is none.
    pub lower: Vec<f64>,
    /// Upper bound per unknown; infinity if there is none.
    pub upper: Vec<f64>,
}

impl Bounds {
    /// No bounds on `n` unknowns.
    pub fn free(n: usize) -> Self {
        Self { lower: vec![f64::NEG_INFINITY; n], upper: vec![f64::INFINITY; n] }
    }

    /// Projects a point onto the bounds.
    pub fn project(&self, x: &mut [f64]) {
        for ((x, &lower), &upper) in x.iter_mut().zip(&self.lower).zip(&self.upper) {
            *x = x.max(lower).min(upper);
        }
    }

    /// True where every unknown lies within its bounds.
    pub fn contain(&self, x: &[f64]) -> bool {
        x.iter().zip(&self.lower).zip(&self.upper).all(|((x, lower), upper)| x >= lower && x <= upper)
    }

    /// ‖P(x - g) - x‖∞: zero at a minimum within the bounds.
    pub fn projected_gradient(&self, x: &[f64], gradient: &[f64]) -> f64 {
        let part = |i: usize| ((x[i] - gradient[i]).max(self.lower[i]).min(self.upper[i]) - x[i]).abs();
        (0..x.len()).map(part).fold(0.0, f64::max)
    }

    /// The longest step along `direction` from a point within the bounds.
    fn longest_step(&self, x: &[f64], direction: &[f64]) -> f64 {
        let room = |i: usize| match direction[i] {
            d if d > 0.0 => (self.upper[i] - x[i]) / d,
            d if d < 0.0 => (self.lower[i] - x[i]) / d,
            _ => f64::INFINITY,
        };
        (0..x.len()).map(room).fold(f64::INFINITY, f64::min).max(0.0)
    }
}

/// An evaluated point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Point {
    x: Vec<f64>,
    value: f64,
    gradient: Vec<f64>,
}

impl Point {
    /// `None` where the objective is not finite.
    fn evaluate<E>(x: Vec<f64>, objective: &mut Objective<E>) -> Result<Option<Self>, StepError<E>> {
        let (value, gradient) = objective(&x).map_err(StepError::Objective)?;
        if !value.is_finite() {
            return Ok(None);
        }
        if gradient.len() != x.len() {
            return Err(StepError::Length { got: gradient.len(), expected: x.len() });
        }
        let finite = gradient.iter().all(|g| g.is_finite());
        Ok(finite.then_some(Self { x, value, gradient }))
    }

    /// The first point, which must be finite.
    fn start<E>(x: &[f64], objective: &mut Objective<E>) -> Result<Self, StepError<E>> {
        let mut value = f64::NAN;
        let mut watched = |x: &[f64]| objective(x).inspect(|(v, _)| value = *v);
        Self::evaluate(x.to_vec(), &mut watched)?.ok_or(StepError::Start { value })
    }

    /// The report of a start.
    fn as_start(&self, bounds: &Bounds) -> Step {
        let gradient = bounds.projected_gradient(&self.x, &self.gradient);
        Step { value: self.value, gradient, length: 0.0, evaluations: 1, progress: true }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(crate) fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// One of the optimisers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Optimiser {
    /// L-BFGS-B with a diagonal update.
    QuasiNewton(QuasiNewton),
    /// Adam, projected onto bounds.
    Adam(Adam),
    /// Bounded linear least squares.
    LeastSquares(LeastSquares),
}

impl Optimiser {
    /// Evaluates the objective at the start. Without it, the first step does.
    ///
    /// # Errors
    /// Fails if the objective fails, is not finite, or returns a gradient of the wrong length.
    pub fn start<E>(&mut self, objective: &mut Objective<E>) -> Result<Step, StepError<E>> {
        let (x, bounds, known) = match self {
            Self::QuasiNewton(QuasiNewton { start, bounds, point, .. }) => (start, bounds, point),
            Self::Adam(Adam { start, bounds, point, .. }) => (start, bounds, point),
            Self::LeastSquares(LeastSquares { start, bounds, first, .. }) => (start, bounds, first),
        };
        let point = Point::start(x, objective)?;
        Ok(known.insert(point).as_start(bounds))
    }

    /// The Hessian of the model, row by row; `None` where nothing is known.
    pub fn hessian(&self) -> Option<Vec<f64>> {
        match self {
            Self::QuasiNewton(optimiser) => optimiser.hessian(),
            Self::Adam(_) | Self::LeastSquares(_) => None,
        }
    }

    /// One step. Only [`LeastSquares`] uses `curvature`, only [`QuasiNewton`] `hessian`.
    ///
    /// # Errors
    /// Fails as the `step` of that optimiser does.
    pub fn step<E>(
        &mut self,
        objective: &mut Objective<E>,
        curvature: &mut Curvature<E>,
        hessian: &mut Hessian<E>,
    ) -> Result<Step, StepError<E>> {
        match self {
            Self::QuasiNewton(optimiser) => optimiser.step(objective, hessian),
            Self::Adam(optimiser) => optimiser.step(objective),
            Self::LeastSquares(optimiser) => optimiser.step(objective, curvature),
        }
    }

    /// By how much the optimiser expects the minimum to be below the current value; infinite where it has no model.
    pub fn promise(&self) -> f64 {
        match self {
            Self::QuasiNewton(optimiser) => optimiser.promise(),
            Self::Adam(_) | Self::LeastSquares(_) => f64::INFINITY,
        }
    }

    /// The current point, within the bounds.
    pub fn x(&self) -> &[f64] {
        match self {
            Self::QuasiNewton(optimiser) => optimiser.x(),
            Self::Adam(optimiser) => optimiser.x(),
            Self::LeastSquares(optimiser) => optimiser.x(),
        }
    }

    /// The best point so far: the current one, except with Adam.
    pub fn best(&self) -> &[f64] {
        match self {
            Self::Adam(optimiser) => optimiser.best(),
            Self::QuasiNewton(_) | Self::LeastSquares(_) => self.x(),
        }
    }

    /// Bytes of the optimiser's vectors for `n` unknowns.
    pub fn bytes(&self, n: usize) -> u64 {
        let vectors = match self {
            Self::QuasiNewton(optimiser) => optimiser.vectors(),
            Self::Adam(_) => 7,
            Self::LeastSquares(_) => 7,
        };
        8 * vectors as u64 * n as u64
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::convert::Infallible;

    pub type Result<T> = std::result::Result<T, Infallible>;

    /// The Rosenbrock function Σ 100 (x_{i+1} - x_i²)² + (1 - x_i)².
    pub fn rosenbrock(x: &[f64]) -> (f64, Vec<f64>) {
        let mut gradient = vec![0.0; x.len()];
        let mut value = 0.0;
        for i in 0..x.len() - 1 {
            let (a, b) = (x[i + 1] - x[i] * x[i], 1.0 - x[i]);
            value += 100.0 * a * a + b * b;
            gradient[i] += -400.0 * x[i] * a - 2.0 * b;
            gradient[i + 1] += 200.0 * a;
        }
        (value, gradient)
    }

    /// ½ Σ h_i (x_i - c_i)², with a coupling between neighbours.
    pub fn quadratic(h: &[f64], c: &[f64], coupling: f64, x: &[f64]) -> (f64, Vec<f64>) {
        let d: Vec<f64> = x.iter().zip(c).map(|(x, c)| x - c).collect();
        let mut gradient: Vec<f64> = d.iter().zip(h).map(|(d, h)| d * h).collect();
        let mut value = 0.5 * dot(&gradient, &d);
        for i in 0..x.len() - 1 {
            let e = d[i] - d[i + 1];
            value += 0.5 * coupling * e * e;
            gradient[i] += coupling * e;
            gradient[i + 1] -= coupling * e;
        }
        (value, gradient)
    }

    #[test]
    fn bounds_project_and_measure() {
        let bounds = Bounds { lower: vec![0.0, -1.0], upper: vec![1.0, f64::INFINITY] };
        let mut x = [2.0, -3.0];
        assert!(!bounds.contain(&x));
        bounds.project(&mut x);
        assert_eq!(x, [1.0, -1.0]);
        assert!(bounds.contain(&x));
        assert_eq!(bounds.projected_gradient(&x, &[-5.0, 5.0]), 0.0);
        assert_eq!(bounds.projected_gradient(&x, &[0.25, -3.0]), 3.0);
        assert_eq!(bounds.longest_step(&x, &[-0.5, 1.0]), 2.0);
    }

    /// A state stored after any step continues to the same bytes.
    #[test]
    fn storing_and_restoring_changes_nothing() {
        let bounds = Bounds { lower: vec![-2.0; 6], upper: vec![0.9, 0.8, 2.0, 2.0, 2.0, 2.0] };
        let start = vec![-1.2, 0.8, -1.0, 1.0, 0.3, 0.5];
        let (h, c) = ([3.0, 1e-2, 40.0, 1.0, 7.0, 0.5], [2.0, 1.0, -3.0, 0.5, 0.2, -5.0]);
        for kind in 0..3 {
            let new = || match kind {
                0 => Optimiser::QuasiNewton(QuasiNewton::new(
                    start.clone(),
                    bounds.clone(),
                    QuasiNewtonOptions::default(),
                )),
                1 => Optimiser::Adam(Adam::new(start.clone(), bounds.clone(), AdamOptions::default())),
                _ => Optimiser::LeastSquares(LeastSquares::new(start.clone(), bounds.clone())),
            };
            let step = |optimiser: &mut Optimiser| {
                let mut objective = |x: &[f64]| -> Result<_> {
                    Ok(if kind == 2 { quadratic(&h, &c, 2.0, x) } else { rosenbrock(x) })
                };
                let mut curvature = |p: &[f64]| -> Result<_> { Ok(quadratic(&h, &[0.0; 6], 2.0, p).1) };
                let mut hessian = |_: &[f64]| -> Result<_> { Ok(None) };
                optimiser.step(&mut objective, &mut curvature, &mut hessian).expect("a step")
            };
            let mut whole = new();
            let mut stored = postcard::to_stdvec(&new()).expect("bytes");
            for iteration in 0..40 {
                let mut restored: Optimiser = postcard::from_bytes(&stored).expect("an optimiser");
                assert_eq!(step(&mut whole), step(&mut restored), "kind {kind}, iteration {iteration}");
                stored = postcard::to_stdvec(&restored).expect("bytes");
                assert_eq!(postcard::to_stdvec(&whole).expect("bytes"), stored);
                assert!(bounds.contain(whole.x()));
            }
        }
    }

    /// A failed step leaves no trace in the state.
    #[test]
    fn an_error_leaves_the_state_alone() {
        let n = 4;
        let new = |kind: usize| {
            let (x, bounds) = (vec![-1.0; n], Bounds { lower: vec![-2.0; n], upper: vec![0.7; n] });
            match kind {
                0 => Optimiser::QuasiNewton(QuasiNewton::new(x, bounds, QuasiNewtonOptions::default())),
                1 => Optimiser::Adam(Adam::new(x, bounds, AdamOptions::default())),
                _ => Optimiser::LeastSquares(LeastSquares::new(x, bounds)),
            }
        };
        for kind in 0..3 {
            for fails_at in 0..25 {
                let (mut optimiser, mut calls) = (new(kind), 0);
                let mut count = || {
                    calls += 1;
                    if calls > fails_at { Err("the plug is out") } else { Ok(()) }
                };
                let counter = std::cell::RefCell::new(&mut count);
                let mut objective = |x: &[f64]| -> std::result::Result<_, &str> {
                    (counter.borrow_mut())()?;
                    Ok(if kind == 2 { quadratic(&[1.0; 4], &[1.0; 4], 5.0, x) } else { rosenbrock(x) })
                };
                let mut curvature = |p: &[f64]| {
                    (counter.borrow_mut())()?;
                    Ok(quadratic(&[1.0; 4], &[0.0; 4], 5.0, p).1)
                };
                let before = loop {
                    let before = optimiser.clone();
                    match optimiser.step(&mut objective, &mut curvature, &mut |_| Ok(None)) {
                        Ok(step) if !step.progress => break optimiser.clone(),
                        Ok(_) => {}
                        Err(StepError::Objective(reason)) => {
                            assert_eq!(reason, "the plug is out");
                            break before;
                        }
                        Err(other) => panic!("{other}"),
                    }
                };
                assert_eq!(optimiser, before, "kind {kind}, call {fails_at}");
            }
        }
    }
}
