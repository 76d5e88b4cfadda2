//! L-BFGS-B (Byrd, Lu, Nocedal and Zhu 1995) with an adaptive diagonal: a bound-constrained quasi-Newton method for smooth
//! losses. Where a Hessian can be had, for few unknowns, the model starts from it (Gauss-Newton) instead of from a multiple
//! of the identity, and again wherever the model predicts badly; where its diagonal can be had, for many, it starts from that.
//! Gradients are exact either way, and so is the minimum.

use super::cauchy::model_minimum;
use super::compact::Memory;
use super::line_search::{Found, Line};
use super::{Bounds, Hessian, KnownHessian, Objective, Point, Step, StepError, dot, largest_difference};
use antirad_base::setters;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Options of the quasi-Newton method.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct QuasiNewtonOptions {
    /// Number of pairs of steps and gradient differences to keep.
    pub memory: usize,
    /// Largest change of an unknown in the first step, in units of its scale, as the curvature is still unknown.
    pub first_step: f64,
    /// Noise of the objective, relative to its value.
    pub noise: f64,
}

setters!(QuasiNewtonOptions { memory: usize, first_step: f64, noise: f64 });

impl Default for QuasiNewtonOptions {
    fn default() -> Self {
        Self { memory: 10, first_step: 0.1, noise: 1e-9 }
    }
}

/// Longest step along an eigenvector of a given Hessian, in units of the unknowns.
const LONGEST: f64 = 1.0;
/// The Hessian is asked for anew after a step that leaves more than this of the projected gradient, far from the minimum: where
/// it takes more than a tenth off the value.
const LEFT: f64 = 0.03;
const FALL: f64 = 0.1;

/// The state of the quasi-Newton method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct QuasiNewton {
    options: QuasiNewtonOptions,
    pub(super) bounds: Bounds,
    pub(super) start: Vec<f64>,
    pub(super) point: Option<Point>,
    memory: Memory,
    /// Whether the model is to start anew from a Hessian.
    stale: bool,
    /// Whether the diagonal is all that can be had of Hessians: steps soon show more.
    by_diagonal: bool,
}

impl QuasiNewton {
    /// Starts at the projection of `x` onto `bounds`.
    pub fn new(mut x: Vec<f64>, bounds: Bounds, options: QuasiNewtonOptions) -> Self {
        bounds.project(&mut x);
        let memory = Memory::new(x.len());
        Self { options, bounds, start: x, point: None, memory, stale: true, by_diagonal: false }
    }

    /// The current unknowns.
    pub fn x(&self) -> &[f64] {
        self.point.as_ref().map_or(&self.start, |point| &point.x)
    }

    /// By how much the minimum of the model is below the current value; infinite where nothing is known of the curvature.
    pub fn promise(&self) -> f64 {
        let known = self.point.as_ref().filter(|_| !self.stale);
        known.map_or(f64::INFINITY, |here| promise(here, &self.bounds, &self.memory))
    }

    /// Starts the model anew from the Hessian (row by row) at the current point, unless that is not finite, or zero.
    pub(crate) fn set_hessian(&mut self, hessian: &[f64]) {
        let memory =
            self.point.as_ref().and_then(|here| Memory::of_hessian(hessian, &here.gradient, LONGEST));
        if let Some(memory) = memory {
            (self.memory, self.stale) = (memory, false);
        }
    }

    /// What the model expects where some unknowns are held at 0: by how much the minimum is above the current value, and this optimiser started
    /// from there. `None` where nothing is known.
    pub(crate) fn without(&self, unknowns: Range<usize>) -> Option<(f64, Self)> {
        let (here, hessian) = self.point.as_ref().zip(self.memory.compact())?;
        let mut bounds = self.bounds.clone();
        let mut x = here.x.clone();
        for i in unknowns {
            (bounds.lower[i], bounds.upper[i], x[i]) = (0.0, 0.0, 0.0);
        }
        let at = |x: Vec<f64>| -> Point {
            let d: Vec<f64> = x.iter().zip(&here.x).map(|(x, from)| x - from).collect();
            let change = hessian.times(&d);
            let value = here.value + dot(&here.gradient, &d) + 0.5 * dot(&change, &d);
            let gradient = here.gradient.iter().zip(&change).map(|(g, change)| g + change).collect();
            Point { x, value, gradient }
        };
        let start = model_minimum(&at(x), &bounds, &hessian);
        let increase = at(start.clone()).value - here.value;
        let started = Self { bounds, start, point: None, stale: false, ..self.clone() };
        increase.is_finite().then_some((increase, started))
    }

    /// The Hessian of the model, row by row; `None` where nothing is known.
    pub fn hessian(&self) -> Option<Vec<f64>> {
        let compact = self.memory.compact().filter(|_| !self.memory.is_blank())?;
        let n = self.x().len();
        let column = |i: usize| {
            let mut unit = vec![0.0; n];
            unit[i] = 1.0;
            compact.times(&unit)
        };
        // It is symmetric.
        Some((0..n).flat_map(column).collect())
    }

    pub(super) fn vectors(&self) -> usize {
        3 * self.options.memory + 10
    }

    /// One step towards the minimum of the model, usually with one evaluation, two for the first. `hessian` is called at the
    /// point evaluated last.
    ///
    /// # Errors
    /// Fails if the objective or the Hessian fails, if the objective is not finite at the start, or if a
    /// gradient has the wrong length.
    pub fn step<E>(
        &mut self,
        objective: &mut Objective<E>,
        hessian: &mut Hessian<E>,
    ) -> Result<Step, StepError<E>> {
        let mut evaluations = 0;
        let here = match &self.point {
            Some(point) => point.clone(),
            None => {
                evaluations += 1;
                Point::start(&self.start, objective)?
            }
        };
        let mut memory = self.memory.clone();
        let given = match self.stale && (memory.is_blank() || !self.by_diagonal) {
            true => hessian(&here.x).map_err(StepError::Objective)?,
            false => None,
        };
        let is_whole = matches!(given, Some(KnownHessian::Whole(..)));
        self.by_diagonal |= matches!(given, Some(KnownHessian::Diagonal(..)));
        let seeded = match given {
            Some(KnownHessian::Whole(hessian)) => Memory::of_hessian(&hessian, &here.gradient, LONGEST),
            // Later, what the steps have shown is better.
            Some(KnownHessian::Diagonal(diagonal, coarse)) if memory.is_blank() => {
                Memory::of_diagonal(&diagonal, coarse, &here.gradient, LONGEST)
            }
            _ => None,
        };
        if let Some(seeded) = seeded {
            memory = seeded;
        }
        if is_whole && promise(&here, &self.bounds, &memory) < self.options.noise * here.value.abs() {
            // A lower value could not be told from noise.
            let gradient = self.bounds.projected_gradient(&here.x, &here.gradient);
            let step = Step { value: here.value, gradient, length: 0.0, evaluations, progress: false };
            (self.point, self.memory, self.stale) = (Some(here), memory, false);
            return Ok(step);
        }
        // If the model's direction fails, the memory is cleared once and the gradient alone is tried.
        loop {
            let blank = memory.is_blank();
            if blank {
                let steepest = self.bounds.projected_gradient(&here.x, &here.gradient);
                let largest = here.gradient.iter().fold(0.0, |largest: f64, g| largest.max(g.abs()));
                // A nearby bound may truncate the projected gradient.
                memory
                    .diagonal
                    .fill((steepest.max(largest) / self.options.first_step).max(f64::MIN_POSITIVE));
            }
            let found = match memory.compact() {
                Some(hessian) => {
                    let goal = model_minimum(&here, &self.bounds, &hessian);
                    self.search(&here, &goal, objective)?
                }
                None => Found { point: None, evaluations: 0 },
            };
            evaluations += found.evaluations;
            if let Some(next) = found.point {
                let difference = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect();
                memory.push(
                    difference(&next.x, &here.x),
                    difference(&next.gradient, &here.gradient),
                    self.options.memory,
                );
                let gradients = [&here, &next].map(|p| self.bounds.projected_gradient(&p.x, &p.gradient));
                self.stale =
                    gradients[1] > LEFT * gradients[0] && here.value - next.value > FALL * here.value.abs();
                let step = Step {
                    value: next.value,
                    gradient: self.bounds.projected_gradient(&next.x, &next.gradient),
                    length: largest_difference(&next.x, &here.x),
                    evaluations,
                    progress: true,
                };
                (self.point, self.memory) = (Some(next), memory);
                return Ok(step);
            }
            if blank {
                break;
            }
            memory = Memory::new(here.x.len());
        }
        let gradient = self.bounds.projected_gradient(&here.x, &here.gradient);
        let value = here.value;
        (self.point, self.memory) = (Some(here), memory);
        Ok(Step { value, gradient, length: 0.0, evaluations, progress: false })
    }

    fn search<E>(
        &self,
        here: &Point,
        goal: &[f64],
        objective: &mut Objective<E>,
    ) -> Result<Found, StepError<E>> {
        let direction: Vec<f64> = goal.iter().zip(&here.x).map(|(goal, x)| goal - x).collect();
        if dot(&direction, &here.gradient) >= 0.0 {
            return Ok(Found { point: None, evaluations: 0 });
        }
        let longest = self.bounds.longest_step(&here.x, &direction).max(1.0);
        Line { from: here, direction: &direction, bounds: &self.bounds, longest, noise: self.options.noise }
            .search(1.0, objective)
    }
}

/// By how much the minimum of a model is below the value at a point; infinite where nothing is known of the curvature.
fn promise(here: &Point, bounds: &Bounds, memory: &Memory) -> f64 {
    let Some(hessian) = memory.compact() else { return f64::INFINITY };
    // Half the slope towards the minimum.
    let goal = model_minimum(here, bounds, &hessian);
    let slope: f64 = goal.iter().zip(&here.x).zip(&here.gradient).map(|((goal, x), g)| g * (goal - x)).sum();
    -0.5 * slope
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Result, quadratic, rosenbrock};
    use super::*;

    /// Steps until no progress is made or the projected gradient is `small`; the number of evaluations.
    fn minimise(
        optimiser: &mut QuasiNewton,
        small: f64,
        mut objective: impl FnMut(&[f64]) -> (f64, Vec<f64>),
    ) -> u32 {
        let mut evaluations = 0;
        let mut last = f64::INFINITY;
        for _ in 0..2000 {
            let step = optimiser
                .step(&mut |x: &[f64]| -> Result<_> { Ok(objective(x)) }, &mut |_| Ok(None))
                .expect("a step");
            evaluations += step.evaluations;
            assert!(step.value <= last + 1e-8 * last.abs(), "{} after {last}", step.value);
            assert!(optimiser.bounds.contain(optimiser.x()));
            last = step.value;
            if step.gradient <= small || !step.progress {
                return evaluations;
            }
        }
        panic!("no end: {last}")
    }

    fn new(x: Vec<f64>, bounds: Bounds) -> QuasiNewton {
        QuasiNewton::new(x, bounds, QuasiNewtonOptions::default())
    }

    #[test]
    fn rosenbrock_without_bounds() {
        let n = 10;
        let mut optimiser =
            new((0..n).map(|i| if i % 2 == 0 { -1.2 } else { 1.0 }).collect(), Bounds::free(n));
        let evaluations = minimise(&mut optimiser, 1e-9, rosenbrock);
        assert!(largest_difference(optimiser.x(), &vec![1.0; n]) < 1e-8, "{:?}", optimiser.x());
        assert!(evaluations < 150, "{evaluations}");
    }

    /// With x_0 ≤ 0.5 the minimum over two unknowns is (0.5, 0.25): on the bound, in the valley.
    #[test]
    fn rosenbrock_with_an_active_bound() {
        let bounds = Bounds { lower: vec![-2.0, -2.0], upper: vec![0.5, 2.0] };
        let mut optimiser = new(vec![-1.2, 1.0], bounds);
        let evaluations = minimise(&mut optimiser, 1e-10, rosenbrock);
        assert!(largest_difference(optimiser.x(), &[0.5, 0.25]) < 1e-9, "{:?}", optimiser.x());
        assert!(evaluations < 80, "{evaluations}");
    }

    /// Without coupling, the minimum is that of each unknown alone, clamped to its bounds.
    #[test]
    fn a_known_active_set() {
        let n = 200;
        let wave = |a: f64| (0..n).map(|i| (a * (i as f64 + 1.0)).sin()).collect::<Vec<f64>>();
        let (c, h) = (wave(1.7), wave(0.3).iter().map(|s| 2.0 + s).collect::<Vec<f64>>());
        let bounds = Bounds { lower: vec![-0.4; n], upper: vec![0.6; n] };
        let mut optimiser = new(vec![0.0; n], bounds.clone());
        minimise(&mut optimiser, 1e-10, |x| quadratic(&h, &c, 0.0, x));
        let mut expected = c.clone();
        bounds.project(&mut expected);
        assert!(largest_difference(optimiser.x(), &expected) < 1e-9);
        let at_bounds = expected.iter().filter(|x| **x == -0.4 || **x == 0.6).count();
        assert!(at_bounds > n / 2, "{at_bounds}");
    }

    #[test]
    fn a_badly_scaled_quadratic() {
        let n = 12;
        let h: Vec<f64> = (0..n).map(|i| 10f64.powf(0.5 * f64::from(i) - 3.0)).collect();
        let n = n as usize;
        let c: Vec<f64> = (0..n).map(|i| 0.5 + i as f64).collect();
        let mut bounds = Bounds::free(n);
        bounds.upper[3] = 2.0;
        let mut optimiser = new(vec![0.0; n], bounds);
        let evaluations = minimise(&mut optimiser, 1e-11, |x| quadratic(&h, &c, 0.0, x));
        let mut expected = c.clone();
        expected[3] = 2.0;
        for (i, (x, expected)) in optimiser.x().iter().zip(&expected).enumerate() {
            assert!((x - expected).abs() * h[i].sqrt() < 1e-5, "unknown {i}: {x}, not {expected}");
        }
        // The condition number is 3e5: without the adaptive diagonal it takes 950.
        assert!(evaluations < 200, "{evaluations}");
    }

    /// Of (x_0 + x_1 - 2)²/2 + (x_0 - 1)²/2 + x_2²/2: without x_1 the minimum is 1/4, at x_0 = 3/2; without x_2 it is 0, as with it.
    #[test]
    fn what_is_expected_without_some_unknowns() {
        let hessian = [2.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let value = |x: &[f64]| {
            let (a, b, c) = (x[0] + x[1] - 2.0, x[0] - 1.0, x[2]);
            (0.5 * (a * a + b * b + c * c), vec![a + b, a, c])
        };
        let mut optimiser = new(vec![0.9, 0.8, 0.1], Bounds::free(3));
        assert!(optimiser.without(1..2).is_none(), "nothing is known yet");
        optimiser.step(&mut |x: &[f64]| -> Result<_> { Ok(value(x)) }, &mut |_| Ok(None)).expect("a step");
        optimiser.set_hessian(&hessian);
        let reached = value(optimiser.x()).0;
        for (unknown, minimum, x_0) in [(1, 0.25, 1.5), (2, 0.0, 1.0)] {
            let (increase, started) = optimiser.without(unknown..unknown + 1).expect("a model");
            assert!((reached + increase - minimum).abs() < 1e-9, "{unknown}: {increase}");
            assert!(started.x()[unknown] == 0.0 && (started.x()[0] - x_0).abs() < 1e-6, "{:?}", started.x());
        }
    }

    /// Unknowns with equal bounds stay fixed.
    #[test]
    fn equal_bounds_fix_an_unknown() {
        let bounds = Bounds { lower: vec![0.3, -5.0, 0.0], upper: vec![0.3, 5.0, 0.0] };
        let mut optimiser = new(vec![0.0; 3], bounds);
        minimise(&mut optimiser, 1e-12, |x| quadratic(&[1.0; 3], &[1.0; 3], 0.7, x));
        assert_eq!((optimiser.x()[0], optimiser.x()[2]), (0.3, 0.0));
        // 1·d + 0.7·(d - d_0) + 0.7·(d - d_2) = 0 with d = x - 1.
        let d = 0.7 * (-0.7 - 1.0) / 2.4;
        assert!((optimiser.x()[1] - 1.0 - d).abs() < 1e-10);
    }

    /// Beyond a cliff the objective is not finite; the minimum before it is still found.
    #[test]
    fn points_without_a_value_shorten_the_step() {
        for beyond in [f64::NAN, f64::INFINITY] {
            let mut optimiser = QuasiNewton::new(
                vec![0.0, 0.0],
                Bounds::free(2),
                QuasiNewtonOptions { first_step: 100.0, ..QuasiNewtonOptions::default() },
            );
            let mut refused = 0;
            minimise(&mut optimiser, 1e-10, |x| {
                if x[0] > 1.5 {
                    refused += 1;
                    return (beyond, vec![0.0; 2]);
                }
                quadratic(&[1.0, 30.0], &[1.4, 3.0], 0.0, x)
            });
            assert!(refused > 0);
            assert!(largest_difference(optimiser.x(), &[1.4, 3.0]) < 1e-8, "{:?}", optimiser.x());
        }
    }

    #[test]
    fn a_start_without_a_value_is_an_error() {
        let mut optimiser = new(vec![1.0], Bounds::free(1));
        let error =
            optimiser.step(&mut |_: &[f64]| -> Result<_> { Ok((f64::NAN, vec![0.0])) }, &mut |_| Ok(None));
        let message = error.expect_err("no value").to_string();
        assert!(message.contains("not finite at the starting point (value NaN)"), "{message}");
        let short = optimiser.step(&mut |_: &[f64]| -> Result<_> { Ok((1.0, vec![])) }, &mut |_| Ok(None));
        assert!(matches!(short, Err(StepError::Length { got: 0, expected: 1 })));
    }

    /// Σ r², its gradient and its Gauss-Newton Hessian, of residuals r_i = 3^i (x_i + 0.2 x_i² + 0.3 x_{i+1} - 0.8).
    fn stiff(x: &[f64]) -> (f64, Vec<f64>, Vec<f64>) {
        let n = x.len();
        let (mut value, mut gradient, mut hessian) = (0.0, vec![0.0; n], vec![0.0; n * n]);
        for i in 0..n {
            let (scale, next) = (3f64.powi(i as i32), (i + 1) % n);
            let r = scale * (x[i] + 0.2 * x[i] * x[i] + 0.3 * x[next] - 0.8);
            let slopes = [(i, scale * (1.0 + 0.4 * x[i])), (next, 0.3 * scale)];
            value += r * r;
            for (a, slope) in slopes {
                gradient[a] += 2.0 * r * slope;
                slopes.iter().for_each(|&(b, other)| hessian[a * n + b] += 2.0 * slope * other);
            }
        }
        (value, gradient, hessian)
    }

    /// With Hessians it takes a fraction of the evaluations to the same minimum, within bounds as without.
    #[test]
    fn hessians_save_evaluations() {
        let n = 6;
        let run = |bounds: &Bounds, given: bool| {
            let mut optimiser = new(vec![0.0; n], bounds.clone());
            let (mut evaluations, mut hessians) = (0, 0);
            for _ in 0..500 {
                let mut objective = |x: &[f64]| -> Result<_> {
                    let (value, gradient, _) = stiff(x);
                    Ok((value, gradient))
                };
                let mut hessian = |x: &[f64]| -> Result<_> {
                    hessians += u32::from(given);
                    Ok(given.then(|| KnownHessian::Whole(stiff(x).2)))
                };
                let step = optimiser.step(&mut objective, &mut hessian).expect("a step");
                evaluations += step.evaluations;
                if step.gradient < 1e-9 || !step.progress {
                    break;
                }
            }
            (optimiser.x().to_vec(), evaluations, hessians)
        };
        let mut narrow = Bounds { lower: vec![-2.0; n], upper: vec![2.0; n] };
        narrow.upper[1] = 0.3;
        narrow.lower[4] = 0.7;
        for bounds in [Bounds::free(n), narrow] {
            let (without, slow, _) = run(&bounds, false);
            let (with, fast, hessians) = run(&bounds, true);
            assert!(largest_difference(&with, &without) < 1e-6, "{with:?}, not {without:?}");
            assert!(2 * (fast + hessians) < slow, "{fast} and {hessians} Hessians, not far below {slow}");
        }
    }

    /// Curvatures over six orders of magnitude: the diagonal of the Hessian saves learning them. Entries of 0 are unknown.
    #[test]
    fn a_diagonal_saves_evaluations() {
        let n = 60;
        let h: Vec<f64> = (0..n).map(|i| 10f64.powf(f64::from(i % 7) - 3.0)).collect();
        let c: Vec<f64> = (0..n).map(|i| 0.1 * f64::from(i % 11)).collect();
        let run = |diagonal: Option<Vec<f64>>| {
            let mut optimiser = new(vec![0.0; n as usize], Bounds::free(n as usize));
            let mut evaluations = 0;
            for _ in 0..500 {
                let mut objective = |x: &[f64]| -> Result<_> { Ok(quadratic(&h, &c, 0.0, x)) };
                let mut hessian = |_: &[f64]| -> Result<_> {
                    Ok(diagonal.clone().map(|diagonal| KnownHessian::Diagonal(diagonal, None)))
                };
                let step = optimiser.step(&mut objective, &mut hessian).expect("a step");
                evaluations += step.evaluations;
                if step.gradient < 1e-9 || !step.progress {
                    break;
                }
            }
            assert!(largest_difference(optimiser.x(), &c) < 1e-5, "{:?}", optimiser.x());
            evaluations
        };
        let slow = run(None);
        let roughly: Vec<f64> = h.iter().zip(0..).map(|(h, i)| h * [0.7, 1.0, 1.3][i % 3]).collect();
        let fast = run(Some(roughly.clone()));
        assert!(4 * fast < slow, "{fast}, not far below {slow}");
        let gaps = roughly.iter().zip(0..).map(|(h, i)| if i % 5 == 0 { 0.0 } else { *h }).collect();
        assert!(run(Some(gaps)) < slow);
        assert_eq!(run(Some(vec![0.0; n as usize])), slow);
    }

    /// Values rounded to f32: the gradient still leads to the minimum.
    #[test]
    fn rounded_values_do_not_stop_it_early() {
        let mut optimiser = QuasiNewton::new(
            vec![-1.2, 1.0],
            Bounds::free(2),
            QuasiNewtonOptions { noise: 1e-6, ..QuasiNewtonOptions::default() },
        );
        minimise(&mut optimiser, 1e-6, |x| {
            let (value, gradient) = rosenbrock(x);
            (f64::from((value + 1.0) as f32), gradient)
        });
        assert!(largest_difference(optimiser.x(), &[1.0; 2]) < 1e-5, "{:?}", optimiser.x());
    }

    /// At the minimum the optimiser reports no progress.
    #[test]
    fn no_progress_at_the_minimum() {
        let bounds = Bounds { lower: vec![0.0], upper: vec![1.0] };
        let mut optimiser = new(vec![0.0], bounds);
        let step = optimiser
            .step(&mut |x: &[f64]| -> Result<_> { Ok((x[0], vec![1.0])) }, &mut |_| Ok(None))
            .expect("a step");
        assert_eq!(step, Step { value: 0.0, gradient: 0.0, length: 0.0, evaluations: 1, progress: false });
    }
}
