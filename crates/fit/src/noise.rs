//! Noise of pictures.

use serde::{Deserialize, Serialize};

/// Noise of a picture: the variance of a channel is shot · v + read² for its value v. Shot noise is that of photons, which arrive by chance;
/// read noise that of the camera, which black has, too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Variance per unit of the value.
    pub shot: f64,
    /// Standard deviation of black.
    #[doc(hidden)]
    pub read: f64,
}

impl Noise {
    /// The variance of a value.
    #[doc(hidden)]
    pub fn variance(&self, value: f64) -> f64 {
        self.shot * value.max(0.0) + self.read * self.read
    }

    /// The same noise of numbers that are so many times as large.
    #[must_use]
    #[doc(hidden)]
    pub fn scaled(self, factor: f64) -> Self {
        Self { shot: factor * self.shot, read: factor * self.read }
    }

    /// That of means over so many pixels.
    #[must_use]
    #[doc(hidden)]
    pub fn of_means(self, pixels: f64) -> Self {
        Self { shot: self.shot / pixels, read: self.read / pixels.sqrt() }
    }

    /// Refuses what is not finite, negative, or nothing.
    ///
    /// # Errors
    /// Says what it must be.
    #[doc(hidden)]
    pub fn check(&self) -> Result<(), String> {
        let is_number = |value: f64| value >= 0.0 && value.is_finite();
        match is_number(self.shot) && is_number(self.read) && self.shot + self.read > 0.0 {
            true => Ok(()),
            false => {
                Err(String::from("noise: `shot` and `read` must be finite and 0 or more, and not both 0"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variances_follow_numbers_and_means() {
        let noise = Noise { shot: 0.02, read: 0.1 };
        assert!((noise.variance(3.0) - 0.07).abs() < 1e-15);
        assert!((noise.variance(-3.0) - 0.01).abs() < 1e-15);
        assert!((noise.scaled(5.0).variance(15.0) - 25.0 * noise.variance(3.0)).abs() < 1e-12);
        assert!((noise.of_means(4.0).variance(3.0) - noise.variance(3.0) / 4.0).abs() < 1e-15);
        assert!(noise.check().is_ok());
        for wrong in [Noise::default(), Noise { shot: f64::NAN, ..noise }, Noise { read: -1.0, ..noise }] {
            assert!(wrong.check().is_err(), "{wrong:?}");
        }
    }
}
