//! Labels of pixels: pictures whose colours say what each pixel shows.

use std::path::Path;

use antirad_scene::Lens;
use glam::DVec2;

use super::{Kind, codecs, open};
use crate::image::ImageError;

/// A colour as stored, in 16 bits for each channel: those of 8 bits are 257 times as large.
pub type Label = [u16; 3];

/// Why a picture of floats has no labels.
pub(super) const FLOATS: &str = "its colours are floats, but labels are integers; save it as PNG";

/// A label for each pixel of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PhotoLabels {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row from the top; `None` where the picture is transparent.
    pub values: Vec<Option<Label>>,
}

impl PhotoLabels {
    /// Reads the colours of a picture of integers, not decoded, such as those of a PNG.
    ///
    /// # Errors
    /// Fails if the file cannot be read, is in no known format, or has floats.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let read = || match open(path)? {
            (Kind::Exr, _) => Err(FLOATS.to_owned()),
            (Kind::Other(format), file) => codecs::labels(file, format),
        };
        let ([width, height], values) =
            read().map_err(|reason| ImageError::Photo { path: path.to_path_buf(), reason })?;
        Ok(Self { width, height, values })
    }

    /// The labels at the centres of the pixels of the pinhole with the horizontal field of view of the lens
    /// ([`Lens::fov_x_degrees`]); `None` where the picture shows nothing. The lens may be for another size of the same picture.
    pub fn through_pinhole(&self, lens: &Lens, width: u32, height: u32) -> Vec<Option<Label>> {
        let lens = lens.resized(self.width, self.height);
        let (projection, ray) = (lens.projection(), lens.pinhole_rays(width, height));
        let size = DVec2::new(self.width.into(), self.height.into());
        let at = |index: usize| {
            let corner = DVec2::new((index % width as usize) as f64, (index / width as usize) as f64);
            let seen = projection.project(ray(corner + 0.5))?;
            let inside = seen.cmpge(DVec2::ZERO).all() && seen.cmplt(size).all();
            inside.then(|| self.values[seen.y as usize * self.width as usize + seen.x as usize])?
        };
        (0..width as usize * height as usize).map(at).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Written;
    use super::*;
    use ::image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb, Rgba};
    use antirad_scene::Distortion;

    #[test]
    fn labels_are_colours_as_stored() {
        let wide = |value: u8| 257 * u16::from(value);
        let read = |picture: DynamicImage, format| {
            PhotoLabels::read(&Written::save("labels", &picture, format).0).map_err(|error| error.to_string())
        };
        let bytes = ImageBuffer::from_fn(2, 1, |x, _| Rgba([10u8, 0, 255, if x == 0 { 255 } else { 0 }]));
        let labels = read(bytes.into(), ImageFormat::Png).expect("labels");
        assert_eq!((labels.width, labels.height), (2, 1));
        assert_eq!(labels.values, [Some([wide(10), 0, wide(255)]), None]);
        // Numbers of segments, beyond 8 bits.
        let words = ImageBuffer::from_fn(2, 1, |x, _| Luma([1000 + x as u16]));
        let labels = read(words.into(), ImageFormat::Png).expect("labels");
        assert_eq!(labels.values, [Some([1000; 3]), Some([1001; 3])]);
        let floats = ImageBuffer::from_pixel(2, 1, Rgb([0.5f32; 3]));
        let error = read(floats.into(), ImageFormat::Tiff).expect_err("floats");
        assert!(error.contains("labels") && error.contains("floats"), "{error}");
    }

    /// Each pixel has the label of the pixel in which the lens shows its centre; those beyond the picture have none.
    #[test]
    fn labels_are_looked_up_through_the_lens() {
        let (width, height) = (12, 9);
        let values = (0..width * height).map(|k| Some([(k % width) as u16, (k / width) as u16, 0])).collect();
        let labels = PhotoLabels { width, height, values };
        let focal = DVec2::splat(8.0);
        let lens = |x: f64| Lens {
            width,
            height,
            focal,
            centre: DVec2::new(x, 4.5),
            distortion: Distortion::default(),
        };
        let third = labels.through_pinhole(&lens(6.0), 4, 3);
        assert_eq!((third[0], third[11]), (Some([1, 1, 0]), Some([10, 7, 0])));
        assert_eq!(labels.through_pinhole(&lens(6.0), width, height), labels.values);
        // The field of view is that of the wider side: to the right of the middle.
        let off = labels.through_pinhole(&lens(4.5), width, height);
        assert_eq!((off[4 * 12], off[4 * 12 + 11]), (None, Some([11, 4, 0])));
    }
}
