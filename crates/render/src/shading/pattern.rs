//! Textures in pictures: the mean of a pattern over a pixel.

use super::sights::{hit, on_plane};
use crate::image::{FaceInPixel, View};
use antirad_core::direct::barycentric;
use antirad_core::model::Facet;
use antirad_scene::{Factors, Patterns};
use glam::DVec3;

/// Samples along a side of a pixel, at least and at most.
const SAMPLES: [u32; 2] = [2, 16];

/// How far beyond a face its texture is sampled, as a barycentric coordinate.
const BEYOND: f64 = 1.0;

/// Part of a picture that shows a face: a square around its middle, in pixels; a point if its side is 0.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    pub middle: [f64; 2],
    pub side: f64,
}

/// A sample of a spot.
pub struct Sample {
    pub ray: DVec3,
    pub point: DVec3,
    pub factors: Factors,
}

impl From<&FaceInPixel> for Spot {
    /// A square as large as what the pixel shows of the face.
    fn from(seen: &FaceInPixel) -> Self {
        Self { middle: seen.place, side: seen.share.sqrt() }
    }
}

impl Spot {
    /// Samples of a face's pattern, which all count alike: about one for each texel, or none where the face has no pattern.
    pub fn samples(
        self,
        patterns: &Patterns,
        facet: &Facet,
        face: usize,
        eye: DVec3,
        view: &View,
    ) -> Vec<Sample> {
        if !patterns.vary(face) {
            return Vec::new();
        }
        let [column, row] = self.middle;
        let ray = |x: f64, y: f64| view.ray(column + self.side * x, row + self.side * y);
        let weights = |ray: DVec3| {
            // A texture goes on beyond the face, so that pixels at an edge are as smooth as others, but not far beyond.
            let point = on_plane(facet, eye, ray);
            let b = barycentric(facet.corners, facet.normal, point);
            if b.min_element() >= -BEYOND {
                return (point, b);
            }
            let point = hit(facet, eye, ray);
            (point, barycentric(facet.corners, facet.normal, point))
        };
        let count = if self.side > 0.0 {
            let corner = |x: f64, y: f64| weights(ray(x, y)).1;
            let diagonals = [[(-0.5, -0.5), (0.5, 0.5)], [(-0.5, 0.5), (0.5, -0.5)]];
            let texels = diagonals
                .map(|[(a, b), (c, d)]| patterns.texels_between(face, corner(a, b), corner(c, d)))
                .into_iter()
                .fold(0.0, f64::max);
            (texels.ceil() as u32).next_power_of_two().clamp(SAMPLES[0], SAMPLES[1])
        } else {
            1
        };
        let along = |k: u32| (f64::from(k) + 0.5) / f64::from(count) - 0.5;
        let places = (0..count).flat_map(|y| (0..count).map(move |x| (x, y)));
        let sample = |(x, y): (u32, u32)| {
            let ray = ray(along(x), along(y));
            let (point, b) = weights(ray);
            Some(Sample { ray, point, factors: patterns.at(face, b)? })
        };
        places.filter_map(sample).collect()
    }

    /// Means of the factors of albedo and emission over the spot.
    pub fn mean(samples: &[Sample]) -> [DVec3; 2] {
        [0, 1].map(|k| samples.iter().map(|s| s.factors.value[k]).sum::<DVec3>() / samples.len() as f64)
    }
}
