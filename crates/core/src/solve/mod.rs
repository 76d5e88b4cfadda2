//! Solvers of H = U (E + (K - J) H), generic over where the vectors live.

mod fixed_point;
mod gmres;

pub use fixed_point::{FixedPointParams, fixed_point, fixed_point_from};
pub use gmres::{GmresParams, gmres, gmres_from, gmres_scratch};

use std::fmt;
use std::ops::ControlFlow;

/// What the host knows of the next vector of an orthonormal basis.
#[derive(Clone, Debug, PartialEq)]
pub struct Orthonormalised {
    /// The coefficient of each projection, and last the norm of what they left.
    pub column: Vec<f64>,
    /// [`LightOperator::judged`] of the vector.
    pub judged: Option<Vec<f64>>,
}

/// The affine map of the light equation, and the vector space it acts on.
pub trait LightOperator {
    /// A vector of that space.
    type Vector;
    /// Error of a pass.
    type Error;

    /// A vector of zeros.
    fn vector(&mut self) -> Result<Self::Vector, Self::Error>;
    /// y = U (E + (K - J) x) with `emission`, y = U (K - J) x without. `None` stands for x = 0.
    fn pass(
        &mut self,
        x: Option<&Self::Vector>,
        emission: bool,
        y: &mut Self::Vector,
    ) -> Result<(), Self::Error>;
    /// ⟨x, y⟩.
    fn dot(&mut self, x: &Self::Vector, y: &Self::Vector) -> Result<f64, Self::Error>;
    /// y = a x + b y.
    fn combine(&mut self, a: f64, x: &Self::Vector, b: f64, y: &mut Self::Vector) -> Result<(), Self::Error>;
    /// y = Σ aᵢ xᵢ + y.
    fn accumulate(&mut self, a: &[f64], x: &[Self::Vector], y: &mut Self::Vector) -> Result<(), Self::Error> {
        a.iter().zip(x).try_for_each(|(a, x)| self.combine(*a, x, 1.0, y))
    }
    /// y = x - y, with x the last vector of an orthonormal basis; then y minus its projections onto the basis, one after the other (modified
    /// Gram-Schmidt), and normalised: the next vector of the basis. What is no larger than `spanned` is set to zero.
    fn orthonormalise(
        &mut self,
        basis: &[Self::Vector],
        y: &mut Self::Vector,
        spanned: f64,
    ) -> Result<Orthonormalised, Self::Error> {
        if let Some(x) = basis.last() {
            self.combine(1.0, x, -1.0, y)?;
        }
        let mut column = Vec::with_capacity(basis.len() + 1);
        for v in basis {
            let h = self.dot(v, y)?;
            self.combine(-h, v, 1.0, y)?;
            column.push(h);
        }
        let norm = self.dot(y, y)?.sqrt();
        self.scale(if norm <= spanned { 0.0 } else { 1.0 / norm }, y)?;
        column.push(norm);
        Ok(Orthonormalised { column, judged: self.judged(y)? })
    }
    /// y = b y.
    fn scale(&mut self, b: f64, y: &mut Self::Vector) -> Result<(), Self::Error>;
    /// The values of a vector that the convergence criterion uses, weighted so that their 2-norm is the
    /// vector's magnitude: irradiance times the square root of the area. It bounds reflected radiosity and,
    /// unlike it, includes black surfaces. `None` where the whole vector counts, as in
    /// [`LightOperator::dot`].
    fn judged(&mut self, x: &Self::Vector) -> Result<Option<Vec<f64>>, Self::Error>;
    /// Norm of a vector in the convergence criterion.
    fn magnitude(&mut self, x: &Self::Vector) -> Result<f64, Self::Error> {
        Ok(match self.judged(x)? {
            Some(values) => norm(&values),
            None => self.dot(x, x)?.sqrt(),
        })
    }
}

/// The 2-norm.
fn norm(values: &[f64]) -> f64 {
    values.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// How a solve went.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveInfo {
    /// Applications of the transport.
    pub passes: u32,
    /// Whether the tolerance was reached. If not, the result is the last iterate.
    pub converged: bool,
    /// Relative residual after each pass; within a cycle of GMRES computed from the basis. The last one is verified by a
    /// pass, unless rounding can't have changed it: [`GmresParams::rounding`].
    pub residuals: Vec<f64>,
    /// Estimate of the spectral radius of U (K - J): for the fixed point from the decay of its residual, for GMRES
    /// from the Ritz values of its longest cycle. From 1 on the discretisation creates light, and the solution of
    /// GMRES is not physical.
    pub spectral_radius: Option<f64>,
}

/// Why a solve stopped without a solution. `V` holds the last iterate.
#[derive(thiserror::Error)]
#[non_exhaustive]
pub enum SolveError<E, V> {
    #[error(
        "the solve diverges: relative residual {residual:.3e} after {passes} passes. {}",
        cause(*residual)
    )]
    /// The residual grows: a bounce creates more light than it absorbs.
    Diverged {
        /// Passes made so far.
        passes: u32,
        /// The last relative residual.
        residual: f64,
        /// The relative residual after each pass.
        residuals: Vec<f64>,
    },
    #[error(
        "no convergence: relative residual {residual:.3e} after {passes} passes, tolerance {tolerance:.1e}. {}",
        if *stagnated {
            "The last cycle reduced it by less than a tenth, so more passes would not help: use a larger tolerance, \
             precision f64 or the fixed point, and look for interpenetrating objects (antirad check)"
        } else {
            "Allow more passes or a larger tolerance, or choose the other solver"
        }
    )]
    /// `max_passes` were not enough, or the residual stagnated.
    NoConvergence {
        /// Passes made so far.
        passes: u32,
        /// The last relative residual.
        residual: f64,
        /// The relative residual required.
        tolerance: f64,
        /// Whether it stopped before `max_passes` because the residual stagnated.
        stagnated: bool,
        /// The relative residual after each pass.
        residuals: Vec<f64>,
        /// Estimate of the spectral radius of U (K - J): [`SolveInfo::spectral_radius`].
        spectral_radius: Option<f64>,
        /// The iterate with this residual.
        best: V,
    },
    /// The progress callback stopped the solve.
    #[error("interrupted after {passes} passes")]
    Interrupted {
        /// Passes made so far.
        passes: u32,
    },
    /// A pass failed.
    #[error(transparent)]
    Operator(#[from] E),
}

/// What made a solve diverge, by its last residual.
fn cause(residual: f64) -> &'static str {
    if residual.is_nan() {
        "Light spans more than the precision holds, f32 some 38 decades: use --precision f64, or leave out what is so faint"
    } else {
        "The scene creates light: look for interpenetrating triangles, stacked layers closer than a triangle's size, or an albedo near 1"
    }
}

/// Omits the iterate, which is large.
impl<E: fmt::Debug, V> fmt::Debug for SolveError<E, V> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Diverged { residuals, .. } => {
                f.debug_struct("Diverged").field("residuals", residuals).finish_non_exhaustive()
            }
            Self::NoConvergence { residuals, tolerance, stagnated, .. } => f
                .debug_struct("NoConvergence")
                .field("tolerance", tolerance)
                .field("stagnated", stagnated)
                .field("residuals", residuals)
                .finish_non_exhaustive(),
            Self::Interrupted { passes } => f.debug_struct("Interrupted").field("passes", passes).finish(),
            Self::Operator(error) => f.debug_tuple("Operator").field(error).finish(),
        }
    }
}

impl<E, V> SolveError<E, V> {
    /// Whether the solver ran but found no solution.
    pub fn is_without_answer(&self) -> bool {
        matches!(self, Self::Diverged { .. } | Self::NoConvergence { .. })
    }

    /// Converts the last iterate, `best`, and keeps the rest of the error.
    ///
    /// # Errors
    /// Fails if `make` does.
    pub fn map_best<W, F>(
        self,
        make: impl FnOnce(V, SolveInfo) -> Result<W, F>,
    ) -> Result<SolveError<E, W>, F> {
        Ok(match self {
            Self::NoConvergence {
                passes,
                residual,
                tolerance,
                stagnated,
                residuals,
                spectral_radius,
                best,
            } => {
                let info =
                    SolveInfo { passes, converged: false, residuals: residuals.clone(), spectral_radius };
                SolveError::NoConvergence {
                    passes,
                    residual,
                    tolerance,
                    stagnated,
                    residuals,
                    spectral_radius,
                    best: make(best, info)?,
                }
            }
            Self::Diverged { passes, residual, residuals } => {
                SolveError::Diverged { passes, residual, residuals }
            }
            Self::Interrupted { passes } => SolveError::Interrupted { passes },
            Self::Operator(error) => SolveError::Operator(error),
        })
    }
}

/// The error of a solver with an operator.
type Failed<O> = SolveError<<O as LightOperator>::Error, <O as LightOperator>::Vector>;
/// Result of a solver: the solution and how the solve went.
pub type Solved<O> = Result<(<O as LightOperator>::Vector, SolveInfo), Failed<O>>;

/// Called after each pass with the number of passes and the relative residual; may stop the solve.
pub type SolveProgress<'a> = dyn FnMut(u32, f64) -> ControlFlow<()> + 'a;

/// Counts passes, records their residuals and applies the stopping criteria; shared by the solvers.
struct ConvergenceMonitor<'a, 'b> {
    tolerance: f64,
    max_passes: u32,
    reduction: f64,
    residuals: Vec<f64>,
    progress: &'a mut SolveProgress<'b>,
}

/// Growth of the residual over the best one that counts as divergence: stacked layers may grow by a few orders of
/// magnitude before they cancel (J U is non-normal), a spectral radius above one grows without bound.
const DIVERGENCE: f64 = 1e6;

impl<'a, 'b> ConvergenceMonitor<'a, 'b> {
    fn new(tolerance: f64, max_passes: u32, reduction: f64, progress: &'a mut SolveProgress<'b>) -> Self {
        Self { tolerance, max_passes, reduction, residuals: Vec::new(), progress }
    }

    fn passes(&self) -> u32 {
        self.residuals.len() as u32
    }

    /// The residual at which to stop.
    fn enough(&self) -> f64 {
        self.tolerance.max(self.reduction * self.residuals[0])
    }

    /// Records a pass and decides how to continue.
    fn pass<E, V>(&mut self, residual: f64) -> Result<Next, SolveError<E, V>> {
        self.residuals.push(residual);
        let passes = self.passes();
        let best = self.residuals.iter().copied().fold(f64::INFINITY, f64::min).max(self.tolerance);
        // Still growing at the end, so more passes would not help.
        let last = passes >= self.max_passes && residual > self.residuals[0];
        if !residual.is_finite() || residual > DIVERGENCE * best || last {
            return Err(SolveError::Diverged { passes, residual, residuals: self.residuals.clone() });
        }
        if (self.progress)(passes, residual).is_break() {
            return Err(SolveError::Interrupted { passes });
        }
        Ok(match residual <= self.enough() {
            true => Next::Converged,
            false if passes >= self.max_passes => Next::GiveUp,
            false => Next::Continue,
        })
    }

    /// Summary of a verified solution.
    fn info(self, spectral_radius: Option<f64>) -> SolveInfo {
        SolveInfo { passes: self.passes(), converged: true, spectral_radius, residuals: self.residuals }
    }

    /// The error with the iterate of the last residual.
    fn no_convergence<E, V>(self, best: V, spectral_radius: Option<f64>) -> SolveError<E, V> {
        SolveError::NoConvergence {
            passes: self.passes(),
            stagnated: self.passes() < self.max_passes,
            residual: self.residuals.last().copied().unwrap_or(f64::INFINITY),
            tolerance: self.tolerance,
            residuals: self.residuals,
            spectral_radius,
            best,
        }
    }
}

/// Largest ratio of residuals over a cycle that counts as progress: at nine tenths, the next digit would take 22
/// cycles.
const STAGNATION: f64 = 0.9;

/// What to do after a pass.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Next {
    Converged,
    Continue,
    /// All passes allowed have been made, or the residual stagnates.
    GiveUp,
}
