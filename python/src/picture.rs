//! Files of pictures.

use crate::arrays::{Numbers, shown};
use crate::errors::{OrRaise, invalid};
use crate::work;
use antirad::image::{Exposure, Picture, ToneMap};
use pyo3::prelude::*;
use std::path::PathBuf;

/// Writes a picture: EXR (linear, 32-bit floats) or PNG (tone-mapped, 8 bits).
///
/// Args:
///     path: The file, `.exr` or `.png`.
///     picture: Linear RGB, (height, width, 3), rows from the top.
///     exposure: Of a PNG, in stops: radiance is multiplied by two to the power of it. By default the 99th percentile of
///         the brightest channel becomes white.
///     srgb: Encode a PNG as sRGB, as viewers expect, instead of linearly.
///
/// Raises:
///     ValueError: The array has the wrong shape, or the name another ending.
///     PictureError: The file cannot be written.
#[pyfunction]
#[pyo3(signature = (path, picture, *, exposure=None, srgb=true))]
pub fn write_picture(
    py: Python<'_>,
    path: PathBuf,
    picture: Numbers,
    exposure: Option<f64>,
    srgb: bool,
) -> PyResult<()> {
    let [height, width, 3] = *picture.shape else {
        return Err(invalid(format!(
            "picture has the shape {}; it must be (height, width, 3)",
            shown(&picture.shape)
        )));
    };
    let flat: Vec<f32> = picture.values.iter().map(|&value| value as f32).collect();
    let (rgb, _) = flat.as_chunks::<3>();
    let pixels = rgb.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
    let picture = Picture { width: width as u32, height: height as u32, pixels };
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let png = match ending.as_deref() {
        Some("exr") => false,
        Some("png") => true,
        _ => return Err(invalid(format!("{}: give a name that ends in .exr or .png", path.display()))),
    };
    let tone = ToneMap::default().exposure(exposure.map_or(Exposure::Auto, Exposure::Stops)).srgb(srgb);
    work::run(py, None, move |_| match png {
        true => picture.write_png(&path, &tone),
        false => picture.write_exr(&path),
    })?
    .or_raise()
}
