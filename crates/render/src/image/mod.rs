//! Pictures of a scene: what a pinhole camera sees, from a colour per face.
//!
//! The nearest face is found at a rotated grid of samples in each pixel ([`Rasterizer::visible_samples`]); a pixel is the mean
//! over its samples ([`Rasterizer::render`]). Pictures are made in bands of rows, so that any size takes bounded memory.
//! Fronts have their colour; backs are black and occlude.
//!
//! Fits to pictures need derivatives: [`Rasterizer::coverage`] gives the picture as a linear map of colours, with its
//! transpose; [`geometry_gradient`] gives the derivatives with respect to vertices and camera. Both assume one colour per face.

mod bands;
mod coverage;
mod cpu;
mod error;
mod faces;
mod gradient;
mod photo;
mod picture;
mod projection;
mod raster;
mod sweep;
mod tiles;
mod tone;
mod visibility;
mod vulkan;

pub use coverage::{Coverage, FaceInPixel};
pub use error::ImageError;
pub use gradient::camera_gradient;
pub use gradient::{CameraGradient, FaceColours, GeometryGradient, geometry_gradient, geometry_gradient_of};
pub use photo::{Label, Photo, PhotoLabels, PhotoMask};
pub use picture::Picture;
pub use projection::View;
pub use raster::{MAX_SUPERSAMPLE, PictureOptions, Rasterizer};
pub use tone::{Exposure, ToneMap};
