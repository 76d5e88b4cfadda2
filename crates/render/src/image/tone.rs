//! Tone mapping: from radiance to 8 bits per channel.

use antirad_base::setters;
use antirad_scene::srgb_from_linear;

/// The exposure of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Exposure {
    /// Maps the 99th percentile of the brightest channel of all pixels that are not black to 0.99. It differs between pictures;
    /// use stops to compare them.
    #[default]
    Auto,
    /// Multiplies radiance by two to the power of this.
    Stops(f64),
}

/// How radiance becomes the 8 bits of a PNG: scaled, clamped to 0..1, encoded, rounded to nearest. NaN becomes black.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ToneMap {
    /// The factor on radiance.
    pub exposure: Exposure,
    /// Encode as sRGB, as PNG viewers expect, instead of linearly.
    pub srgb: bool,
}

setters!(ToneMap { exposure: Exposure, srgb: bool });

impl Default for ToneMap {
    fn default() -> Self {
        Self { exposure: Exposure::Auto, srgb: true }
    }
}

impl ToneMap {
    /// RGB bytes of the pixels.
    pub(super) fn apply(&self, pixels: &[[f32; 4]]) -> Vec<u8> {
        let factor = match self.exposure {
            Exposure::Auto => auto_factor(pixels),
            Exposure::Stops(stops) => stops.exp2(),
        };
        let byte = |&value: &f32| {
            let shown = (f64::from(value) * factor).clamp(0.0, 1.0);
            // The conversion turns NaN into 0.
            (255.0 * if self.srgb { srgb_from_linear(shown) } else { shown }).round() as u8
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
