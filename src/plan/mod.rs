//! Plan.
mod bins;
mod classes;
mod order;
pub use bins::{Bins, Taps};
pub use classes::{Class, classify, coplanar_tolerance, reaches};
