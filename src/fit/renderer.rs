//! What a fit needs of the engine: pictures of a scene, and derivatives of what is made of them.

use super::gradient::SceneGradient;
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
