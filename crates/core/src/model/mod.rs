//! Shared definitions of a triangle, a direction bin and a class of triangles. The planner, the host side of the
//! kernels and the f64 reference use them without depending on one another.

mod bins;
mod class;
mod close_pair;
mod facet;
mod facet_gradient;
mod frame_gradient;
mod hierarchy;
mod near_field;
mod objects;
mod order;
mod passing;
mod polygon;
mod scalar;
mod vector;

pub use bins::{Bins, Taps};
pub use class::{Class, classify};
pub use class::{coplanar_tolerance, reaches};
pub use close_pair::{ClosePair, Piece};
pub use facet::{Facet, orthonormal_basis, rays_among};
pub use facet::{centroid, quarters};
pub use facet_gradient::FacetGradient;
pub use frame_gradient::{FrameGradient, pull_local, pull_unit};
pub use hierarchy::{Hierarchy, Node, Sight};
pub use near_field::{QUARTER_RANGE, far_weight};
pub use order::PADDING;
pub use order::{BoundedRun, morton, spatial_order};
pub use passing::{PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
pub use polygon::projected_solid_angle;
pub use scalar::{Arithmetic, Dual, Scalar};
pub use vector::{DualVector, Vector};
