//! What a fit needs of the engine: pictures of a scene, and derivatives of what is made of them.

use super::gradient::SceneGradient;
use crate::EngineError;
use crate::gpu::GpuError;
use crate::image::ImageError;
use crate::plan::GradientRequest;
use crate::scene::Scene;
use glam::DVec3;

/// Pictures could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// The work was stopped from outside.
    #[error("interrupted")]
    Interrupted,
    /// This scene has no answer (the solve diverges, or does not settle); another one may.
    #[error("{0}")]
    NoAnswer(String),
    /// Nothing can be rendered any more.
    #[error(transparent)]
    Failed(Box<dyn std::error::Error + Send + Sync>),
}

impl RenderError {
    /// Whether the device is gone, so that other jobs on it would fail, too.
    pub fn is_device_lost(&self) -> bool {
        let Self::Failed(cause) = self else { return false };
        let of_engine = cause.downcast_ref::<EngineError>().is_some_and(EngineError::is_device_lost);
        let lost = |error: Option<&GpuError>| matches!(error, Some(GpuError::DeviceLost(_)));
        let of_image = match cause.downcast_ref() {
            Some(ImageError::Gpu(error)) => Some(error),
            _ => None,
        };
        of_engine || lost(of_image) || lost(cause.downcast_ref())
    }
}

/// What rendering and its derivatives will take.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct CostEstimate {
    /// Device memory at the peak, bytes.
    pub device_bytes: u64,
    /// Of what is allowed.
    pub device_budget: u64,
    /// One picture of every view, and its derivatives, seconds. Rough.
    pub seconds: f64,
}

/// Makes pictures of scenes that differ in materials and positions only, seen from cameras that were given before.
pub trait Renderer {
    /// What an evaluation of `planning` will take. An error if it cannot be done at all: too little memory, above all.
    fn estimate(&mut self, planning: &Scene) -> Result<CostEstimate, RenderError>;

    /// Pictures by all cameras: linear RGB, row by row from the top, W/(m² sr). Emission may be negative.
    fn pictures(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError>;

    /// Derivatives of a loss by the scene of the latest [`Self::pictures`], from those by their pixels; `None` if this
    /// renderer has none, so that finite differences must do.
    fn pull_back(
        &mut self,
        by_pixels: &[Vec<DVec3>],
        request: GradientRequest,
    ) -> Result<Option<SceneGradient>, RenderError>;

    /// Applications of the transport so far.
    fn passes(&self) -> u64;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::TransportError;

    #[test]
    fn a_lost_device_is_known_wherever_it_was_lost() {
        let lost = || GpuError::DeviceLost(String::from("submitting"));
        let failed =
            |error: Box<dyn std::error::Error + Send + Sync>| RenderError::Failed(error).is_device_lost();
        assert!(failed(Box::new(lost())));
        assert!(failed(Box::new(ImageError::Gpu(lost()))));
        assert!(failed(Box::new(EngineError::Gpu(lost()))));
        assert!(failed(Box::new(EngineError::from(TransportError::Gpu(lost())))));
        assert!(!failed(Box::new(EngineError::NoPasses)));
        assert!(!RenderError::Interrupted.is_device_lost());
    }
}
