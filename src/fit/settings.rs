//! How a fit is done.

use super::loss::LossKind;
use super::optimiser::{AdamOptions, QuasiNewtonOptions};
use super::parameters::Fit;
use super::regulariser::Regulariser;
use crate::image::PictureOptions;
use crate::options::setters;
use serde::{Deserialize, Serialize};

/// Which optimiser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OptimiserKind {
    /// Bounded least squares if nothing but emission is fitted by the loss L2, else the quasi-Newton method, which bears
    /// the very different weights of a relative loss better.
    #[default]
    Auto,
    /// L-BFGS within bounds.
    QuasiNewton,
    /// Adam within bounds.
    Adam,
    /// Bounded linear least squares: for emission and the loss L2 alone.
    LeastSquares,
}

/// When a fit ends: as soon as one of these holds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StopRule {
    /// As many at most.
    pub iterations: u32,
    /// The loss has fallen by less than this share over the last five iterations (of Adam: fifty); 0 for never.
    pub relative_decrease: f64,
    /// The gradient, less what bounds forbid, is below this share of what it was at the start.
    pub gradient: f64,
    /// The loss is at or below this.
    pub loss: f64,
    /// Of all runs of this job together.
    pub seconds: f64,
}

setters!(StopRule { iterations: u32, relative_decrease: f64, gradient: f64, loss: f64, seconds: f64 });

impl Default for StopRule {
    fn default() -> Self {
        Self { iterations: 200, relative_decrease: 1e-4, gradient: 1e-7, loss: 0.0, seconds: f64::INFINITY }
    }
}

/// Everything that a fit's way depends on, but its scene and targets, and how long it goes.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Settings {
    /// What is unknown.
    pub fits: Vec<Fit>,
    /// How far a picture is from its target.
    pub loss: LossKind,
    /// W/(m² sr); `None`: a hundredth of the mean target.
    pub epsilon: Option<f64>,
    /// Assumptions beside the pictures.
    pub regularisers: Vec<Regulariser>,
    /// Which one minimises.
    pub optimiser: OptimiserKind,
    /// Of the quasi-Newton method.
    pub quasi_newton: QuasiNewtonOptions,
    /// Rounding of the loss, relative; `None`: a tenth of the tolerance of solves, or 1e-4 where positions are
    /// fitted. Takes the place of that in [`Self::quasi_newton`].
    pub noise: Option<f64>,
    /// Of Adam.
    pub adam: AdamOptions,
    /// Samples of a pixel each way.
    pub supersample: u32,
    /// Relative residual of solves; `None`: that of the scene, or 1e-5 if that is less.
    pub tolerance: Option<f64>,
}

setters!(Settings {
    fits: Vec<Fit>,
    loss: LossKind,
    epsilon: Option<f64>,
    regularisers: Vec<Regulariser>,
    optimiser: OptimiserKind,
    quasi_newton: QuasiNewtonOptions,
    noise: Option<f64>,
    adam: AdamOptions,
    supersample: u32,
    tolerance: Option<f64>,
});

impl Settings {
    /// Fits some quantities with defaults for all else.
    pub fn new(fits: Vec<Fit>) -> Self {
        Self {
            fits,
            loss: LossKind::default(),
            epsilon: None,
            regularisers: Vec::new(),
            optimiser: OptimiserKind::default(),
            quasi_newton: QuasiNewtonOptions::default(),
            noise: None,
            adam: AdamOptions::default(),
            supersample: PictureOptions::default().supersample,
            tolerance: None,
        }
    }
}
