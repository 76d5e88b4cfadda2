//! Hand-written derivatives of the discretised model: of U and S with respect to geometry, of K and E with respect to
//! materials. Twin of glsl/*_derivative.comp.
//!
//! They are those of the model as computed, including interpolation weights, both levels of the near field and their blending.
//! Where a derivative does not exist (edges of bins with bilinear weights, the pole, a triangle in the horizon of another) or a
//! pair exchanges no light, it is zero or one-sided, and always finite.

mod clusters;
mod far_weight;
mod material;
mod observation;
mod pair;
mod polygon;
mod reading;
mod taps;
mod transport;

pub use clusters::transport_through_clusters_derivative;
pub use material::{MaterialGradient, reflect_derivative};
pub use observation::observe_derivative;
pub use transport::transport_derivative;
