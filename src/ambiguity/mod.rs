//! What pictures of a scene cannot tell: which other emissions would give the very same pictures.
//!
//! Of a diffuse scene, pictures fix the radiance C of the triangles that some camera sees, and of no others. With R the
//! direct light between triangles, blockers included, times δρ/π, emissions are E = C - R C. So whatever radiance the
//! unseen triangles u had, the emissions
//!
//! e_u = c_u - R_uu c_u - R_uv c_v,   e_v = c_v - R_vu c_u - R_vv c_v
//!
//! explain the pictures: an affine space with one dimension for each unseen triangle and channel. In terms of the unseen
//! emissions alone it is
//!
//! e_v = s - A e_u,   A = R_vu (1 - R_uu)⁻¹,   s = e*_v + A e*_u
//!
//! for any explanation e* at hand: what unseen triangles emit arrives at seen ones by A, and those must emit that much
//! less. Emission is not negative, so what is left is the polytope e_u ≥ 0, A e_u ≤ s. At e_u = 0 the seen triangles emit
//! all there is themselves: a hidden lamp looks like the first bounce of its light ([`FirstBounce`]).

mod direct;
mod first_bounce;
mod light_matrix;
mod polytope;
mod views;

pub use direct::DirectLight;
pub use first_bounce::FirstBounce;
pub use light_matrix::LightMatrix;
pub use polytope::{Given, Interval, Method, Polytope, PolytopeError};
pub use views::Views;

use crate::EngineError;
use crate::image::ImageError;

/// An ambiguity could not be examined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AmbiguityError {
    /// Light could not be computed.
    #[error(transparent)]
    Engine(EngineError),
    /// There is no plan for the scene.
    #[error(transparent)]
    Plan(#[from] crate::plan::PlanError),
    /// What cameras see could not be found.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The emissions that explain a picture could not be found.
    #[error(transparent)]
    Polytope(#[from] PolytopeError),
    /// A watcher stopped the work.
    #[error("interrupted")]
    Interrupted,
}

impl From<EngineError> for AmbiguityError {
    fn from(error: EngineError) -> Self {
        if error.is_interruption() { Self::Interrupted } else { Self::Engine(error) }
    }
}
