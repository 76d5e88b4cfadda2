//! Bounded linear least squares, and any other convex quadratic within bounds, by conjugate gradients on the free unknowns:
//! modified proportioning with reduced gradient projections (Dostál and Schöberl 2005), where steps past a bound are
//! projected in full (Kružík et al. 2020). It needs only products with the Hessian JᵀJ; J is never formed.

use super::{Bounds, Curvature, Objective, Point, Step, StepError, dot, largest_difference};
use serde::{Deserialize, Serialize};

/// Largest ratio of the squared chopped gradient (of unknowns at bounds) to the squared free gradient.
const PROPORTION: f64 = 1.0;
/// Products in the first step for estimating the largest eigenvalue.
const POWER_ITERATIONS: u32 = 4;
/// Steps between evaluations of value and gradient. In between they are updated and accumulate rounding errors.
const REFRESH: u64 = 25;
/// Share of the value evaluated last below which an updated value is evaluated: the errors of products are relative to what was there.
const TRUSTED: f64 = 1e-3;
/// Relative tolerance, for rounding, within which an unknown counts as at its bound.
const NEAR: f64 = 1e-14;

/// The serialisable state of bounded linear least squares.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeastSquares {
    pub(super) bounds: Bounds,
    pub(super) start: Vec<f64>,
    /// The start, once it is evaluated.
    pub(super) first: Option<Point>,
    state: Option<State>,
    steps: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct State {
    point: Point,
    /// The value where it was evaluated last.
    evaluated: f64,
    /// The conjugate direction; its negative points downhill.
    direction: Vec<f64>,
    /// Estimate of the largest eigenvalue of the Hessian.
    stiffness: f64,
}

impl LeastSquares {
    /// Starts at the projection of `x` onto `bounds`.
    pub fn new(mut x: Vec<f64>, bounds: Bounds) -> Self {
        bounds.project(&mut x);
        Self { bounds, start: x, first: None, state: None, steps: 0 }
    }

    /// The current unknowns.
    pub fn x(&self) -> &[f64] {
        self.state.as_ref().map_or(&self.start, |state| &state.point.x)
    }

    /// The free gradient (unknowns off their bounds) and the chopped gradient (unknowns that would leave their bound).
    fn split(&self, point: &Point) -> (Vec<f64>, Vec<f64>) {
        let Bounds { lower, upper } = &self.bounds;
        let of = |i: usize| {
            let (x, g) = (point.x[i], point.gradient[i]);
            match (x <= lower[i], x >= upper[i]) {
                (false, false) => (g, 0.0),
                (true, false) => (0.0, g.min(0.0)),
                (false, true) => (0.0, g.max(0.0)),
                (true, true) => (0.0, 0.0),
            }
        };
        (0..point.x.len()).map(of).unzip()
    }

    /// One step: one product with the Hessian, two or three if a bound is reached; the first step takes more.
    ///
    /// `objective` is evaluated at the start, every 25 steps, and where the value has fallen a thousandfold; `curvature` computes the
    /// products.
    ///
    /// # Errors
    /// Fails if the objective or a product with the Hessian fails, is not finite at the start, or has the
    /// wrong length.
    pub fn step<E>(
        &mut self,
        objective: &mut Objective<E>,
        curvature: &mut Curvature<E>,
    ) -> Result<Step, StepError<E>> {
        let mut evaluations = 0;
        let mut product = |p: &[f64]| -> Result<Vec<f64>, StepError<E>> {
            let product = curvature(p).map_err(StepError::Objective)?;
            match product.len() == p.len() {
                false => Err(StepError::Length { got: product.len(), expected: p.len() }),
                true if product.iter().all(|h| h.is_finite()) => Ok(product),
                true => Err(StepError::Curvature),
            }
        };
        let mut state = match &self.state {
            Some(state) => state.clone(),
            None => {
                let point = match self.first.clone() {
                    Some(point) => point,
                    None => {
                        evaluations += 1;
                        Point::start(&self.start, objective)?
                    }
                };
                let (free, _) = self.split(&point);
                let mut stiffness: f64 = 0.0;
                let mut probe = point.gradient.clone();
                for _ in 0..POWER_ITERATIONS {
                    let size = dot(&probe, &probe).sqrt();
                    if size == 0.0 {
                        break;
                    }
                    probe.iter_mut().for_each(|p| *p /= size);
                    probe = product(&probe)?;
                    evaluations += 1;
                    stiffness = stiffness.max(dot(&probe, &probe).sqrt());
                }
                State { evaluated: point.value, point, direction: free, stiffness }
            }
        };
        let before = state.point.clone();
        let (free, chopped) = self.split(&state.point);
        let (free_squared, chopped_squared) = (dot(&free, &free), dot(&chopped, &chopped));
        if free_squared + chopped_squared == 0.0 {
            // The minimum.
            let step = self.report(&before, &before, evaluations, false);
            self.state = Some(state);
            return Ok(step);
        }
        let proportional = chopped_squared <= PROPORTION * PROPORTION * free_squared;
        // If rounding has made the direction ascend, restart from the gradient.
        if proportional && dot(&state.direction, &state.point.gradient) <= 0.0 {
            state.direction = free;
        }
        let direction = if proportional { state.direction.clone() } else { chopped };
        let curved = product(&direction)?;
        evaluations += 1;
        let along = dot(&direction, &state.point.gradient);
        let bend = dot(&direction, &curved);
        state.stiffness = state.stiffness.max(bend / dot(&direction, &direction));
        let downhill: Vec<f64> = direction.iter().map(|d| -d).collect();
        let longest = self.bounds.longest_step(&state.point.x, &downhill);
        let wished = if bend > 0.0 { along / bend } else { f64::INFINITY };
        let length = wished.min(longest);
        if !length.is_finite() {
            // Flat and without a bound: no step changes the gradient.
            let step = self.report(&before, &before, evaluations, false);
            self.state = Some(state);
            return Ok(step);
        }
        let point = &mut state.point;
        if wished <= longest {
            self.advance(point, &direction, &curved, length);
            let (free, _) = self.split(point);
            state.direction = if proportional {
                let share = dot(&free, &curved) / bend;
                free.iter().zip(&direction).map(|(f, d)| f - share * d).collect()
            } else {
                free
            };
        } else {
            // A bound limits the step. Projecting the full step activates many bounds at once.
            let bent = |point: &Point, length: f64, direction: &[f64]| {
                let mut bent: Vec<f64> = point.x.iter().zip(direction).map(|(x, d)| x - length * d).collect();
                self.bounds.project(&mut bent);
                let moved: Vec<f64> = point.x.iter().zip(&bent).map(|(x, b)| x - b).collect();
                (bent, moved)
            };
            let (whole, moved) = bent(point, wished, &direction);
            let curved_moved = product(&moved)?;
            evaluations += 1;
            if dot(&moved, &point.gradient) > 0.5 * dot(&moved, &curved_moved) {
                self.advance(point, &moved, &curved_moved, 1.0);
                point.x = whole;
            } else {
                // The projected step leads uphill: go to the first bound, then along the free gradient by a step that
                // is short enough for the largest eigenvalue.
                self.advance(point, &direction, &curved, length);
                let (free, _) = self.split(point);
                let (whole, moved) = bent(point, 1.0 / state.stiffness.max(f64::MIN_POSITIVE), &free);
                if moved.iter().any(|m| *m != 0.0) {
                    let curved_moved = product(&moved)?;
                    evaluations += 1;
                    let bend = dot(&moved, &curved_moved);
                    state.stiffness = state.stiffness.max(bend / dot(&moved, &moved));
                    // Shortened if the eigenvalue was underestimated, so that the value never rises.
                    let best = if bend > 0.0 { (dot(&moved, &point.gradient) / bend).min(1.0) } else { 1.0 };
                    self.advance(point, &moved, &curved_moved, best);
                    if best == 1.0 {
                        point.x = whole;
                    }
                }
            }
            state.direction = self.split(point).0;
        }
        let steps = self.steps + 1;
        if steps.is_multiple_of(REFRESH) || state.point.value < TRUSTED * state.evaluated {
            evaluations += 1;
            if let Some(fresh) = Point::evaluate(state.point.x.clone(), objective)? {
                state.evaluated = fresh.value;
                state.point = fresh;
            }
        }
        let step = self.report(&before, &state.point, evaluations, true);
        (self.state, self.steps) = (Some(state), steps);
        Ok(step)
    }

    /// x - length · direction, with value and gradient.
    fn advance(&self, point: &mut Point, direction: &[f64], curved: &[f64], length: f64) {
        let along = dot(direction, &point.gradient);
        point.value += length * (0.5 * length * dot(direction, curved) - along);
        for i in 0..point.x.len() {
            point.x[i] -= length * direction[i];
            point.gradient[i] -= length * curved[i];
            // An unknown within rounding of its bound is set to it exactly.
            for bound in [self.bounds.lower[i], self.bounds.upper[i]] {
                if (point.x[i] - bound).abs() <= NEAR * (point.x[i].abs() + length * direction[i].abs()) {
                    point.x[i] = bound;
                }
            }
        }
        self.bounds.project(&mut point.x);
    }

    fn report(&self, before: &Point, after: &Point, evaluations: u32, progress: bool) -> Step {
        Step {
            value: after.value,
            gradient: self.bounds.projected_gradient(&after.x, &after.gradient),
            length: largest_difference(&after.x, &before.x),
            evaluations,
            progress: progress && after.x != before.x,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Result, quadratic};
    use super::*;
    use nalgebra::{DMatrix, DVector};

    fn solve(
        a: &DMatrix<f64>,
        b: &DVector<f64>,
        start: Vec<f64>,
        bounds: Bounds,
        steps: usize,
    ) -> (LeastSquares, u32) {
        let mut solver = LeastSquares::new(start, bounds.clone());
        let mut evaluations = 0;
        let mut last = f64::INFINITY;
        for _ in 0..steps {
            let step = solver
                .step(
                    &mut |x: &[f64]| -> Result<_> {
                        let r = a * DVector::from_column_slice(x) - b;
                        Ok((0.5 * r.dot(&r), (a.transpose() * r).as_slice().to_vec()))
                    },
                    &mut |p: &[f64]| -> Result<_> {
                        Ok((a.transpose() * (a * DVector::from_column_slice(p))).as_slice().to_vec())
                    },
                )
                .expect("a step");
            evaluations += step.evaluations;
            assert!(bounds.contain(solver.x()));
            assert!(step.value <= last + 1e-9 * last.abs().min(1e9), "{} after {last}", step.value);
            last = step.value;
            if step.gradient < 1e-11 || !step.progress {
                break;
            }
        }
        (solver, evaluations)
    }

    /// Products that are wrong by a millionth: values stay those of the objective, and the minimum, of value 0, is found.
    #[test]
    fn errors_of_products_do_not_end_it_early() {
        let (a, x) = (wave(40, 12), DVector::from_fn(12, |i, _| (i as f64).cos()));
        let b = &a * &x;
        let value = |x: &[f64]| {
            let r = &a * DVector::from_column_slice(x) - &b;
            (0.5 * r.dot(&r), (a.transpose() * r).as_slice().to_vec())
        };
        let mut solver = LeastSquares::new(vec![0.0; 12], Bounds::free(12));
        let (start, mut calls) = (value(&[0.0; 12]).0, 0.0);
        for _ in 0..200 {
            let mut curvature = |p: &[f64]| -> Result<_> {
                calls += 1.0;
                let product = a.transpose() * (&a * DVector::from_column_slice(p));
                let wrong = |(i, h): (usize, &f64)| h * (1.0 + 1e-6 * (calls + i as f64).sin());
                Ok(product.iter().enumerate().map(wrong).collect())
            };
            let step =
                solver.step(&mut |x: &[f64]| -> Result<_> { Ok(value(x)) }, &mut curvature).expect("a step");
            let truth = value(solver.x()).0;
            assert!(
                step.value > 0.0 && step.value < 2.0 * truth && step.value > 0.5 * truth,
                "{} {truth}",
                step.value
            );
            if step.value < 1e-18 * start {
                return;
            }
        }
        panic!("not found: {:?}", solver.x());
    }

    fn wave(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |i, j| ((i * 7 + j * 13) as f64).sin() + f64::from(i % columns == j))
    }

    /// The optimality conditions: no gradient on free unknowns, none that pulls an unknown off its bound.
    #[track_caller]
    fn is_minimum(a: &DMatrix<f64>, b: &DVector<f64>, bounds: &Bounds, x: &[f64], small: f64) {
        let g = a.transpose() * (a * DVector::from_column_slice(x) - b);
        assert!(bounds.projected_gradient(x, g.as_slice()) < small, "{x:?} {g}");
    }

    #[test]
    fn non_negative_least_squares() {
        let (m, n) = (60, 30);
        let a = wave(m, n);
        let truth = DVector::from_fn(n, |i, _| if i % 3 == 0 { 1.0 + i as f64 } else { 0.0 });
        let bounds = Bounds { lower: vec![0.0; n], upper: vec![f64::INFINITY; n] };
        let b = &a * &truth;
        let (solver, evaluations) = solve(&a, &b, vec![0.5; n], bounds.clone(), 2000);
        assert!(largest_difference(solver.x(), truth.as_slice()) < 1e-7, "{:?}", solver.x());
        assert!(evaluations < 400, "{evaluations}");
        // Noise, so that the unconstrained solution has negative values.
        let noisy = DVector::from_fn(m, |i, _| b[i] + 3.0 * (i as f64 * 2.1).cos());
        let (solver, _) = solve(&a, &noisy, vec![0.0; n], bounds.clone(), 2000);
        is_minimum(&a, &noisy, &bounds, solver.x(), 1e-8);
        assert!(solver.x().iter().filter(|x| **x == 0.0).count() > 5);
    }

    #[test]
    fn bounds_on_both_sides() {
        let n = 40;
        let a = wave(50, n);
        let b = DVector::from_fn(50, |i, _| 5.0 * (i as f64).cos());
        let bounds = Bounds { lower: vec![-0.2; n], upper: vec![0.3; n] };
        let (solver, _) = solve(&a, &b, vec![0.1; n], bounds.clone(), 3000);
        is_minimum(&a, &b, &bounds, solver.x(), 1e-8);
        let met = solver.x().iter().filter(|x| **x == -0.2 || **x == 0.3).count();
        assert!(met > 5 && met < n, "{met}");
    }

    /// More unknowns than equations: it finds a minimum with the right value.
    #[test]
    fn more_unknowns_than_equations() {
        let (m, n) = (10, 25);
        let a = wave(m, n);
        let b = &a * DVector::from_element(n, 2.0);
        let bounds = Bounds { lower: vec![0.0; n], upper: vec![f64::INFINITY; n] };
        let (solver, _) = solve(&a, &b, vec![0.0; n], bounds, 1000);
        let r = &a * DVector::from_column_slice(solver.x()) - &b;
        assert!(r.norm() < 1e-8 * b.norm(), "{}", r.norm());
    }

    #[test]
    fn a_badly_scaled_quadratic() {
        let h: Vec<f64> = (0..10).map(|i| 10f64.powi(i - 5)).collect();
        let c = [1.0, -1.0, 2.0, 3.0, -4.0, 5.0, 6.0, -7.0, 8.0, 9.0];
        let bounds = Bounds { lower: vec![0.0; 10], upper: vec![f64::INFINITY; 10] };
        let mut solver = LeastSquares::new(vec![1.0; 10], bounds);
        for _ in 0..500 {
            solver
                .step(
                    &mut |x: &[f64]| -> Result<_> { Ok(quadratic(&h, &c, 0.0, x)) },
                    &mut |p: &[f64]| -> Result<_> { Ok(quadratic(&h, &[0.0; 10], 0.0, p).1) },
                )
                .expect("a step");
        }
        for (x, c) in solver.x().iter().zip(c) {
            assert!((x - c.max(0.0)).abs() < 1e-6, "{x} {c}");
        }
    }

    #[test]
    fn a_model_that_is_not_finite_is_an_error() {
        let mut solver = LeastSquares::new(vec![1.0], Bounds::free(1));
        let before = solver.clone();
        let step = solver
            .step(&mut |x: &[f64]| -> Result<_> { Ok((x[0], vec![1.0])) }, &mut |_: &[f64]| -> Result<_> {
                Ok(vec![f64::NAN])
            });
        assert!(matches!(step, Err(StepError::Curvature)));
        assert_eq!(solver, before);
    }
}
