//! Textures of mesh files: their mean over a triangle, in linear light.

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine2, DVec2, DVec3};
use image::{DynamicImage, ImageReader, Limits};

/// Most bytes that a texture may take in memory, and its file on disk.
const MOST_BYTES: u64 = 1 << 29;
/// Most texels along a side.
const MOST_TEXELS: u32 = 1 << 15;
/// Samples along a side of a triangle, at least and at most.
const SAMPLES: [f64; 2] = [4.0, 256.0];

/// A picture in linear RGB; texture coordinates (0, 0) are its upper left corner, and it repeats.
#[derive(Debug, PartialEq)]
pub(super) struct Texture {
    width: u32,
    height: u32,
    texels: Vec<[f32; 3]>,
}

/// A texture on the faces of a material, which it multiplies.
#[derive(Clone, Debug)]
pub(super) struct Map {
    pub texture: Arc<Texture>,
    /// From the texture coordinates of faces to those of the picture.
    pub place: DAffine2,
}

/// How the numbers of a picture become light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Encoding {
    /// sRGB, for colours.
    Srgb,
    /// For other quantities.
    Linear,
}

impl Texture {
    /// Reads a PNG or JPEG, and no other kind. The error says what is wrong, without the file.
    pub fn read(path: &Path, encoding: Encoding) -> Result<Option<Self>, String> {
        let bytes = crate::input::read_at_most(path, MOST_BYTES)
            .map_err(|reason| format!("cannot be read: {reason}"))?;
        Self::decode(&bytes, encoding)
    }

    /// The same from its bytes.
    pub fn decode(bytes: &[u8], encoding: Encoding) -> Result<Option<Self>, String> {
        let mut limits = Limits::default();
        limits.max_image_width = Some(MOST_TEXELS);
        limits.max_image_height = Some(MOST_TEXELS);
        limits.max_alloc = Some(MOST_BYTES);
        let mut reader = ImageReader::new(std::io::Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|error| error.to_string())?;
        reader.limits(limits);
        match reader.format() {
            Some(image::ImageFormat::Png | image::ImageFormat::Jpeg) => {}
            _ => return Ok(None),
        }
        let picture = reader.decode().map_err(|error| format!("is no readable picture: {error}"))?;
        Ok(Some(Self::of(&picture, encoding)))
    }

    fn of(picture: &DynamicImage, encoding: Encoding) -> Self {
        let picture = picture.to_rgb16();
        let light = |x: u16| {
            let x = f64::from(x) / f64::from(u16::MAX);
            let linear = match encoding {
                Encoding::Srgb if x <= 0.04045 => x / 12.92,
                Encoding::Srgb => ((x + 0.055) / 1.055).powf(2.4),
                Encoding::Linear => x,
            };
            linear as f32
        };
        // 256 values in most pictures, 65536 at most.
        let table: Vec<f32> = (0..=u16::MAX).map(light).collect();
        let texels = picture.pixels().map(|pixel| pixel.0.map(|x| table[usize::from(x)])).collect();
        Self { width: picture.width(), height: picture.height(), texels }
    }

    /// The texel at texture coordinates.
    fn at(&self, uv: DVec2) -> DVec3 {
        let wrap = |x: f64, count: u32| {
            let along = (x - x.floor()) * f64::from(count);
            // NaN becomes 0.
            (along as u32).min(count.saturating_sub(1))
        };
        let (column, row) = (wrap(uv.x, self.width), wrap(uv.y, self.height));
        let texel = self.texels.get(row as usize * self.width as usize + column as usize);
        texel.map_or(DVec3::ONE, |rgb| DVec3::from(rgb.map(f64::from)))
    }

    /// The mean over all texels.
    pub fn mean(&self) -> DVec3 {
        let sum: DVec3 = self.texels.iter().map(|rgb| DVec3::from(rgb.map(f64::from))).sum();
        sum / self.texels.len().max(1) as f64
    }

    /// The mean over a triangle: of the texels at the centroids of equal parts, about as many as it has texels.
    fn mean_over(&self, corners: [DVec2; 3]) -> DVec3 {
        if corners.iter().any(|uv| !uv.is_finite()) {
            // The face has no texture coordinates.
            return self.mean();
        }
        let [a, b, c] = corners;
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        let texels = ((b - a) * size).perp_dot((c - a) * size).abs() / 2.0;
        let n = (2.0 * texels).sqrt().ceil().clamp(SAMPLES[0], SAMPLES[1]) as u32;
        let mut sum = DVec3::ZERO;
        let step = 1.0 / (3.0 * f64::from(n));
        for i in 0..n {
            for j in 0..n - i {
                let (u, v) = (f64::from(3 * i + 1) * step, f64::from(3 * j + 1) * step);
                sum += self.at(a + (b - a) * u + (c - a) * v);
                if i + j + 1 < n {
                    // The part that points the other way.
                    sum += self.at(a + (b - a) * (u + step) + (c - a) * (v + step));
                }
            }
        }
        sum / f64::from(n * n)
    }
}

impl Map {
    /// The mean over a triangle with the given texture coordinates.
    pub fn mean_over(&self, corners: [DVec2; 3]) -> DVec3 {
        self.texture.mean_over(corners.map(|uv| self.place.transform_point2(uv)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    /// Columns of black and white.
    fn stripes(width: u32) -> Texture {
        let picture = RgbImage::from_fn(width, width, |x, _| Rgb([if x % 2 == 0 { 255 } else { 0 }; 3]));
        Texture::of(&DynamicImage::from(picture), Encoding::Srgb)
    }

    const HALF: [DVec2; 3] = [DVec2::ZERO, DVec2::X, DVec2::ONE];

    #[test]
    fn means_are_of_light() {
        let grey = DynamicImage::from(RgbImage::from_pixel(3, 3, Rgb([188, 128, 0])));
        let mean = Texture::of(&grey, Encoding::Srgb).mean_over(HALF);
        assert!(mean.abs_diff_eq(DVec3::new(0.5029, 0.2159, 0.0), 1e-4), "{mean}");
        let mean = Texture::of(&grey, Encoding::Linear).mean();
        assert!(mean.abs_diff_eq(DVec3::new(188.0, 128.0, 0.0) / 255.0, 1e-4), "{mean}");
        // The white columns are the left ones of each pair, where the triangle is lower. Not the light of the mean number, 0.21.
        for width in [2, 16, 300] {
            let (mean, white) = (stripes(width).mean_over(HALF).x, 0.5 - 0.5 / f64::from(width));
            assert!((mean - white).abs() <= 0.01, "{width}: {mean}, not {white}");
        }
    }

    /// Against the exact integral of a ramp over the triangle.
    #[test]
    fn a_ramp_has_the_value_of_its_centroid() {
        let ramp = RgbImage::from_fn(256, 256, |x, y| Rgb([x as u8, y as u8, 0]));
        let ramp = Texture::of(&DynamicImage::from(ramp), Encoding::Linear);
        let corners = [[0.1, 0.2], [0.9, 0.3], [0.4, 0.8]].map(DVec2::from);
        let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
        let mean = ramp.mean_over(corners);
        assert!((mean.truncate() - centroid).abs().max_element() <= 0.003, "{mean} {centroid}");
        // The other way around, and one period further.
        let moved = [corners[2], corners[1], corners[0]].map(|uv| uv + DVec2::new(-3.0, 7.0));
        assert!(ramp.mean_over(moved).abs_diff_eq(mean, 0.003));
        // A triangle without area in the picture has the texel there.
        assert!(ramp.mean_over([centroid; 3]).truncate().abs_diff_eq(centroid, 0.004));
        assert!(ramp.mean_over([DVec2::NAN; 3]).is_finite());
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        for bytes in [&b"\x89PNG\r\n\x1a\n"[..], b"\xff\xd8\xff"] {
            Texture::decode(bytes, Encoding::Srgb).expect_err("no picture");
        }
        for bytes in [&b""[..], b"GIF89a"] {
            assert_eq!(Texture::decode(bytes, Encoding::Srgb), Ok(None));
        }
        // A PNG that claims 2 GB.
        let mut huge = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        huge.extend([0, 0, 0x60, 0, 0, 0, 0x60, 0, 8, 2, 0, 0, 0]);
        let mut crc = 0xffff_ffff_u32;
        for &byte in &huge[12..] {
            crc ^= u32::from(byte);
            for _ in 0..8 {
                crc = if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
            }
        }
        huge.extend((!crc).to_be_bytes());
        huge.extend(b"\0\0\0\0IDAT\x35\xaf\x06\x1e");
        let error = Texture::decode(&huge, Encoding::Srgb).expect_err("2 GB");
        assert!(error.contains("imit"), "{error}");
    }
}
