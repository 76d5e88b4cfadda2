//! Adam (Kingma and Ba 2015), projected onto bounds: for losses with kinks or noise.

use super::{Bounds, Objective, Point, Step, StepError, largest_difference};
use antirad_base::setters;
use serde::{Deserialize, Serialize};

/// Options of Adam.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct AdamOptions {
    /// Learning rate: largest change of an unknown per step, in units of its scale.
    pub learning_rate: f64,
    /// Decay rates of the running means of the gradient and of its square.
    pub decay: [f64; 2],
}

setters!(AdamOptions { learning_rate: f64, decay: [f64; 2] });

impl Default for AdamOptions {
    fn default() -> Self {
        Self { learning_rate: 0.02, decay: [0.9, 0.999] }
    }
}

/// Prevents division by a zero root mean square.
const TINY: f64 = 1e-300;
/// How many times a step to a non-finite objective is halved before it fails.
const RETREATS: u32 = 20;

/// The state of Adam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    options: AdamOptions,
    pub(super) bounds: Bounds,
    pub(super) start: Vec<f64>,
    pub(super) point: Option<Point>,
    /// The lowest value so far and its point, since Adam may step uphill.
    best: Option<(f64, Vec<f64>)>,
    mean: Vec<f64>,
    square: Vec<f64>,
    steps: i32,
}

impl Adam {
    /// Starts at the projection of `x` onto `bounds`.
    pub fn new(mut x: Vec<f64>, bounds: Bounds, options: AdamOptions) -> Self {
        bounds.project(&mut x);
        let zeros = vec![0.0; x.len()];
        Self {
            options,
            bounds,
            start: x,
            point: None,
            best: None,
            mean: zeros.clone(),
            square: zeros,
            steps: 0,
        }
    }

    /// The current unknowns.
    pub fn x(&self) -> &[f64] {
        self.point.as_ref().map_or(&self.start, |point| &point.x)
    }

    /// The point of the lowest value so far.
    pub fn best(&self) -> &[f64] {
        self.best.as_ref().map_or(&self.start, |(_, x)| x)
    }

    /// One step: one evaluation, two for the first, more if the objective is not finite.
    ///
    /// # Errors
    /// Fails if the objective fails, is not finite at the start, or returns a gradient of the wrong length.
    pub fn step<E>(&mut self, objective: &mut Objective<E>) -> Result<Step, StepError<E>> {
        let mut evaluations = 0;
        let here = match &self.point {
            Some(point) => point.clone(),
            None => {
                evaluations += 1;
                Point::start(&self.start, objective)?
            }
        };
        let [keep_mean, keep_square] = self.options.decay;
        let blend = |old: &[f64], keep: f64, new: &dyn Fn(f64) -> f64| -> Vec<f64> {
            old.iter().zip(&here.gradient).map(|(old, &g)| keep * old + (1.0 - keep) * new(g)).collect()
        };
        let mean = blend(&self.mean, keep_mean, &|g| g);
        let square = blend(&self.square, keep_square, &|g| g * g);
        let steps = self.steps.saturating_add(1);
        let (unbias_mean, unbias_square) = (1.0 - keep_mean.powi(steps), 1.0 - keep_square.powi(steps));

        let mut rate = self.options.learning_rate;
        for _ in 0..RETREATS {
            let mut x = here.x.clone();
            for (i, x) in x.iter_mut().enumerate() {
                let root = (square[i] / unbias_square).sqrt();
                *x -= rate * (mean[i] / unbias_mean) / root.max(TINY);
            }
            self.bounds.project(&mut x);
            evaluations += 1;
            if let Some(next) = Point::evaluate(x, objective)? {
                let step = Step {
                    value: next.value,
                    gradient: self.bounds.projected_gradient(&next.x, &next.gradient),
                    length: largest_difference(&next.x, &here.x),
                    evaluations,
                    progress: next.x != here.x,
                };
                for point in [&here, &next] {
                    if self.best.as_ref().is_none_or(|(value, _)| point.value < *value) {
                        self.best = Some((point.value, point.x.clone()));
                    }
                }
                (self.point, self.mean, self.square, self.steps) = (Some(next), mean, square, steps);
                return Ok(step);
            }
            rate /= 2.0;
        }
        let gradient = self.bounds.projected_gradient(&here.x, &here.gradient);
        let value = here.value;
        self.best.get_or_insert_with(|| (value, here.x.clone()));
        self.point = Some(here);
        Ok(Step { value, gradient, length: 0.0, evaluations, progress: false })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Result, quadratic};
    use super::*;

    #[test]
    fn finds_the_corner_of_a_box() {
        let bounds = Bounds { lower: vec![0.0; 3], upper: vec![1.0; 3] };
        let options = AdamOptions { learning_rate: 0.05, ..AdamOptions::default() };
        let mut adam = Adam::new(vec![0.5; 3], bounds.clone(), options);
        let mut objective =
            |x: &[f64]| -> Result<_> { Ok(quadratic(&[1.0, 2.0, 3.0], &[3.0, -1.0, 0.25], 0.0, x)) };
        for _ in 0..400 {
            adam.step(&mut objective).expect("a step");
            assert!(bounds.contain(adam.x()));
        }
        let expected = [1.0, 0.0, 0.25];
        assert!(largest_difference(adam.x(), &expected) < 1e-3, "{:?}", adam.x());
    }

    #[test]
    fn steps_back_from_where_nothing_can_be_evaluated() {
        let mut adam = Adam::new(
            vec![0.0],
            Bounds::free(1),
            AdamOptions { learning_rate: 1.0, ..AdamOptions::default() },
        );
        // Falls towards a cliff at 1.
        let mut objective = |x: &[f64]| -> Result<_> {
            Ok(if x[0] < 0.9 {
                ((x[0] - 1.0).powi(2), vec![2.0 * (x[0] - 1.0)])
            } else {
                (f64::NAN, vec![0.0])
            })
        };
        for _ in 0..50 {
            adam.step(&mut objective).expect("a step");
            assert!(adam.x()[0] < 0.9);
        }
        assert!(adam.x()[0] > 0.7, "{:?}", adam.x());
        let mut nowhere = |_: &[f64]| -> Result<_> { Ok((f64::NAN, vec![0.0])) };
        let mut lost = Adam::new(vec![0.0], Bounds::free(1), AdamOptions::default());
        assert!(matches!(lost.step(&mut nowhere), Err(StepError::Start { value }) if value.is_nan()));
    }
}
