//! Fixed-point (Neumann) iteration: every pass adds one bounce. Needs two vectors and nothing else.

use super::{LightOperator, Progress, SolveError, SolveInfo, Watch};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedPointParams {
    /// Relative residual at which to stop.
    pub tolerance: f64,
    pub max_passes: u32,
}

/// Iterates H ← U (E + (K - J) H) from zero until ‖H_new - H‖ / ‖H_new‖ is at most the tolerance.
pub fn fixed_point<O: LightOperator>(
    operator: &mut O,
    params: &FixedPointParams,
    progress: &mut Progress,
) -> Result<(O::Vector, SolveInfo), SolveError<O::Error>> {
    let mut watch = Watch::new(params.tolerance, params.max_passes, progress);
    let mut old = operator.vector()?;
    let mut new = operator.vector()?;
    operator.pass(None, true, &mut old)?;
    if operator.magnitude(&old)? == 0.0 {
        watch.pass(0.0)?;
        return Ok((old, watch.info()));
    }
    watch.pass(1.0)?;
    loop {
        operator.pass(Some(&old), true, &mut new)?;
        let size = operator.magnitude(&new)?;
        operator.combine(1.0, &new, -1.0, &mut old)?;
        let residual = operator.magnitude(&old)? / size;
        std::mem::swap(&mut old, &mut new);
        watch.pass(residual)?;
        if watch.converged(residual) {
            let info = watch.info();
            return Ok((old, SolveInfo { spectral_radius: decay(&info.residuals), ..info }));
        }
    }
}

/// Mean factor of the last residuals.
fn decay(residuals: &[f64]) -> Option<f64> {
    let tail = &residuals[residuals.len().saturating_sub(5)..];
    let (first, last) = (tail.first()?, tail.last()?);
    (tail.len() >= 3 && *first > 0.0).then(|| (last / first).powf(1.0 / (tail.len() as f64 - 1.0)))
}
