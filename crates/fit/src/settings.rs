//! Settings of a fit.

use super::loss::LossKind;
use super::optimiser::{AdamOptions, QuasiNewtonOptions};
use super::parameters::Fit;
use super::regulariser::Regulariser;
use antirad_base::setters;
use antirad_render::image::PictureOptions;
use antirad_render::shading::Shading;
use serde::{Deserialize, Serialize};

/// Kind of optimiser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OptimiserKind {
    /// Bounded least squares if only emission is fitted, with the loss L2; else the quasi-Newton method, which copes better
    /// with the widely different weights of a relative loss.
    #[default]
    Auto,
    /// L-BFGS-B (Byrd et al. 1995).
    QuasiNewton,
    /// Adam, projected onto bounds.
    Adam,
    /// Bounded linear least squares: for emission alone, with the loss L2 or relative L2.
    LeastSquares,
}

/// Stopping rule: a fit ends as soon as one of these holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StopRule {
    /// Maximum number of iterations.
    pub iterations: u32,
    /// Relative decrease of the loss over the last five iterations (with Adam: fifty) below which to stop, or over the last one where the
    /// quasi-Newton model promises a tenth of that from the next; 0 for never.
    pub relative_decrease: f64,
    /// Projected gradient, relative to that at the start, below which to stop.
    pub gradient: f64,
    /// Target loss.
    pub loss: f64,
    /// Time limit over all runs of this job, s.
    pub seconds: f64,
}

setters!(StopRule { iterations: u32, relative_decrease: f64, gradient: f64, loss: f64, seconds: f64 });

impl Default for StopRule {
    fn default() -> Self {
        Self { iterations: 200, relative_decrease: 1e-4, gradient: 1e-7, loss: 0.0, seconds: f64::INFINITY }
    }
}

/// Everything that the iterates of a fit depend on, except scene and targets. The stopping rule is separate.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Settings {
    /// The unknowns.
    pub fits: Vec<Fit>,
    /// Loss of a picture against its target.
    pub loss: LossKind,
    /// ε of relative losses, W/(m² sr); `None`: a hundredth of the mean target.
    #[doc(hidden)]
    pub epsilon: Option<f64>,
    /// Threshold of the Huber loss, a relative difference; `None`: 0.3 where pictures clip, else 10.
    #[doc(hidden)]
    pub threshold: Option<f64>,
    /// Regularisers.
    pub regularisers: Vec<Regulariser>,
    /// Whether all emission that is fitted is first scaled, by one factor per channel, to what explains the pictures best.
    #[doc(hidden)]
    pub scale_emission: bool,
    /// Which optimiser to use.
    pub optimiser: OptimiserKind,
    /// Options of the quasi-Newton method.
    #[doc(hidden)]
    pub quasi_newton: QuasiNewtonOptions,
    /// Pictures per view that a Gauss-Newton Hessian for the quasi-Newton method may take: one for each colour, number or
    /// coordinate fitted, and none for poses of cameras. With more, its model starts from the diagonal, where albedos and emissions alone are fitted; with 0
    /// it is learnt from gradients alone.
    #[doc(hidden)]
    pub gauss_newton: usize,
    /// Relative noise of the loss; `None`: a tenth of the tolerance of solves, or 1e-4 where positions or cameras are fitted.
    /// Overrides that in [`Self::quasi_newton`].
    pub noise: Option<f64>,
    /// Options of Adam.
    #[doc(hidden)]
    pub adam: AdamOptions,
    /// Samples per pixel along each axis.
    pub supersample: u32,
    /// How pictures show the light of faces: gathered, or one colour per face.
    pub shading: Shading,
    /// Tolerance of solves; `None`: that of the scene, but at most 1e-5.
    pub tolerance: Option<f64>,
}

setters!(Settings {
    fits: Vec<Fit>,
    loss: LossKind,
    #[doc(hidden)]
    epsilon: Option<f64>,
    #[doc(hidden)]
    threshold: Option<f64>,
    regularisers: Vec<Regulariser>,
    #[doc(hidden)]
    scale_emission: bool,
    optimiser: OptimiserKind,
    #[doc(hidden)]
    quasi_newton: QuasiNewtonOptions,
    #[doc(hidden)]
    gauss_newton: usize,
    noise: Option<f64>,
    #[doc(hidden)]
    adam: AdamOptions,
    supersample: u32,
    shading: Shading,
    tolerance: Option<f64>,
});

impl Settings {
    /// Settings for the given fits, with defaults for everything else.
    pub fn new(fits: Vec<Fit>) -> Self {
        Self {
            fits,
            loss: LossKind::default(),
            epsilon: None,
            threshold: None,
            regularisers: Vec::new(),
            scale_emission: false,
            optimiser: OptimiserKind::default(),
            quasi_newton: QuasiNewtonOptions::default(),
            gauss_newton: 16,
            noise: None,
            adam: AdamOptions::default(),
            supersample: PictureOptions::default().supersample,
            shading: Shading::default(),
            tolerance: None,
        }
    }
}
