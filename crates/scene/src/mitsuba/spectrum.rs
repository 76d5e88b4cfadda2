//! Colours of spectra: radiance or reflectance at wavelengths in nm, as linear sRGB, as Mitsuba's RGB variants take them.

/// Wavelengths of visible light, nm. A spectrum is zero outside its own wavelengths.
const VISIBLE: std::ops::RangeInclusive<u32> = 360..=830;

/// The standard illuminant D65, relative, every 10 nm from 380 (ISO/CIE 11664-2).
const DAYLIGHT: [f64; 41] = [
    49.9755, 54.6482, 82.7549, 91.486, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861, 115.923,
    108.811, 109.354, 107.802, 104.79, 107.689, 104.405, 104.046, 100.0, 96.3342, 95.788, 88.6856, 90.0062,
    89.5991, 87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842, 69.7213, 71.6091, 74.349, 61.604,
    69.8856, 75.087, 63.5927, 46.4182, 66.8054, 63.3828,
];

/// The XYZ of daylight, with Y = 1.
const WHITE: [f64; 3] = [0.95047, 1.0, 1.08883];

/// Rows of linear sRGB from XYZ (IEC 61966-2-1).
const RGB: [[f64; 3]; 3] = [
    [3.2404542, -1.5371385, -0.4985314],
    [-0.969266, 1.8760108, 0.041556],
    [0.0556434, -0.2040259, 1.0572252],
];

/// What a spectrum tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Of {
    /// Emission; that of 1 at all wavelengths has X = Y = Z = 1.
    Emission,
    /// The share of daylight that is reflected.
    Reflectance,
}

/// The colour of a spectrum, linear between its samples: wavelengths in ascending order, and values. Colours beyond sRGB are
/// limited to it.
pub(super) fn colour(samples: &[(f64, f64)], of: Of) -> [f64; 3] {
    let (mut sum, mut whole) = ([0.0; 3], [0.0; 3]);
    for wavelength in VISIBLE.map(f64::from) {
        let light = match of {
            Of::Emission => 1.0,
            Of::Reflectance => daylight(wavelength),
        };
        let value = at(samples, wavelength);
        for (channel, response) in responses(wavelength).into_iter().enumerate() {
            sum[channel] += light * value * response;
            whole[channel] += light * response;
        }
    }
    let (white, most) = match of {
        Of::Emission => ([1.0; 3], f64::INFINITY),
        Of::Reflectance => (WHITE, 1.0),
    };
    let xyz = [0, 1, 2].map(|channel| white[channel] * sum[channel] / whole[channel]);
    RGB.map(|row| row.iter().zip(xyz).map(|(a, b)| a * b).sum::<f64>().clamp(0.0, most))
}

fn at(samples: &[(f64, f64)], wavelength: f64) -> f64 {
    let after = samples.partition_point(|(at, _)| *at < wavelength);
    match (after.checked_sub(1).map(|before| samples[before]), samples.get(after)) {
        (Some((from, a)), Some(&(to, b))) => a + (b - a) * (wavelength - from) / (to - from),
        (None, Some(&(to, b))) if to == wavelength => b,
        _ => 0.0,
    }
}

fn daylight(wavelength: f64) -> f64 {
    let place = ((wavelength - 380.0) / 10.0).clamp(0.0, (DAYLIGHT.len() - 1) as f64);
    let before = (place as usize).min(DAYLIGHT.len() - 2);
    let share = place - before as f64;
    DAYLIGHT[before] * (1.0 - share) + DAYLIGHT[before + 1] * share
}

/// The colour matching functions of the CIE 1931 observer, within 1 % (Wyman, Sloan and Shirley 2013, "Simple Analytic
/// Approximations to the CIE XYZ Color Matching Functions", table 1).
fn responses(wavelength: f64) -> [f64; 3] {
    let lobe = |height: f64, middle: f64, below: f64, above: f64| {
        let width = if wavelength < middle { below } else { above };
        height * (-0.5 * ((wavelength - middle) / width).powi(2)).exp()
    };
    [
        lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) - lobe(0.065, 501.1, 20.4, 26.2),
        lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1),
        lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(samples: &[(f64, f64)], of: Of, expected: [f64; 3]) {
        let found = colour(samples, of);
        let largest = expected.into_iter().fold(0.0, f64::max);
        let off = (0..3).map(|c| (found[c] - expected[c]).abs() / largest).fold(0.0, f64::max);
        assert!(off < 0.02, "{found:?}, not {expected:?}");
    }

    /// What Mitsuba 3.9.1 makes of them (`scalar_rgb`).
    #[test]
    fn colours_are_those_of_mitsuba() {
        let lamp = [(400.0, 0.0), (500.0, 8.0), (600.0, 15.6), (700.0, 18.4)];
        near(&lamp, Of::Emission, [20.7108, 10.8546, 2.77115]);
        near(&[(360.0, 1.0), (830.0, 1.0)], Of::Emission, [1.20488, 0.948228, 0.909267]);
        near(&[(500.0, 0.0), (510.0, 1.0), (520.0, 0.0)], Of::Emission, [0.0, 0.0882243, 0.00638796]);
        let wall = [(400.0, 0.343), (500.0, 0.3), (600.0, 0.5), (700.0, 0.64)];
        near(&wall, Of::Reflectance, [0.57635, 0.377433, 0.306476]);
        near(&[(400.0, 0.5), (700.0, 0.5)], Of::Reflectance, [0.497671, 0.499878, 0.497455]);
        let red = [(400.0, 0.05), (500.0, 0.05), (560.0, 0.2), (600.0, 0.55), (700.0, 0.62)];
        near(&red, Of::Reflectance, [0.667847, 0.165005, 0.0245765]);
    }

    #[test]
    fn grey_reflectance_is_grey() {
        for value in colour(&[(300.0, 0.3), (900.0, 0.3)], Of::Reflectance) {
            assert!((value - 0.3).abs() < 1e-6, "{value}");
        }
        assert_eq!(colour(&[], Of::Reflectance), [0.0; 3]);
    }

    /// The table of daylight and the observer agree with the white point.
    #[test]
    fn daylight_is_white() {
        let mut sum = [0.0; 3];
        for wavelength in VISIBLE.map(f64::from) {
            (0..3).for_each(|c| sum[c] += daylight(wavelength) * responses(wavelength)[c]);
        }
        for c in 0..3 {
            assert!((sum[c] / sum[1] - WHITE[c]).abs() < 0.02, "{sum:?}");
        }
    }
}
