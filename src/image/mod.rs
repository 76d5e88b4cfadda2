//! Pictures of a scene: what a pinhole camera sees, from a colour per face.
//!
//! A regular grid of samples in each pixel finds the nearest face behind it ([`Rasterizer::visible_samples`]); a
//! pixel is the mean over its samples ([`Rasterizer::render`]). Pictures of any size go in bands of rows, so that they
//! take a bounded amount of device memory. Fronts have their colour; backs are black and hide what is behind them.
//!
//! A fit to pictures needs derivatives: [`Rasterizer::coverage`] is what a camera sees as a linear map from colours to
//! pixels, with its transpose; [`geometry_gradient`] says how the picture changes as vertices and the camera move. Both
//! are for one colour a face.
//!
//! ```no_run
//! use antirad::gpu::{Device, DeviceOptions};
//! use antirad::image::{PictureOptions, Rasterizer, ToneMap};
//! # fn picture(scene: &antirad::scene::Scene) -> Result<(), antirad::image::ImageError> {
//! let device = Device::new(&DeviceOptions::default())?;
//! let colours = vec![[1.0, 0.5, 0.25]; scene.triangles.len()];
//! let options = PictureOptions::default().supersample(8).smooth(true);
//! let picture = Rasterizer::new(&device)?.render(scene, &scene.cameras[0], &colours, &options)?;
//! picture.write_png("scene.png", &ToneMap::default())?;
//! # Ok(())
//! # }
//! ```

mod bands;
mod coverage;
mod error;
mod gradient;
mod picture;
mod projection;
mod raster;
mod resolve;
mod smooth;
mod sweep;
mod tiles;
mod tone;
mod visibility;

pub use coverage::Coverage;
pub use error::ImageError;
pub use gradient::{GeometryGradient, geometry_gradient};
pub use picture::Picture;
pub use projection::View;
pub use raster::{MAX_SUPERSAMPLE, PictureOptions, Rasterizer};
pub use smooth::corner_colours;
pub use tone::{Exposure, ToneMap};
