//! The rasterizer: from a scene, a camera and colours to a picture.

use super::bands::Grid;
use super::resolve::{self, Resolve, Shading};
use super::visibility::{self, Visibility};
use super::{ImageError, Picture};
use crate::gpu::{Device, Pipeline, rounded};
use crate::scene::{Camera, Scene};

/// A pixel has at most so many samples each way.
pub const MAX_SUPERSAMPLE: u32 = 16;

/// How a picture is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureOptions {
    /// Each pixel is the mean of `supersample` x `supersample` samples on a regular grid; a power of two.
    pub supersample: u32,
    /// Interpolate [`corner_colours`](super::corner_colours) instead of showing one colour a face.
    pub smooth: bool,
}

impl Default for PictureOptions {
    fn default() -> Self {
        Self { supersample: 4, smooth: false }
    }
}

/// Makes pictures on a device. The same input makes the same picture, to the last bit.
#[derive(Debug)]
pub struct Rasterizer {
    device: Device,
    visibility: Pipeline,
    flat: Pipeline,
    smooth: Pipeline,
}

impl Rasterizer {
    pub fn new(device: &Device) -> Result<Self, ImageError> {
        Ok(Self {
            device: device.clone(),
            visibility: visibility::pipeline(device)?,
            flat: resolve::pipeline(device, false)?,
            smooth: resolve::pipeline(device, true)?,
        })
    }

    /// The picture of a scene that was checked. `colours`: radiance of the front of each triangle, in the scene's
    /// order.
    pub fn render(
        &self,
        scene: &Scene,
        camera: &Camera,
        colours: &[[f32; 3]],
        options: &PictureOptions,
    ) -> Result<Picture, ImageError> {
        let (given, wanted) = (colours.len(), scene.triangles.len());
        if given != wanted {
            return Err(ImageError::Colours { given, wanted });
        }
        let PictureOptions { supersample, smooth } = *options;
        let grid = grid(camera, supersample)?;
        let faces = visibility::project(scene, camera);
        let shading = Shading::new(scene, camera, &faces, colours, smooth)?;
        let pipeline = if smooth { &self.smooth } else { &self.flat };
        let triangles = wanted as u64;
        let visibility = Visibility::new(&self.device, &self.visibility, grid, triangles)?;
        let resolve = Resolve::new(&self.device, pipeline, grid, triangles, smooth)?;
        let mut pixels = Vec::with_capacity(camera.width as usize * camera.height as usize);
        for band in grid.bands() {
            visibility.run(band, &faces)?;
            pixels.extend(resolve.run(band, &visibility.samples, &shading)?);
        }
        Ok(Picture { width: camera.width, height: camera.height, pixels })
    }

    /// The visible face of every sample of a picture, `u32::MAX` where there is none: `supersample` times the width
    /// of the camera a row, row by row from the top. Sample (u, v) of a pixel is at ((u + 0.5) / `supersample`,
    /// (v + 0.5) / `supersample`) in it, see [`View::ray`](super::View::ray).
    pub fn visible_samples(
        &self,
        scene: &Scene,
        camera: &Camera,
        supersample: u32,
    ) -> Result<Vec<u32>, ImageError> {
        let grid = grid(camera, supersample)?;
        let faces = visibility::project(scene, camera);
        let triangles = scene.triangles.len() as u64;
        let visibility = Visibility::new(&self.device, &self.visibility, grid, triangles)?;
        let mut samples = Vec::with_capacity(grid.width as usize * grid.height as usize);
        for band in grid.bands() {
            visibility.run(band, &faces)?;
            let count = u64::from(grid.width) * u64::from(band.rows);
            samples.extend(self.device.download_slice::<u32>(&visibility.samples, 0, count)?);
        }
        Ok(samples)
    }

    /// The device memory that [`render`](Self::render) takes for a scene of so many triangles, exactly. The staging
    /// buffers of transfers ([`staging_bytes`](crate::gpu::staging_bytes)) are not in it.
    pub fn bytes(triangles: usize, camera: &Camera, options: &PictureOptions) -> Result<u64, ImageError> {
        let grid = grid(camera, options.supersample)?;
        let visibility = visibility::sizes(&grid, triangles as u64);
        let resolve = resolve::sizes(&grid, triangles as u64, options.smooth);
        Ok(visibility.into_iter().chain(resolve).map(rounded).sum())
    }
}

fn grid(camera: &Camera, supersample: u32) -> Result<Grid, ImageError> {
    camera.check()?;
    if !supersample.is_power_of_two() || supersample > MAX_SUPERSAMPLE {
        return Err(ImageError::Supersample(supersample));
    }
    Ok(Grid::new(camera, supersample))
}
