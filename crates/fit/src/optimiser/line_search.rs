//! A line search for the strong Wolfe conditions, robust against rounding and non-finite values.

use super::{Bounds, Objective, Point, StepError, dot};

/// Constants of the Wolfe conditions (sufficient decrease, curvature): the usual values for quasi-Newton methods.
const DECREASE: f64 = 1e-4;
const FLATTER: f64 = 0.9;
const MAX_EVALUATIONS: u32 = 15;
/// Trial steps keep at least this fraction of the interval from its ends.
const MARGIN: f64 = 0.1;

/// The line from `from` along `direction`.
pub(super) struct Line<'a> {
    pub from: &'a Point,
    pub direction: &'a [f64],
    pub bounds: &'a Bounds,
    /// The longest step within the bounds, as a multiple of `direction`.
    pub longest: f64,
    /// Relative rounding of the objective, within which slopes decide instead of values.
    pub noise: f64,
}

/// One end of the interval that contains an acceptable step.
#[derive(Clone)]
struct End {
    step: f64,
    value: f64,
    slope: f64,
}

/// The point found, if lower, and the number of evaluations.
pub(super) struct Found {
    pub point: Option<Point>,
    pub evaluations: u32,
}

impl Line<'_> {
    fn at(&self, step: f64) -> Vec<f64> {
        let mut x: Vec<f64> = self.from.x.iter().zip(self.direction).map(|(x, d)| x + step * d).collect();
        // Rounding may carry a coordinate past its bound.
        self.bounds.project(&mut x);
        x
    }

    /// Searches along the line, starting with a step of `first`.
    ///
    /// # Errors
    /// Fails if the objective fails, or returns a gradient of the wrong length.
    pub fn search<E>(&self, first: f64, objective: &mut Objective<E>) -> Result<Found, StepError<E>> {
        let start =
            End { step: 0.0, value: self.from.value, slope: dot(&self.from.gradient, self.direction) };
        let mut evaluations = 0;
        if start.slope.is_nan() || start.slope >= 0.0 || self.longest <= 0.0 {
            return Ok(Found { point: None, evaluations });
        }
        let tolerated = self.from.value + self.noise * self.from.value.abs();
        let enough = |end: &End| end.value <= start.value + DECREASE * end.step * start.slope;
        let flat = |end: &End| end.slope.abs() <= -FLATTER * start.slope;
        // Approximate Wolfe conditions (Hager and Zhang 2005): slopes still decide where values differ by rounding only.
        let flat_within_noise = |end: &End| {
            end.value <= tolerated
                && end.slope >= FLATTER * start.slope
                && end.slope <= (2.0 * DECREASE - 1.0) * start.slope
        };

        let mut best: Option<Point> = None;
        let mut low = start.clone();
        // The far end: `None` while the interval is unbounded; not finite where the objective is not.
        let mut high: Option<(f64, Option<End>)> = None;
        let mut step = first.min(self.longest);
        while evaluations < MAX_EVALUATIONS {
            let x = self.at(step);
            // The interval is below rounding, or the first step failed and the possible gain is below rounding: further
            // evaluations are useless.
            let gain = -start.slope * step;
            if x == self.from.x || (evaluations > 0 && gain <= self.noise * start.value.abs()) {
                break;
            }
            evaluations += 1;
            let Some(point) = Point::evaluate(x, objective)? else {
                high = Some((step, None));
                step = low.step + (step - low.step) / 4.0;
                continue;
            };
            let end = End { step, value: point.value, slope: dot(&point.gradient, self.direction) };
            let accepted = (enough(&end) && flat(&end)) || flat_within_noise(&end);
            let better = best.as_ref().is_none_or(|best| point.value < best.value);
            if enough(&end) && better {
                best = Some(point.clone());
            }
            if accepted {
                return Ok(Found { point: Some(point), evaluations });
            }
            let too_far = !(enough(&end) && (end.value < low.value || low.step == 0.0));
            if too_far {
                high = Some((end.step, Some(end)));
            } else {
                let reversed = match &high {
                    Some((far, _)) => end.slope * (far - low.step) >= 0.0,
                    None => end.slope >= 0.0,
                };
                if reversed {
                    high = Some((low.step, Some(low)));
                }
                low = end;
            }
            step = match &high {
                None if low.step >= self.longest => break,
                None => (4.0 * low.step).min(self.longest),
                Some((far, None)) => low.step + (far - low.step) / 2.0,
                Some((_, Some(high))) => between(&low, high),
            };
        }
        // No step satisfies the curvature condition, but a lower value is accepted: at a bound, or at the limit of rounding.
        Ok(Found { point: best, evaluations })
    }
}

/// The minimum of the cubic through both ends, kept away from them.
fn between(low: &End, high: &End) -> f64 {
    let width = high.step - low.step;
    let a = low.slope + high.slope - 3.0 * (low.value - high.value) / (low.step - high.step);
    let root = (a * a - low.slope * high.slope).sqrt().copysign(width);
    let step = high.step - width * (high.slope + root - a) / (high.slope - low.slope + 2.0 * root);
    let (first, last) = (low.step + MARGIN * width, high.step - MARGIN * width);
    let (least, most) = (first.min(last), first.max(last));
    if step.is_finite() { step.clamp(least, most) } else { low.step + width / 2.0 }
}
