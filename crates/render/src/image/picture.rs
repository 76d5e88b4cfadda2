//! Pictures and their files.

use std::io::{self, BufReader, BufWriter, Write};
use std::path::Path;

use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{ExtendedColorType, ImageEncoder};
use exr::error::Error as ExrError;
use exr::image::write::WritableImage;
use exr::image::{Encoding, Image, Layer, SpecificChannels};
use exr::math::Vec2;
use exr::meta::MetaData;
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::{ReadChannels, ReadLayers, read};

use super::{ImageError, ToneMap};
use antirad_base::output::atomic_write;

/// Largest number of pixels that is read, 16384 x 16384 as for cameras, since a header can claim anything.
pub(super) const MAX_PIXELS: usize = 1 << 28;

/// Radiance per pixel, W/(m² sr).
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row by row from the top: linear RGB, and the share of the pixel that shows a face.
    pub pixels: Vec<[f32; 4]>,
}

impl Picture {
    /// Writes an OpenEXR file of linear RGB in 32-bit floats with lossless compression. Alpha is omitted, since viewers would
    /// blend the radiance with it.
    ///
    /// # Errors
    /// Fails if the number of pixels is not width times height, or if the file cannot be written.
    pub fn write_exr(&self, path: impl AsRef<Path>) -> Result<(), ImageError> {
        self.check()?;
        let size = (self.width as usize, self.height as usize);
        let pixel = |Vec2(x, y): Vec2<usize>| {
            let [r, g, b, _] = self.pixels[y * size.0 + x];
            (r, g, b)
        };
        let layer = Layer::new(
            size,
            LayerAttributes::default(),
            Encoding::SMALL_LOSSLESS,
            SpecificChannels::rgb(pixel),
        );
        atomic_write(path.as_ref(), |file| {
            let mut file = BufWriter::new(file);
            Image::from_layer(layer).write().to_buffered(&mut file).map_err(|error| match error {
                ExrError::Io(reason) => reason,
                error => io::Error::other(error),
            })?;
            file.flush()
        })?;
        Ok(())
    }

    /// Reads the first RGB layer of an OpenEXR file. Alpha is 1 where the file has none.
    ///
    /// # Errors
    /// Fails if the file cannot be read, has no RGB layer, or has too many pixels.
    pub fn read_exr(path: impl AsRef<Path>) -> Result<Self, ImageError> {
        let path = path.as_ref();
        let refused = |reason: String| ImageError::Read { path: path.to_path_buf(), reason };
        let open = || {
            antirad_base::input::open(path).map(BufReader::new).map_err(|error| refused(error.to_string()))
        };
        let meta =
            MetaData::read_from_buffered(open()?, false).map_err(|error| refused(error.to_string()))?;
        let pixels = |header: &Header| {
            header.layer_size.0.checked_mul(header.layer_size.1).filter(|&pixels| pixels <= MAX_PIXELS)
        };
        if meta.headers.iter().any(|header| pixels(header).is_none()) {
            return Err(refused(format!("it has more than {MAX_PIXELS} pixels")));
        }
        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .rgba_channels(
                |size, _| Rows { width: size.0, pixels: vec![[0.0; 4]; size.0 * size.1] },
                |rows: &mut Rows, Vec2(x, y), (r, g, b, a): (f32, f32, f32, f32)| {
                    rows.pixels[y * rows.width + x] = [r, g, b, a];
                },
            )
            .first_valid_layer()
            .all_attributes()
            .from_buffered(open()?)
            .map_err(|error| refused(error.to_string()))?;
        let Vec2(width, height) = image.layer_data.size;
        // At most MAX_PIXELS.
        let (width, height) = (width as u32, height as u32);
        Ok(Self { width, height, pixels: image.layer_data.channel_data.pixels.pixels })
    }

    /// Writes a tone-mapped PNG of 8 bits per channel.
    ///
    /// # Errors
    /// Fails if the number of pixels is not width times height, or if the file cannot be written.
    pub fn write_png(&self, path: impl AsRef<Path>, tone: &ToneMap) -> Result<(), ImageError> {
        self.write_png_filtered(path, tone, FilterType::Adaptive)
    }

    /// Writes a tone-mapped PNG of 8 bits per channel with a choice of filter; pictures of flat colours
    /// compress better without one.
    #[doc(hidden)]
    pub fn write_png_filtered(
        &self,
        path: impl AsRef<Path>,
        tone: &ToneMap,
        filter: FilterType,
    ) -> Result<(), ImageError> {
        self.check()?;
        let bytes = tone.apply(&self.pixels);
        atomic_write(path.as_ref(), |file| {
            let mut file = BufWriter::new(file);
            PngEncoder::new_with_quality(&mut file, CompressionType::Default, filter)
                .write_image(&bytes, self.width, self.height, ExtendedColorType::Rgb8)
                .map_err(|error| match error {
                    ::image::ImageError::IoError(reason) => reason,
                    error => io::Error::other(error),
                })?;
            file.flush()
        })?;
        Ok(())
    }

    /// Fails unless there are width x height pixels, and at least one: files cannot be empty.
    fn check(&self) -> Result<(), ImageError> {
        let Self { width, height, ref pixels } = *self;
        if pixels.is_empty() || width as usize * height as usize != pixels.len() {
            return Err(ImageError::Size { width, height, pixels: pixels.len() });
        }
        Ok(())
    }
}

/// Pixels during reading.
struct Rows {
    width: usize,
    pixels: Vec<[f32; 4]>,
}
