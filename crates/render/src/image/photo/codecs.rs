//! PNG, JPEG, TIFF and Radiance HDR.

use std::fs::File;
use std::io::BufReader;

use ::image::metadata::Orientation;
use ::image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits, Rgba};

use super::labels::{FLOATS, Label};
use super::{Photo, check_size, exif, upright};
use antirad_scene::linear_from_srgb;

/// Most bytes that a decoder may allocate.
const MOST_BYTES: u64 = 1 << 31;

fn reader(file: BufReader<File>, format: ImageFormat) -> ImageReader<BufReader<File>> {
    let mut reader = ImageReader::with_format(file, format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(MOST_BYTES);
    reader.limits(limits);
    reader
}

pub(super) fn size(file: BufReader<File>, format: ImageFormat) -> Result<[u32; 2], String> {
    let mut decoder = reader(file, format).into_decoder().map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    let turned = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    Ok(upright(check_size(width as usize, height as usize)?, turned))
}

/// The picture as decoded, with how to turn it and its exposure.
fn decode(
    file: BufReader<File>,
    format: ImageFormat,
) -> Result<(DynamicImage, Option<Orientation>, Option<f64>), String> {
    let mut decoder = reader(file, format).into_decoder().map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    check_size(width as usize, height as usize)?;
    // What EXIF data get wrong is no reason to refuse a picture.
    let turned = decoder.orientation().ok().filter(|turned| *turned != Orientation::NoTransforms);
    let exposure = decoder.exif_metadata().ok().flatten().and_then(exif::exposure);
    let picture = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?;
    Ok((picture, turned, exposure))
}

pub(super) fn read(
    file: BufReader<File>,
    format: ImageFormat,
) -> Result<(Photo, Option<Orientation>), String> {
    let (picture, turned, exposure) = decode(file, format)?;
    let (width, height) = (picture.width(), picture.height());
    let photo = |pixels: Vec<[f32; 3]>, clipped: Vec<bool>, ends_at_white| Photo {
        width,
        height,
        pixels,
        clipped,
        ends_at_white,
        exposure,
    };
    let photo = match picture {
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            let pixels: Vec<[f32; 3]> = picture.into_rgb32f().pixels().map(|pixel| pixel.0).collect();
            let clipped = vec![false; pixels.len()];
            photo(pixels, clipped, false)
        }
        DynamicImage::ImageLuma8(_)
        | DynamicImage::ImageLumaA8(_)
        | DynamicImage::ImageRgb8(_)
        | DynamicImage::ImageRgba8(_) => {
            let table: Vec<f32> =
                (0..=u8::MAX).map(|v| linear_from_srgb(f64::from(v) / 255.0) as f32).collect();
            let picture = picture.into_rgb8();
            photo(
                picture.pixels().map(|pixel| pixel.0.map(|v| table[usize::from(v)])).collect(),
                picture.pixels().map(|pixel| pixel.0.contains(&u8::MAX)).collect(),
                true,
            )
        }
        _ => {
            let table: Vec<f32> =
                (0..=u16::MAX).map(|v| linear_from_srgb(f64::from(v) / 65535.0) as f32).collect();
            let picture = picture.into_rgb16();
            photo(
                picture.pixels().map(|pixel| pixel.0.map(|v| table[usize::from(v)])).collect(),
                picture.pixels().map(|pixel| pixel.0.contains(&u16::MAX)).collect(),
                true,
            )
        }
    };
    Ok((photo, turned))
}

/// Colours as stored, in 16 bits; none where they are transparent.
pub(super) fn labels(
    file: BufReader<File>,
    format: ImageFormat,
) -> Result<([u32; 2], Vec<Option<Label>>), String> {
    let (picture, _, _) = decode(file, format)?;
    if matches!(picture, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        return Err(FLOATS.to_owned());
    }
    let size = [picture.width(), picture.height()];
    let label = |pixel: &Rgba<u16>| {
        let [red, green, blue, alpha] = pixel.0;
        (alpha > 0).then_some([red, green, blue])
    };
    Ok((size, picture.into_rgba16().pixels().map(label).collect()))
}

/// Grey values from 0 to 1, not decoded, or the red channel of a float format.
pub(super) fn grey(file: BufReader<File>, format: ImageFormat) -> Result<([u32; 2], Vec<f32>), String> {
    let (picture, _, _) = decode(file, format)?;
    let size = [picture.width(), picture.height()];
    let values = match picture {
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            picture.into_rgb32f().pixels().map(|pixel| pixel.0[0]).collect()
        }
        _ => picture.into_luma16().pixels().map(|pixel| f32::from(pixel.0[0]) / 65535.0).collect(),
    };
    Ok((size, values))
}
