//! Masks: which pixels of a photograph count.

use std::path::Path;

use super::{Kind, codecs, layers, open};
use crate::image::ImageError;

/// A weight for each pixel of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PhotoMask {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row from the top.
    pub values: Vec<f32>,
}

impl PhotoMask {
    /// Reads the values of a picture from 0 (black) to 1 (white), not decoded, or the red channel of a float format.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or is in no known format.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let read = || match open(path)? {
            (Kind::Exr, file) => {
                let photo = layers::read(file, None)?;
                let values = photo.pixels.iter().map(|pixel| pixel[0]).collect();
                Ok(([photo.width, photo.height], values))
            }
            (Kind::Other(format), file) => codecs::grey(file, format),
        };
        let ([width, height], values) =
            read().map_err(|reason| ImageError::Photo { path: path.to_path_buf(), reason })?;
        Ok(Self { width, height, values })
    }
}
