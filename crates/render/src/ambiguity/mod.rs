//! What pictures leave undetermined: which other emissions would give exactly the same pictures.
//!
//! Pictures of a diffuse scene determine the radiance C of the triangles that some camera sees (v), and of no others. With
//! R the direct transport between triangles, blockers included, times δρ/π, the emission is E = C - R C. For any radiance
//! of the unseen triangles u, the emissions
//!
//! e_u = c_u - R_uu c_u - R_uv c_v,   e_v = c_v - R_vu c_u - R_vv c_v
//!
//! explain the pictures: an affine space with one dimension per unseen triangle and channel. In terms of the unseen
//! emissions alone it is
//!
//! e_v = s - A e_u,   A = R_vu (1 - R_uu)⁻¹,   s = e*_v + A e*_u
//!
//! for any known explanation e*: A carries the emission of unseen triangles to seen ones, which must emit that much less.
//! Emission is not negative, which leaves the polytope e_u ≥ 0, A e_u ≤ s. At e_u = 0 the seen triangles emit everything
//! themselves: a hidden lamp is indistinguishable from the first bounce of its light ([`FirstBounce`]).

mod direct;
mod first_bounce;
mod light_matrix;
mod packing;
mod polytope;
mod views;

pub use direct::DirectLight;
pub use first_bounce::FirstBounce;
pub use light_matrix::LightMatrix;
pub use polytope::{Given, Interval, Method, Polytope, PolytopeError};
pub use views::Views;

use crate::image::ImageError;
use antirad_core::EngineError;

/// The analysis of an ambiguity failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AmbiguityError {
    /// The solve failed.
    #[error(transparent)]
    Engine(EngineError),
    /// There is no plan for the scene.
    #[error(transparent)]
    Plan(#[from] antirad_core::plan::PlanError),
    /// The visible triangles could not be determined.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The emissions that explain the pictures could not be computed.
    #[error(transparent)]
    Polytope(#[from] PolytopeError),
    /// The watcher interrupted the work.
    #[error("interrupted")]
    Interrupted,
}

impl From<EngineError> for AmbiguityError {
    fn from(error: EngineError) -> Self {
        if error.is_interruption() { Self::Interrupted } else { Self::Engine(error) }
    }
}
