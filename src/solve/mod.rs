//! Solvers of H = U (E + (K - J) H), generic over where the vectors live.

mod fixed_point;
mod gmres;

pub use fixed_point::{FixedPointParams, fixed_point, fixed_point_from};
pub use gmres::{GmresParams, gmres, gmres_from, gmres_scratch};

use std::ops::ControlFlow;

/// The affine map of the light equation, and the vector space it acts on.
pub trait LightOperator {
    /// What the solvers add and multiply.
    type Vector;
    /// Why a pass may fail.
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
    /// y = b y.
    fn scale(&mut self, b: f64, y: &mut Self::Vector) -> Result<(), Self::Error>;
    /// The size of a vector that convergence is judged by: root of the area-weighted sum of squared irradiance. Unlike
    /// the reflected radiosity, of which it is a bound, it sees black surfaces too.
    fn magnitude(&mut self, x: &Self::Vector) -> Result<f64, Self::Error>;
}

/// How a solve went.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveInfo {
    /// Applications of the transport.
    pub passes: u32,
    /// Relative residual after each pass; of GMRES its own running estimate, the last one verified.
    pub residuals: Vec<f64>,
    /// Estimate of the spectral radius of U (K - J): of the fixed point from the decay of its residual, of GMRES from the
    /// Ritz values of its longest cycle. From 1 on, light is created somewhere, and what GMRES finds is not physical.
    pub spectral_radius: Option<f64>,
}

/// Why a solve stopped without an answer. All carry what was reached.
#[derive(Debug, thiserror::Error)]
pub enum SolveError<E> {
    #[error(
        "the solve diverges: relative residual {residual:.3e} after {passes} passes. Light is created in the scene: \
         look for interpenetrating triangles, stacked layers closer than a triangle's size, or an albedo near 1"
    )]
    /// The residual grows: light gains more by a bounce than it loses.
    Diverged {
        /// Passes made so far.
        passes: u32,
        /// The last relative residual.
        residual: f64,
        /// The relative residual after each pass.
        residuals: Vec<f64>,
    },
    #[error(
        "no convergence: relative residual {residual:.3e} after {passes} passes, wanted {tolerance:.1e}. Allow more \
         passes or a larger tolerance, or choose the other solver"
    )]
    /// `max_passes` were not enough.
    NoConvergence {
        /// Passes made so far.
        passes: u32,
        /// The last relative residual.
        residual: f64,
        /// The relative residual that was asked for.
        tolerance: f64,
        /// The relative residual after each pass.
        residuals: Vec<f64>,
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

/// Called after every pass with the number of passes and the relative residual; may stop the solve.
pub type Progress<'a> = dyn FnMut(u32, f64) -> ControlFlow<()> + 'a;

/// Counts passes, keeps their residuals and decides when to give up; shared by the solvers.
struct Watch<'a, 'b> {
    tolerance: f64,
    max_passes: u32,
    residuals: Vec<f64>,
    progress: &'a mut Progress<'b>,
}

/// Growth of the residual over the best one that counts as divergence: stacked layers may gain a few orders of
/// magnitude before they cancel (J U is non-normal), a radius above one has no bound.
const DIVERGENCE: f64 = 1e6;

impl<'a, 'b> Watch<'a, 'b> {
    fn new(tolerance: f64, max_passes: u32, progress: &'a mut Progress<'b>) -> Self {
        Self { tolerance, max_passes, residuals: Vec::new(), progress }
    }

    fn passes(&self) -> u32 {
        self.residuals.len() as u32
    }

    fn converged(&self, residual: f64) -> bool {
        residual <= self.tolerance
    }

    /// Records a pass.
    fn pass<E>(&mut self, residual: f64) -> Result<(), SolveError<E>> {
        self.residuals.push(residual);
        let passes = self.passes();
        let best = self.residuals.iter().copied().fold(f64::INFINITY, f64::min).max(self.tolerance);
        if !residual.is_finite() || residual > DIVERGENCE * best {
            return Err(SolveError::Diverged { passes, residual, residuals: self.residuals.clone() });
        }
        if (self.progress)(passes, residual).is_break() {
            return Err(SolveError::Interrupted { passes });
        }
        if passes >= self.max_passes && !self.converged(residual) {
            // Still growing at the end: more passes would not help.
            let first = self.residuals.first().copied().unwrap_or(residual);
            return Err(if residual > first {
                SolveError::Diverged { passes, residual, residuals: self.residuals.clone() }
            } else {
                let (tolerance, residuals) = (self.tolerance, self.residuals.clone());
                SolveError::NoConvergence { passes, residual, tolerance, residuals }
            });
        }
        Ok(())
    }

    fn info(self) -> SolveInfo {
        SolveInfo { passes: self.passes(), spectral_radius: None, residuals: self.residuals }
    }
}
