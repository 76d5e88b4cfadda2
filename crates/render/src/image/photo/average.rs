//! Photographs averaged down by whole numbers, in linear light.

use super::{Photo, PhotoMask};
use antirad_base::parallel;

impl Photo {
    /// The picture with a mean over each block of pixels, weighted by the mask, and the mean of the mask; `None` unless the photo is a whole
    /// number of times the size, the same along both sides. A mask has the size of the photo. Where it is 0, pixels may hold any value.
    pub fn averaged(
        &self,
        mask: Option<&PhotoMask>,
        width: u32,
        height: u32,
    ) -> Option<(Self, Option<PhotoMask>)> {
        let factor = factor([self.width, self.height], [width, height])?;
        let weight = |at: usize| mask.map_or(1.0, |mask| f64::from(mask.values[at]));
        let one = |index: usize| {
            let mut sum = Sum::default();
            for at in block(index, width, factor) {
                sum.add(1.0, weight(at), self.pixels[at], self.clipped[at]);
            }
            sum
        };
        let sums: Vec<Sum> = parallel::map(0..width as usize * height as usize, one);
        let photo = self.with(width, height, &sums);
        let mask = mask.map(|_| Sum::mask(&sums, width, height));
        Some((photo, mask))
    }

    /// A picture of sums.
    pub(super) fn with(&self, width: u32, height: u32, sums: &[Sum]) -> Self {
        Self {
            width,
            height,
            pixels: sums.iter().map(Sum::pixel).collect(),
            clipped: sums.iter().map(|sum| sum.clipped).collect(),
            ..*self
        }
    }
}

impl PhotoMask {
    /// The mean over each block of pixels; `None` unless the mask is a whole number of times the size.
    pub fn averaged(&self, width: u32, height: u32) -> Option<Self> {
        let factor = factor([self.width, self.height], [width, height])?;
        let area = (factor * factor) as f64;
        let mean =
            |index| block(index, width, factor).map(|at| f64::from(self.values[at])).sum::<f64>() / area;
        let values = (0..width as usize * height as usize).map(|index| mean(index) as f32).collect();
        Some(Self { width, height, values })
    }
}

/// How many times larger a picture is along both sides, if a whole number.
fn factor(large: [u32; 2], small: [u32; 2]) -> Option<usize> {
    let factor = large[0].checked_div(small[0])?;
    let is_same = (0..2).all(|k| u64::from(small[k]) * u64::from(factor) == u64::from(large[k]));
    (factor > 0 && is_same).then_some(factor as usize)
}

/// Indices of the pixels of the large picture that one of the small picture covers.
fn block(index: usize, width: u32, factor: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (index / width as usize, index % width as usize);
    let across = width as usize * factor;
    (0..factor).flat_map(move |y| {
        let start = (row * factor + y) * across + column * factor;
        start..start + factor
    })
}

/// What a pixel is made of.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sum {
    light: [f64; 3],
    weight: f64,
    area: f64,
    /// Whether something clipped takes part.
    pub clipped: bool,
    /// Whether a part of the pixel lies where the photo shows nothing.
    pub uncovered: bool,
}

impl Sum {
    pub fn add(&mut self, area: f64, mask: f64, pixel: [f32; 3], clipped: bool) {
        self.area += area;
        let weight = area * mask;
        if weight == 0.0 {
            return;
        }
        self.weight += weight;
        for (sum, value) in self.light.iter_mut().zip(pixel) {
            *sum += weight * f64::from(value);
        }
        self.clipped |= clipped;
    }

    fn pixel(&self) -> [f32; 3] {
        match self.weight {
            0.0 => [0.0; 3],
            weight => self.light.map(|light| (light / weight) as f32),
        }
    }

    pub fn mask(sums: &[Self], width: u32, height: u32) -> PhotoMask {
        let value = |sum: &Self| match sum.uncovered || sum.area == 0.0 {
            true => 0.0,
            false => (sum.weight / sum.area) as f32,
        };
        PhotoMask { width, height, values: sums.iter().map(value).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photo(width: u32, height: u32, value: impl Fn(u32, u32) -> f32) -> Photo {
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let pixels: Vec<[f32; 3]> = places.map(|(x, y)| [value(x, y), 2.0 * value(x, y), 0.0]).collect();
        let clipped = vec![false; pixels.len()];
        Photo { width, height, pixels, clipped, ends_at_white: true, exposure: Some(2.0) }
    }

    #[test]
    fn blocks_are_averaged() {
        let mut large = photo(6, 4, |x, y| (x + 10 * y) as f32);
        large.clipped[6 * 3 + 4] = true;
        let (small, mask) = large.averaged(None, 3, 2).expect("half the size");
        assert_eq!(mask, None);
        assert_eq!((small.width, small.height, small.exposure), (3, 2, Some(2.0)));
        assert_eq!(small.pixels[0], [5.5, 11.0, 0.0]);
        assert_eq!(small.pixels[5], [29.5 - 0.0, 59.0, 0.0]);
        assert_eq!(small.clipped, [false, false, false, false, false, true]);
        assert!(large.averaged(None, 4, 4).is_none() && large.averaged(None, 6, 2).is_none());
        assert!(large.averaged(None, 12, 8).is_none() && large.averaged(None, 0, 0).is_none());
        assert_eq!(large.averaged(None, 6, 4).map(|(same, _)| same), Some(large));
    }

    #[test]
    fn masked_pixels_take_no_part() {
        let mut large = photo(2, 2, |x, _| x as f32);
        large.pixels[0] = [f32::NAN; 3];
        large.clipped[0] = true;
        let mask = PhotoMask { width: 2, height: 2, values: vec![0.0, 1.0, 1.0, 0.5] };
        let (small, weights) = large.averaged(Some(&mask), 1, 1).expect("half the size");
        assert_eq!(small.pixels, [[0.6, 1.2, 0.0]]);
        assert_eq!(weights.map(|mask| mask.values), Some(vec![0.625]));
        assert!(!small.clipped[0]);
        assert_eq!(mask.averaged(1, 1).map(|mask| mask.values), Some(vec![0.625]));
    }
}
