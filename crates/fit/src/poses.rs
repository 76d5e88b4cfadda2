//! Poses of cameras, each by itself: with light and surfaces held fixed, a picture depends on the pose of its own camera alone.

use super::job::Record;
use super::optimiser::largest_difference;
use super::parameters::Pose;
use super::problem::Problem;
use super::renderer::{RenderError, Renderer};
use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use std::collections::{HashMap, HashSet};
use std::ops::ControlFlow;

/// Most evaluations.
const EVALUATIONS: u32 = 12;
/// Damping of the first step, and its factors after steps that failed and that did not.
const DAMPING: f64 = 1e-3;
const MORE: f64 = 8.0;
const LESS: f64 = 0.2;
const MOST_DAMPING: f64 = 1e3;
/// Longest step, in units of the unknowns.
const LONGEST: f64 = 1.0;
/// Fall of the loss from which on the curvature is found anew; after a smaller one, the step itself tells more.
const FALL: f64 = 0.1;
/// What poses are found to: steps in units of half a pixel, or by how much they are expected to lower the loss.
const SMALL: f64 = 0.04;
const LITTLE: f64 = 5e-5;

/// The search for one pose, by the method of Levenberg (1944) and Marquardt (1963).
struct Search {
    pose: Pose,
    damping: f64,
    best: Option<Best>,
    is_over: bool,
}

/// The best pose so far: its unknowns, the loss of its pictures, gradient and curvature.
struct Best {
    x: DVector<f64>,
    value: f64,
    gradient: DVector<f64>,
    curvature: DMatrix<f64>,
}

impl Search {
    fn new(pose: Pose) -> Self {
        Self { pose, damping: DAMPING, best: None, is_over: false }
    }

    fn value(&self) -> f64 {
        self.best.as_ref().map_or(f64::INFINITY, |best| best.value)
    }

    /// Whether the curvature of a pose with a lower loss is to be found anew.
    fn is_far_from(&self, value: f64) -> bool {
        self.best.as_ref().is_none_or(|best| best.value - value > FALL * best.value)
    }

    /// Takes a pose that is better. `curvature`: that there, if it was found anew.
    fn take(&mut self, x: DVector<f64>, value: f64, gradient: DVector<f64>, curvature: Option<DMatrix<f64>>) {
        let by_step = |best: &Best| updated(&best.curvature, &(&x - &best.x), &(&gradient - &best.gradient));
        if let Some(curvature) = curvature.or_else(|| self.best.as_ref().map(by_step)) {
            self.best = Some(Best { x, value, gradient, curvature });
        }
        self.damping *= LESS;
    }

    /// The pose to try next, unless the search is over. `small`: a step that is not worth an evaluation.
    fn next(&mut self, small: f64) -> Option<DVector<f64>> {
        let next = self.best.as_ref().filter(|_| self.damping <= MOST_DAMPING).and_then(|best| {
            let step = best.step(self.damping)?;
            let fall = -best.gradient.dot(&step) - 0.5 * step.dot(&(&best.curvature * &step));
            (step.amax() > small && fall > LITTLE * best.value).then(|| &best.x + step)
        });
        self.is_over = next.is_none();
        next
    }
}

impl Best {
    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let diagonal = self.curvature.diagonal();
        // Of what pictures do not show there is no curvature.
        let floor = DVector::from_element(diagonal.len(), 1e-9 * diagonal.max());
        let damped = &self.curvature + DMatrix::from_diagonal(&(damping * diagonal + floor));
        let step = -damped.cholesky()?.solve(&self.gradient);
        Some(&step * (LONGEST / step.amax()).min(1.0))
    }
}

/// The update of a curvature after a step by BFGS, damped so that it stays positive (Powell 1978).
fn updated(curvature: &DMatrix<f64>, step: &DVector<f64>, change: &DVector<f64>) -> DMatrix<f64> {
    let expected = curvature * step;
    let (along, found) = (step.dot(&expected), step.dot(change));
    let share = if found < 0.2 * along { 0.8 * along / (along - found) } else { 1.0 };
    let change = share * change + (1.0 - share) * &expected;
    let found = step.dot(&change);
    if !(along > 0.0 && found > 0.0) {
        return curvature.clone();
    }
    curvature + &change * change.transpose() / found - &expected * expected.transpose() / along
}

impl Problem {
    /// Unknowns with the pose of each camera nearer to the minimum of the loss of its pictures, found for all side by side. Other unknowns stay.
    /// `watch` gets each evaluation: loss and gradient of the best so far, and the largest change that is tried next.
    ///
    /// # Errors
    /// Fails if pictures or their derivatives cannot be rendered, or if `watch` interrupts.
    pub(super) fn with_poses(
        &self,
        x: &[f64],
        renderer: &mut dyn Renderer,
        watch: &mut dyn FnMut(Record) -> ControlFlow<()>,
    ) -> Result<Vec<f64>, RenderError> {
        let half_pixels = self.parameters.steps(1.0);
        let mut searches: Vec<Search> = self.parameters.poses().into_iter().map(Search::new).collect();
        let (mut best, mut trial) = (x.to_vec(), x.to_vec());
        for evaluation in 0..EVALUATIONS {
            let passes = renderer.passes();
            self.look(&trial, &mut searches, renderer)?;
            for Search { pose, best: found, .. } in &searches {
                found
                    .iter()
                    .for_each(|found| best[pose.unknowns.clone()].copy_from_slice(found.x.as_slice()));
            }
            trial.clone_from(&best);
            for search in searches.iter_mut().filter(|search| !search.is_over) {
                let unknowns = search.pose.unknowns.clone();
                if let Some(next) = search.next(SMALL * half_pixels[unknowns.start]) {
                    trial[unknowns].copy_from_slice(next.as_slice());
                }
            }
            self.parameters.bounds().project(&mut trial);
            let steepness = |search: &Search| search.best.as_ref().map(|best| best.gradient.amax());
            let record = Record {
                iteration: evaluation,
                loss: searches.iter().map(Search::value).sum(),
                gradient: searches.iter().filter_map(steepness).fold(0.0, f64::max),
                step: largest_difference(&trial, &best),
                evaluations: 1,
                passes: renderer.passes() - passes,
                first_stage: true,
            };
            if watch(record).is_break() {
                return Err(RenderError::Interrupted);
            }
            if searches.iter().all(|search| search.is_over) {
                break;
            }
        }
        Ok(best)
    }

    /// Tries a pose for each search that is not over.
    fn look(
        &self,
        trial: &[f64],
        searches: &mut [Search],
        renderer: &mut dyn Renderer,
    ) -> Result<(), RenderError> {
        let pictures = renderer.pictures(&self.parameters.scene(trial))?;
        let sensors = self.sensors(&pictures);
        let (views, _, mut by_pixels) = self.compare(&pictures, &sensors);
        let weights = self.weights();
        let own = |of: &[f64], pose: &Pose| DVector::from_column_slice(&of[pose.unknowns.clone()]);
        let value = |pose: &Pose| {
            let of_pictures: f64 = pose.views.iter().map(|&view| weights[view] * views[view]).sum();
            of_pictures + self.regularised_pose(pose, &own(trial, pose)).0
        };
        let on = searches.iter_mut().filter(|search| !search.is_over);
        let (better, others): (Vec<_>, Vec<_>) = on.partition(|search| value(&search.pose) < search.value());
        others.into_iter().for_each(|search| search.damping *= MORE);

        // Of others, derivatives are not asked for.
        let wanted: HashSet<usize> = better.iter().flat_map(|search| search.pose.views.clone()).collect();
        let unwanted = by_pixels.iter_mut().enumerate().filter(|(view, _)| !wanted.contains(view));
        unwanted.for_each(|(_, by_pixels)| by_pixels.fill(DVec3::ZERO));
        let Some(gradient) = self.by_poses(trial, &by_pixels, renderer)? else { return Ok(()) };
        let mut curvatures = HashMap::new();
        if better.iter().any(|search| search.is_far_from(value(&search.pose))) {
            let found = self.curvatures_by_poses(trial, &pictures, &sensors, renderer)?;
            curvatures = found.unwrap_or_default();
        }
        for search in better {
            let (x, value) = (own(trial, &search.pose), value(&search.pose));
            let gradient = own(&gradient, &search.pose) + self.regularised_pose(&search.pose, &x).1;
            let curvature = curvatures.remove(&search.pose.unknowns.start);
            let curvature = curvature.filter(|_| search.is_far_from(value));
            search.take(x, value, gradient, curvature);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A narrow curved valley, whose curvature is known to a third: steps show the rest, and a cliff shortens them.
    #[test]
    fn a_search_ends_at_the_minimum() {
        let minimum = DVector::from_column_slice(&[0.7, -0.4, 0.2]);
        let scales = DVector::from_column_slice(&[100.0, 1.0, 10.0]);
        let loss = |x: &DVector<f64>| {
            if x[0] > 0.9 {
                return (f64::INFINITY, DVector::zeros(3));
            }
            let off = x - &minimum;
            let gradient = scales.component_mul(&off.map(|d| d + 0.4 * d.powi(3)));
            let value = scales.dot(&off.map(|d| 0.5 * d * d + 0.1 * d.powi(4)));
            (1e-3 + value, gradient)
        };
        let curvature = DMatrix::from_diagonal(&(0.6 * &scales));
        let mut search = Search::new(Pose { unknowns: 0..3, views: vec![0] });
        let mut trial = DVector::zeros(3);
        for _ in 0..2 * EVALUATIONS {
            let (value, gradient) = loss(&trial);
            if value < search.value() {
                let anew = search.is_far_from(value).then(|| curvature.clone());
                search.take(trial.clone(), value, gradient, anew);
            } else {
                search.damping *= MORE;
            }
            match search.next(1e-4) {
                Some(next) => trial = next,
                None => break,
            }
        }
        let best = search.best.expect("a start with a loss");
        assert!(search.is_over && (&best.x - &minimum).amax() < 1e-3, "{}", best.x);
    }

    #[test]
    fn an_updated_curvature_explains_the_step() {
        let curvature = DMatrix::from_diagonal(&DVector::from_column_slice(&[1.0, 2.0]));
        let step = DVector::from_column_slice(&[0.3, 0.1]);
        let change = DVector::from_column_slice(&[0.5, 0.2]);
        assert!((updated(&curvature, &step, &change) * &step - &change).amax() < 1e-12);
        // Of a step along which the gradient falls, positive definite all the same.
        assert!(updated(&curvature, &step, &-change).cholesky().is_some());
    }
}
