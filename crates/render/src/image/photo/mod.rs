//! Photographs: pictures of any program or camera, as linear RGB.

mod average;
mod codecs;
mod exif;
mod layers;
mod mask;
mod resample;

pub use mask::PhotoMask;

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use ::image::ImageFormat;
use ::image::metadata::Orientation;

use super::ImageError;
use super::picture::MAX_PIXELS;

/// A picture in linear RGB. Values of integer formats are decoded from sRGB, with 1 for white; those of float formats are taken as they are.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row from the top.
    pub pixels: Vec<[f32; 3]>,
    /// Per pixel, whether a channel is at the end of the file's scale, so that its value is only a lower bound.
    pub clipped: Vec<bool>,
    /// Whether the format ends at white: integers do, floats do not.
    pub ends_at_white: bool,
    /// Exposure time in seconds times ISO over the square of the f-number, where the file has all three: how bright it makes a scene, up to
    /// a factor of the camera.
    pub exposure: Option<f64>,
}

/// What a file holds, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Exr,
    Other(ImageFormat),
}

impl Photo {
    /// Reads an EXR, PNG, JPEG, TIFF or Radiance HDR, whatever its suffix, turned upright as its EXIF data say. `layer` is that of an
    /// EXR, such as `ViewLayer.Combined`; without, it is the one without a name, or the only one.
    ///
    /// # Errors
    /// Fails if the file cannot be read, is in no known format, or if it has several layers and none is chosen.
    pub fn read(path: &Path, layer: Option<&str>) -> Result<Self, ImageError> {
        let (mut photo, turned) = Self::read_as_stored(path, layer)?;
        if let Some(turned) = turned {
            photo.turn(turned);
        }
        Ok(photo)
    }

    /// Reads a picture that should have one of some sizes: upright, unless it only has such a size as it is stored. Programs that
    /// find the poses of cameras do not all turn pictures.
    ///
    /// # Errors
    /// As [`Photo::read`].
    pub fn read_of_size(
        path: &Path,
        layer: Option<&str>,
        suits: impl Fn([u32; 2]) -> bool,
    ) -> Result<Self, ImageError> {
        let (mut photo, turned) = Self::read_as_stored(path, layer)?;
        if let Some(turned) = turned {
            let stored = [photo.width, photo.height];
            if suits(upright(stored, turned)) || !suits(stored) {
                photo.turn(turned);
            }
        }
        Ok(photo)
    }

    /// Columns and rows of a file, upright, without reading its pixels.
    ///
    /// # Errors
    /// Fails if the file cannot be read or is in no known format.
    pub fn size(path: &Path) -> Result<[u32; 2], ImageError> {
        let measure = || match open(path)? {
            (Kind::Exr, file) => layers::size(file),
            (Kind::Other(format), file) => codecs::size(file, format),
        };
        measure().map_err(|reason| ImageError::Photo { path: path.to_path_buf(), reason })
    }

    fn read_as_stored(path: &Path, layer: Option<&str>) -> Result<(Self, Option<Orientation>), ImageError> {
        let read = || match (open(path)?, layer) {
            ((Kind::Exr, file), layer) => Ok((layers::read(file, layer)?, None)),
            ((Kind::Other(_), _), Some(layer)) => {
                Err(format!("it is no EXR and has no layer \"{layer}\"; leave `layer` out"))
            }
            ((Kind::Other(format), file), None) => codecs::read(file, format),
        };
        read().map_err(|reason| ImageError::Photo { path: path.to_path_buf(), reason })
    }

    fn turn(&mut self, turned: Orientation) {
        let [width, height] = [self.width as usize, self.height as usize];
        let [new_width, new_height] = upright([self.width, self.height], turned);
        let from = |x: usize, y: usize| match turned {
            Orientation::NoTransforms => (x, y),
            Orientation::Rotate90 => (y, height - 1 - x),
            Orientation::Rotate180 => (width - 1 - x, height - 1 - y),
            Orientation::Rotate270 => (width - 1 - y, x),
            Orientation::FlipHorizontal => (width - 1 - x, y),
            Orientation::FlipVertical => (x, height - 1 - y),
            Orientation::Rotate90FlipH => (y, x),
            Orientation::Rotate270FlipH => (width - 1 - y, height - 1 - x),
        };
        let places: Vec<usize> = (0..new_height as usize)
            .flat_map(|y| (0..new_width as usize).map(move |x| (x, y)))
            .map(|(x, y)| {
                let (x, y) = from(x, y);
                y * width + x
            })
            .collect();
        self.pixels = places.iter().map(|&at| self.pixels[at]).collect();
        self.clipped = places.iter().map(|&at| self.clipped[at]).collect();
        [self.width, self.height] = [new_width, new_height];
    }
}

/// The size of a picture that is turned.
fn upright([width, height]: [u32; 2], turned: Orientation) -> [u32; 2] {
    match turned {
        Orientation::Rotate90
        | Orientation::Rotate270
        | Orientation::Rotate90FlipH
        | Orientation::Rotate270FlipH => [height, width],
        _ => [width, height],
    }
}

fn open(path: &Path) -> Result<(Kind, BufReader<std::fs::File>), String> {
    let mut file = antirad_base::input::open(path).map_err(|error| error.to_string())?;
    let mut start = Vec::new();
    (&mut file).take(16).read_to_end(&mut start).map_err(|error| error.to_string())?;
    file.seek(SeekFrom::Start(0)).map_err(|error| error.to_string())?;
    let kind = match ::image::guess_format(&start) {
        Ok(ImageFormat::OpenExr) => Kind::Exr,
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Tiff | ImageFormat::Hdr)) => {
            Kind::Other(format)
        }
        _ => return Err("it is none of EXR, PNG, JPEG, TIFF and Radiance HDR; convert it".to_owned()),
    };
    Ok((kind, BufReader::new(file)))
}

/// Fails if a header claims more pixels than are read.
fn check_size(width: usize, height: usize) -> Result<[u32; 2], String> {
    match width.checked_mul(height) {
        Some(0) => Err("it has no pixels".to_owned()),
        Some(pixels) if pixels <= MAX_PIXELS => Ok([width as u32, height as u32]),
        _ => Err(format!("it has {width} x {height} pixels, more than the {MAX_PIXELS} that are read")),
    }
}

/// The inverse of the transfer curve of IEC 61966-2-1.
fn linear(srgb: f64) -> f64 {
    if srgb <= 0.040_45 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}
