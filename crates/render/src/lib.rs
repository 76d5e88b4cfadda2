//! Pictures of antirad: raster, shading, warnings, target errors, and the path tracer. Programs use it through the crate
//! `antirad`.
#![warn(missing_docs)]

pub mod ambiguity;
pub mod export;
pub mod image;
pub mod path_tracer;
pub mod render;
pub mod shading;
pub mod target_error;
pub mod warnings;
