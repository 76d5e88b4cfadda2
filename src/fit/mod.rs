//! Fitting scenes to pictures.

mod gradient;
mod limit;
mod loss;
mod motion;
pub mod optimiser;
mod parameters;
mod regulariser;
mod selection;
mod target;

pub use gradient::{Quantity, SceneGradient};
pub use loss::{Loss, LossKind, PictureLoss};
pub use parameters::{Fit, MotionKind, ParameterError, Parameters, Per, Recovered};
pub use regulariser::{Regulariser, Regularisers};
pub use target::{Target, TargetError, TargetPicture, read_mask};
