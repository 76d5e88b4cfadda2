//! From radiance to the 8 bits of a screen.

use crate::options::setters;

/// How bright a picture is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Exposure {
    /// So that of the pixels that are not black, 99 in 100 are below white: the 99th percentile of their brightest
    /// channel becomes 0.99. Depends on the picture alone; use stops to compare pictures.
    #[default]
    Auto,
    /// Radiance is multiplied by two to the power of this.
    Stops(f64),
}

/// How radiance becomes the 8 bits of a PNG: scaled, cut at 0 and 1, encoded, rounded to nearest. NaN is shown as black.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ToneMap {
    /// What the radiance is multiplied by.
    pub exposure: Exposure,
    /// Encode for a screen, as PNG viewers expect; else linear values.
    pub srgb: bool,
}

setters!(ToneMap { exposure: Exposure, srgb: bool });

impl Default for ToneMap {
    fn default() -> Self {
        Self { exposure: Exposure::Auto, srgb: true }
    }
}

impl ToneMap {
    /// RGB bytes of pixels.
    pub(super) fn apply(&self, pixels: &[[f32; 4]]) -> Vec<u8> {
        let factor = match self.exposure {
            Exposure::Auto => auto_factor(pixels),
            Exposure::Stops(stops) => stops.exp2(),
        };
        let byte = |&value: &f32| {
            let shown = (f64::from(value) * factor).clamp(0.0, 1.0);
            // The conversion makes NaN 0.
            (255.0 * if self.srgb { srgb(shown) } else { shown }).round() as u8
        };
        pixels.iter().flat_map(|pixel| pixel[..3].iter().map(byte)).collect()
    }
}

fn auto_factor(pixels: &[[f32; 4]]) -> f64 {
    let mut brightest: Vec<f32> = pixels
        .iter()
        .map(|&[r, g, b, _]| r.max(g).max(b))
        .filter(|value| *value > 0.0 && value.is_finite())
        .collect();
    if brightest.is_empty() {
        return 1.0;
    }
    let rank = (brightest.len() - 1) * 99 / 100;
    let (_, percentile, _) = brightest.select_nth_unstable_by(rank, f32::total_cmp);
    0.99 / f64::from(*percentile)
}

/// The transfer curve of IEC 61966-2-1.
fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}
