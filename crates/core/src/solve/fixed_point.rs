//! Fixed-point (Neumann) iteration: each pass adds one bounce. Needs two vectors only.

use super::{ConvergenceMonitor, LightOperator, Next, SolveProgress, Solved};

/// Stopping criteria of the fixed point.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FixedPointParams {
    /// Relative residual at which to stop.
    pub tolerance: f64,
    /// Largest number of passes; a solve that needs more fails.
    pub max_passes: u32,
    /// Fraction of the first residual at which to stop, too; 0 for never.
    pub reduction: f64,
}

impl FixedPointParams {
    /// Parameters of a solve to a relative residual of `tolerance`, in at most `max_passes` passes.
    pub fn new(tolerance: f64, max_passes: u32) -> Self {
        Self { tolerance, max_passes, reduction: 0.0 }
    }
}

/// Iterates H ← U (E + (K - J) H) from zero until ‖H_new - H‖ / ‖H_new‖ is at most the tolerance.
///
/// # Errors
/// Fails if a pass fails, if the residual diverges or is above the tolerance after `max_passes` passes, or if
/// `progress` stops the solve.
pub fn fixed_point<O: LightOperator + ?Sized>(
    operator: &mut O,
    params: &FixedPointParams,
    progress: &mut SolveProgress,
) -> Solved<O> {
    fixed_point_from(operator, None, params, progress)
}

/// Iterates like [`fixed_point`], but from an initial guess rather than from zero; `None` for zero.
///
/// # Errors
/// Fails if a pass fails, if the residual diverges or is above the tolerance after `max_passes` passes, or if
/// `progress` stops the solve.
pub fn fixed_point_from<O: LightOperator + ?Sized>(
    operator: &mut O,
    guess: Option<O::Vector>,
    params: &FixedPointParams,
    progress: &mut SolveProgress,
) -> Solved<O> {
    let mut monitor =
        ConvergenceMonitor::new(params.tolerance, params.max_passes, params.reduction, progress);
    let guessed = guess.is_some();
    let mut old = match guess {
        Some(guess) => guess,
        None => operator.vector()?,
    };
    let mut new = operator.vector()?;
    if !guessed {
        operator.pass(None, true, &mut old)?;
        if operator.magnitude(&old)? == 0.0 {
            monitor.pass(0.0)?;
            return Ok((old, monitor.info(None)));
        }
        if monitor.pass(1.0)? == Next::GiveUp {
            return Err(monitor.no_convergence(old, None));
        }
    }
    loop {
        operator.pass(Some(&old), true, &mut new)?;
        let size = operator.magnitude(&new)?;
        operator.combine(1.0, &new, -1.0, &mut old)?;
        let change = operator.magnitude(&old)?;
        let residual = if size > 0.0 { change / size } else { change };
        std::mem::swap(&mut old, &mut new);
        let next = monitor.pass(residual)?;
        let radius = decay(&monitor.residuals);
        match next {
            Next::Converged => return Ok((old, monitor.info(radius))),
            Next::GiveUp => return Err(monitor.no_convergence(old, radius)),
            Next::Continue => {}
        }
    }
}

/// Mean ratio of successive residuals over the last five.
fn decay(residuals: &[f64]) -> Option<f64> {
    let tail = &residuals[residuals.len().saturating_sub(5)..];
    let (first, last) = (tail.first()?, tail.last()?);
    (tail.len() >= 3 && *first > 0.0).then(|| (last / first).powf(1.0 / (tail.len() as f64 - 1.0)))
}
