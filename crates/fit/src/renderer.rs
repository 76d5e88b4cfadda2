//! The interface between a fit and the engine: pictures of a scene, and derivatives of a loss.

use antirad_base::ranks::RankError;
use antirad_core::EngineError;
use antirad_core::plan::GradientRequest;
use antirad_gpu::GpuError;
use antirad_render::image::ImageError;
use antirad_render::render::SceneGradient;
use antirad_scene::Scene;
use glam::DVec3;

/// Pictures could not be rendered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// The work was interrupted.
    #[error("interrupted")]
    Interrupted,
    /// This scene has no solution (the solve diverges or does not converge); another scene may have one.
    #[error("{0}")]
    NoAnswer(String),
    /// No scene can be rendered any more.
    #[error(transparent)]
    Failed(Box<dyn std::error::Error + Send + Sync>),
}

impl RenderError {
    /// The error of the device behind this one, if it is one.
    fn of_device(&self) -> Option<&GpuError> {
        let Self::Failed(cause) = self else { return None };
        let of_engine = || cause.downcast_ref().and_then(EngineError::of_device);
        let of_image = || match cause.downcast_ref() {
            Some(ImageError::Gpu(error)) => Some(error),
            _ => None,
        };
        cause.downcast_ref().or_else(of_image).or_else(of_engine)
    }

    /// Whether the device is gone, so that other jobs on it would fail, too.
    pub fn is_device_lost(&self) -> bool {
        matches!(self.of_device(), Some(GpuError::DeviceLost(_)))
    }

    /// Whether the same scene may be rendered at another time, on another device, or where all ranks are started again.
    pub fn may_pass(&self) -> bool {
        let Self::Failed(cause) = self else { return false };
        let of_engine = cause.downcast_ref().is_some_and(EngineError::may_pass);
        let of_image = cause.downcast_ref().is_some_and(ImageError::may_pass);
        let of_ranks = cause.downcast_ref().is_some_and(RankError::may_pass);
        of_engine || of_image || of_ranks || self.of_device().is_some_and(GpuError::may_pass)
    }
}

/// Estimated cost of rendering and derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct CostEstimate {
    /// Peak device memory, bytes.
    pub device_bytes: u64,
    /// Device memory budget, bytes.
    pub device_budget: u64,
    /// Time for one picture of every view and the derivatives, s; a rough estimate.
    pub seconds: f64,
}

/// Squared derivatives of pictures by the triangles that they show; per triangle, RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnSquares {
    /// Squared derivatives by albedo.
    pub albedo: Vec<DVec3>,
    /// Squared derivatives by emitted radiance, in 1/(W/(m² sr))².
    pub emission: Vec<DVec3>,
}

/// Renders scenes that differ in materials, positions and cameras only. The views are those of the scene's cameras.
pub trait Renderer {
    /// Estimated cost of an evaluation of `planning`. An error if it is impossible, usually for lack of memory.
    #[doc(hidden)]
    fn estimate(&mut self, planning: &Scene) -> Result<CostEstimate, RenderError>;

    /// Pictures from all cameras of the scene: linear RGB, row by row from the top, W/(m² sr). The same calls in the same order give the
    /// same bytes; solves may start from earlier ones.
    #[doc(hidden)]
    fn pictures(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError>;

    /// Pictures of a scene that differs little from the latest, so that only the difference has to be
    /// accurate. The latest pictures stay those of [`Self::pictures`].
    #[doc(hidden)]
    fn pictures_near(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        self.pictures(scene)
    }

    /// Pictures of a difference of scenes: emission may be negative, and its light is no start for that of
    /// others.
    #[doc(hidden)]
    fn pictures_of_difference(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        self.pictures(scene)
    }

    /// Derivatives of a loss by the scene of the latest [`Self::pictures`], from those by their pixels; `None` if this
    /// renderer cannot compute them, in which case finite differences are used.
    #[doc(hidden)]
    fn pull_back(
        &mut self,
        by_pixels: &[Vec<DVec3>],
        request: GradientRequest,
    ) -> Result<Option<SceneGradient>, RenderError>;

    /// The sum over pixels, with `weights`, of the squared derivatives by what each triangle itself shows, in the latest
    /// [`Self::pictures`] and with the light that arrives held fixed; `None` if this renderer does not know.
    #[doc(hidden)]
    fn own_squares(&mut self, _weights: &[Vec<DVec3>]) -> Option<OwnSquares> {
        None
    }

    /// Per view and pixel of the latest [`Self::pictures`], the nearest point that it shows, if it shows any; `None` if this renderer does not know.
    #[doc(hidden)]
    fn points_in_pixels(&self) -> Option<Vec<Vec<Option<DVec3>>>> {
        None
    }

    /// Drops what earlier pictures left behind, so that the next do not depend on them, not even
    /// within rounding.
    #[doc(hidden)]
    fn forget(&mut self) {}

    /// Passes (applications of U) so far.
    #[doc(hidden)]
    fn passes(&self) -> u64;
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_core::solve::SolveError;
    use antirad_core::transport::TransportError;

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
        assert!(RenderError::Failed(Box::new(lost())).may_pass());
        assert!(!RenderError::Failed(Box::new(EngineError::NoPasses)).may_pass());
        assert!(!RenderError::Interrupted.is_device_lost());
    }

    #[test]
    fn a_rank_that_has_left_is_worth_another_start() {
        let of_transport = |error: RankError| EngineError::from(TransportError::from(error));
        let of_solve =
            |error: RankError| EngineError::from(SolveError::Operator(TransportError::from(error)));
        let out_of_step = || RankError::OutOfStep { root: 0, sent: 4, given: 5 };
        assert!(RenderError::Failed(Box::new(RankError::Left)).may_pass());
        assert!(RenderError::Failed(Box::new(ImageError::from(RankError::Left))).may_pass());
        assert!(RenderError::Failed(Box::new(of_transport(RankError::Left))).may_pass());
        assert!(RenderError::Failed(Box::new(of_solve(RankError::Left))).may_pass());
        assert!(!RenderError::Failed(Box::new(RankError::Threads)).may_pass());
        assert!(!RenderError::Failed(Box::new(of_transport(out_of_step()))).may_pass());
        assert!(!RenderError::Failed(Box::new(of_solve(out_of_step()))).may_pass());
    }
}
