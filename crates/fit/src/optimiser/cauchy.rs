//! Approximate minimum of the quadratic model within the bounds: the first minimum along the projected gradient path (the
//! generalised Cauchy point), improved by subspace minimisation over the unknowns that are free there (Byrd, Lu, Nocedal
//! and Zhu 1995; projected as by Morales and Nocedal 2011).

use super::compact::Compact;
use super::{Bounds, Point};
use nalgebra::{DMatrix, DVector};

/// A point within the bounds whose model value is lower than at `point`.
pub(super) fn model_minimum(point: &Point, bounds: &Bounds, hessian: &Compact) -> Vec<f64> {
    let Cauchy { x, along } = cauchy_point(point, bounds, hessian);
    improve(point, bounds, hessian, &x, &along).unwrap_or(x)
}

struct Cauchy {
    x: Vec<f64>,
    /// Wᵀ (x - x_0).
    along: DVector<f64>,
}

fn cauchy_point(point: &Point, bounds: &Bounds, hessian: &Compact) -> Cauchy {
    let Point { x: from, gradient, .. } = point;
    let n = from.len();
    let mut x = from.clone();
    // Breakpoints: the step along the negative gradient at which each unknown reaches a bound.
    let meets: Vec<f64> = (0..n)
        .map(|i| match gradient[i] {
            g if g < 0.0 => (from[i] - bounds.upper[i]) / g,
            g if g > 0.0 => (from[i] - bounds.lower[i]) / g,
            _ => f64::INFINITY,
        })
        .collect();
    let mut direction: Vec<f64> = (0..n).map(|i| if meets[i] > 0.0 { -gradient[i] } else { 0.0 }).collect();
    let mut corners: Vec<usize> = (0..n).filter(|&i| meets[i] > 0.0 && meets[i].is_finite()).collect();
    corners.sort_by(|&a, &b| meets[a].total_cmp(&meets[b]).then(a.cmp(&b)));

    let diagonal = hessian.diagonal();
    let mut p = hessian.transposed(&direction);
    let mut along = DVector::zeros(hessian.width());
    // Slope and curvature of the model along the path.
    let mut slope = -direction.iter().map(|d| d * d).sum::<f64>();
    let mut curvature = direction.iter().zip(diagonal).map(|(d, h)| h * d * d).sum::<f64>()
        - p.dot(&hessian.times_middle(&p));
    let least_curvature = f64::EPSILON * curvature.abs();
    let mut reached = 0.0;
    let mut ahead = if slope < 0.0 { -slope / curvature.max(f64::MIN_POSITIVE) } else { 0.0 };
    for corner in corners {
        let interval = meets[corner] - reached;
        if ahead < interval {
            break;
        }
        let g = gradient[corner];
        x[corner] = if g > 0.0 { bounds.lower[corner] } else { bounds.upper[corner] };
        let moved = x[corner] - from[corner];
        along += &p * interval;
        let row = hessian.row(corner);
        let middle_row = hessian.times_middle(&row);
        slope += interval * curvature + g * g + diagonal[corner] * g * moved - g * middle_row.dot(&along);
        curvature -= diagonal[corner] * g * g + 2.0 * g * middle_row.dot(&p) + g * g * middle_row.dot(&row);
        // Safeguard: rounding must not make the model unbounded.
        curvature = curvature.max(least_curvature);
        p += row * g;
        direction[corner] = 0.0;
        reached = meets[corner];
        ahead = if slope < 0.0 && curvature > 0.0 { -slope / curvature } else { 0.0 };
    }
    let end = reached + ahead;
    for i in 0..n {
        if direction[i] != 0.0 {
            x[i] = from[i] + end * direction[i];
        }
    }
    bounds.project(&mut x);
    along += p * ahead;
    Cauchy { x, along }
}

/// Minimises the model over the unknowns that are free at `cauchy`; `None` if that is no improvement.
fn improve(
    point: &Point,
    bounds: &Bounds,
    hessian: &Compact,
    cauchy: &[f64],
    along: &DVector<f64>,
) -> Option<Vec<f64>> {
    let Point { x: from, gradient, .. } = point;
    let free: Vec<usize> =
        (0..from.len()).filter(|&i| cauchy[i] > bounds.lower[i] && cauchy[i] < bounds.upper[i]).collect();
    if free.is_empty() || hessian.width() == 0 {
        return None;
    }
    let diagonal = hessian.diagonal();
    // -(the model's gradient at the Cauchy point), over the free unknowns.
    let mut residual: Vec<f64> =
        free.iter().map(|&i| -gradient[i] - diagonal[i] * (cauchy[i] - from[i])).collect();
    hessian.add_rows(&hessian.times_middle(along), &free, &mut residual);

    // The inverse of D - W M Wᵀ over them, by the Sherman-Morrison-Woodbury formula.
    let mut spread = vec![0.0; from.len()];
    for (&i, &r) in free.iter().zip(&residual) {
        spread[i] = r / diagonal[i];
    }
    let inner = hessian.times_middle(&hessian.transposed(&spread));
    let width = hessian.width();
    let system = DMatrix::identity(width, width) - hessian.middle() * hessian.gram(&free);
    let inner = system.lu().solve(&inner)?;
    let mut step = residual;
    hessian.add_rows(&inner, &free, &mut step);
    step.iter_mut().zip(&free).for_each(|(step, &i)| *step /= diagonal[i]);
    if step.iter().any(|s| !s.is_finite()) {
        return None;
    }

    let mut x = cauchy.to_vec();
    for (&i, s) in free.iter().zip(&step) {
        x[i] += s;
    }
    bounds.project(&mut x);
    let descent: f64 = x.iter().zip(from).zip(gradient).map(|((x, from), g)| (x - from) * g).sum();
    if descent < 0.0 {
        return Some(x);
    }
    // Projection has turned the direction uphill: stop at the first bound instead.
    let room = |(&i, &s): (&usize, &f64)| match s {
        s if s > 0.0 => (bounds.upper[i] - cauchy[i]) / s,
        s if s < 0.0 => (bounds.lower[i] - cauchy[i]) / s,
        _ => f64::INFINITY,
    };
    let share = free.iter().zip(&step).map(room).fold(1.0, f64::min);
    let mut x = cauchy.to_vec();
    for (&i, s) in free.iter().zip(&step) {
        x[i] += share * s;
    }
    bounds.project(&mut x);
    Some(x)
}
