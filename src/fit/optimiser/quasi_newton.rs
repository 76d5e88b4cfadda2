//! L-BFGS-B, with a diagonal that learns: a quasi-Newton method within bounds, for smooth losses.

use super::cauchy::model_minimum;
use super::compact::Memory;
use super::line_search::{Found, Line};
use super::{Bounds, Objective, Point, Step, StepError, dot, largest_difference};
use crate::options::setters;
use serde::{Deserialize, Serialize};

/// How the quasi-Newton method goes about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct QuasiNewtonOptions {
    /// Steps whose change of gradient is remembered.
    pub memory: usize,
    /// Largest change of an unknown in the first step, in units of its scale: nothing is known of the curvature yet.
    pub first_step: f64,
    /// Rounding of the objective, relative to its value.
    pub noise: f64,
}

setters!(QuasiNewtonOptions { memory: usize, first_step: f64, noise: f64 });

impl Default for QuasiNewtonOptions {
    fn default() -> Self {
        Self { memory: 10, first_step: 0.1, noise: 1e-9 }
    }
}

/// The state of the quasi-Newton method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct QuasiNewton {
    options: QuasiNewtonOptions,
    bounds: Bounds,
    start: Vec<f64>,
    point: Option<Point>,
    memory: Memory,
}

impl QuasiNewton {
    /// Starts at the point within `bounds` that is nearest to `x`.
    pub fn new(mut x: Vec<f64>, bounds: Bounds, options: QuasiNewtonOptions) -> Self {
        bounds.project(&mut x);
        let memory = Memory::new(x.len());
        Self { options, bounds, start: x, point: None, memory }
    }

    /// The unknowns as they are now.
    pub fn x(&self) -> &[f64] {
        self.point.as_ref().map_or(&self.start, |point| &point.x)
    }

    pub(super) fn vectors(&self) -> usize {
        3 * self.options.memory + 10
    }

    /// One step along the way to the minimum of the model, with one evaluation as a rule, two for the first.
    pub fn step<E>(&mut self, objective: &mut Objective<E>) -> Result<Step, StepError<E>> {
        let mut evaluations = 0;
        let here = match &self.point {
            Some(point) => point.clone(),
            None => {
                evaluations += 1;
                Point::start(&self.start, objective)?
            }
        };
        let mut memory = self.memory.clone();
        // A memory that leads nowhere is forgotten, once; then the gradient alone must show the way.
        loop {
            let blank = memory.s.is_empty();
            if blank {
                let steepest = self.bounds.projected_gradient(&here.x, &here.gradient);
                let largest = here.gradient.iter().fold(0.0, |largest: f64, g| largest.max(g.abs()));
                // The projected gradient may be cut short by a bound that is near.
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
            let step = optimiser.step(&mut |x: &[f64]| -> Result<_> { Ok(objective(x)) }).expect("a step");
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

    /// With x_0 ≤ 0.5 the minimum over two unknowns is (0.5, 0.25): on the bound, down in the valley.
    #[test]
    fn rosenbrock_with_an_active_bound() {
        let bounds = Bounds { lower: vec![-2.0, -2.0], upper: vec![0.5, 2.0] };
        let mut optimiser = new(vec![-1.2, 1.0], bounds);
        let evaluations = minimise(&mut optimiser, 1e-10, rosenbrock);
        assert!(largest_difference(optimiser.x(), &[0.5, 0.25]) < 1e-9, "{:?}", optimiser.x());
        assert!(evaluations < 80, "{evaluations}");
    }

    /// Unknowns without coupling: the minimum is that of each alone, cut by its bounds.
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
        // The condition number is 3e5: without a diagonal that learns it takes 950.
        assert!(evaluations < 200, "{evaluations}");
    }

    /// Unknowns that are fixed by equal bounds stay where they are.
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

    /// A cliff in the way: beyond it nothing can be evaluated. The minimum before it is found all the same.
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
        let error = optimiser.step(&mut |_: &[f64]| -> Result<_> { Ok((f64::NAN, vec![0.0])) });
        let message = error.expect_err("no value").to_string();
        assert!(message.contains("not finite at the starting point (value NaN)"), "{message}");
        let short = optimiser.step(&mut |_: &[f64]| -> Result<_> { Ok((1.0, vec![])) });
        assert!(matches!(short, Err(StepError::Length { got: 0, expected: 1 })));
    }

    /// Values rounded as f32 rounds them: the gradient still leads to the minimum.
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

    /// At the minimum there is no way on, and the optimiser says so.
    #[test]
    fn no_progress_at_the_minimum() {
        let bounds = Bounds { lower: vec![0.0], upper: vec![1.0] };
        let mut optimiser = new(vec![0.0], bounds);
        let step = optimiser.step(&mut |x: &[f64]| -> Result<_> { Ok((x[0], vec![1.0])) }).expect("a step");
        assert_eq!(step, Step { value: 0.0, gradient: 0.0, length: 0.0, evaluations: 1, progress: false });
    }
}
