//! Derivatives of the discretised model, by hand: of U and S with respect to geometry, of K and E with respect to
//! materials. Twin of glsl/*_derivative.comp.
//!
//! What is differentiated is the model as it is computed, not light itself: the taps of the bins, the two levels of the
//! near field and their blending included. Where a derivative does not exist (edges of bins with bilinear weights, the
//! pole, a triangle that lies in another's horizon) or nothing is exchanged, it counts as zero or as that of one side,
//! and is finite.

mod far_weight;
mod frame;
mod material;
mod observation;
mod pair;
mod polygon;
mod reading;
mod taps;
mod transport;

pub use material::{MaterialGradient, reflect_derivative};
pub use observation::observe_derivative;
pub use transport::transport_derivative;
