//! Photographs of any lens as a centred pinhole with square pixels would have taken them.

use antirad_base::parallel;
use antirad_scene::Lens;
use glam::DVec2;

use super::average::Sum;
use super::{Photo, PhotoMask};

impl Photo {
    /// The picture of the pinhole with the horizontal field of view of the lens ([`Lens::fov_x_degrees`]), by samples between pixels, as
    /// many in a pixel as it shrinks; and the weights of its pixels: 0 where the photo shows nothing, elsewhere those of the mask.
    /// The lens may be for another size of the same picture. A mask has the size of the photo.
    pub fn through_pinhole(
        &self,
        lens: &Lens,
        mask: Option<&PhotoMask>,
        width: u32,
        height: u32,
    ) -> (Self, PhotoMask) {
        let lens = lens.resized(self.width, self.height);
        let projection = lens.projection();
        let ray = lens.pinhole_rays(width, height);
        let middle = DVec2::new(width.into(), height.into()) / 2.0;
        let step = (ray(middle + DVec2::X) - ray(middle)).length() * lens.focal.max_element();
        // A thousandth more than one pixel is one.
        let across = (step - 1e-3).ceil().clamp(1.0, 64.0) as u32;
        let one = |index: usize| {
            let corner = DVec2::new((index % width as usize) as f64, (index / width as usize) as f64);
            let mut sum = Sum::default();
            for y in 0..across {
                for x in 0..across {
                    let within = (DVec2::new(x.into(), y.into()) + 0.5) / f64::from(across);
                    let seen = projection.project(ray(corner + within));
                    if !seen.is_some_and(|seen| self.add_at(seen, mask, &mut sum)) {
                        sum.uncovered = true;
                    }
                }
            }
            sum
        };
        let sums: Vec<Sum> = parallel::map(0..width as usize * height as usize, one);
        (self.with(width, height, &sums), Sum::mask(&sums, width, height))
    }

    /// Adds the value between the centres of four pixels. False outside of the picture.
    fn add_at(&self, at: DVec2, mask: Option<&PhotoMask>, sum: &mut Sum) -> bool {
        let size = DVec2::new(self.width.into(), self.height.into());
        if !(at.cmpge(DVec2::ZERO).all() && at.cmple(size).all()) {
            return false;
        }
        let at = (at - 0.5).clamp(DVec2::ZERO, size - 1.0);
        let low = at.floor();
        let part = at - low;
        for (dx, share_x) in [(0, 1.0 - part.x), (1, part.x)] {
            for (dy, share_y) in [(0, 1.0 - part.y), (1, part.y)] {
                let share = share_x * share_y;
                // The last pixel has no neighbour, whose share is 0.
                if share > 0.0 {
                    let index = (low.y as usize + dy) * self.width as usize + low.x as usize + dx;
                    let weight = mask.map_or(1.0, |mask| f64::from(mask.values[index]));
                    sum.add(share, weight, self.pixels[index], self.clipped[index]);
                }
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::Distortion;
    use glam::DVec3;

    fn lens(distortion: Distortion) -> Lens {
        Lens {
            width: 200,
            height: 150,
            focal: DVec2::new(130.0, 120.0),
            centre: DVec2::new(90.0, 80.0),
            distortion,
        }
    }

    /// A photo whose red and green are column and row.
    fn ramp(width: u32, height: u32) -> Photo {
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let pixels: Vec<[f32; 3]> = places.map(|(x, y)| [x as f32 + 0.5, y as f32 + 0.5, 1.0]).collect();
        let clipped = vec![false; pixels.len()];
        Photo { width, height, pixels, clipped, ends_at_white: false, exposure: None }
    }

    /// Each pixel of the resampled ramp has the place at which the lens shows what the pinhole shows there.
    #[test]
    fn pixels_come_from_where_the_lens_shows_them() {
        for distortion in [
            Distortion::default(),
            Distortion { k1: -0.12, k2: 0.01, p1: 0.002, p2: -0.001, ..Distortion::default() },
            Distortion { k1: 0.1, ..Distortion::default() },
        ] {
            let lens = lens(distortion);
            let (photo, mask) = ramp(200, 150).through_pinhole(&lens, None, 200, 150);
            let projection = lens.projection();
            let focal = 100.0 / (lens.fov_x_degrees() / 2.0).to_radians().tan();
            let mut covered = 0;
            for (index, (pixel, weight)) in photo.pixels.iter().zip(&mask.values).enumerate() {
                let (x, y) = ((index % 200) as f64 + 0.5, (index / 200) as f64 + 0.5);
                let seen = projection.project(DVec3::new((x - 100.0) / focal, (y - 75.0) / focal, 1.0));
                let inside = seen.filter(|p| p.cmpge(DVec2::ZERO).all() && p.x <= 200.0 && p.y <= 150.0);
                let Some(seen) = inside.filter(|_| *weight > 0.0) else {
                    // Only pixels at the very edge have their middle in the photo, and a corner outside.
                    let reach = DVec2::new(99.0, 74.0);
                    assert!(inside.is_none_or(|p| (p - DVec2::new(100.0, 75.0)).abs().cmpgt(reach).any()));
                    continue;
                };
                covered += 1;
                let value = DVec2::new(pixel[0].into(), pixel[1].into());
                // At the edges the outer half pixel is that of the last centre. A mean over four samples is not quite that in the middle.
                let from_middle = (seen - DVec2::new(100.0, 75.0)).abs();
                let bound = if from_middle.cmplt(DVec2::new(99.0, 74.0)).all() { 5e-3 } else { 0.75 };
                assert!((value - seen).length() < bound, "{value} {seen}");
            }
            assert!(covered > 20_000, "{covered}");
        }
    }

    /// The side of the photo that is further from the principal point ends at the edge of the picture.
    #[test]
    fn the_horizontal_field_stays() {
        let lens = lens(Distortion { k1: -0.1, ..Distortion::default() });
        let half = (lens.fov_x_degrees() / 2.0).to_radians().tan();
        let edge = lens.project(DVec3::new(half, 0.0, 1.0)).expect("in the picture");
        assert!((edge.x - 200.0).abs() < 1e-9, "{edge}");
    }

    /// Beyond the turn of the distortion nothing is shown twice.
    #[test]
    fn what_would_fold_is_not_covered() {
        let lens = Lens {
            focal: DVec2::splat(100.0),
            centre: DVec2::new(100.0, 75.0),
            ..lens(Distortion { k1: -0.25, ..Distortion::default() })
        };
        let (_, mask) = ramp(200, 150).through_pinhole(&lens, None, 200, 150);
        let focal = 100.0 / (lens.fov_x_degrees() / 2.0).to_radians().tan();
        let turn = focal * (4.0_f64 / 3.0).sqrt();
        for (index, weight) in mask.values.iter().enumerate() {
            let from_centre = DVec2::new((index % 200) as f64 - 99.5, (index / 200) as f64 - 74.5);
            assert!(*weight == 0.0 || from_centre.length() <= turn + 1e-6, "{from_centre}");
        }
        assert!(mask.values[0] == 0.0 && mask.values[75 * 200 + 100] == 1.0);
    }

    /// A large photo of stripes becomes their mean.
    #[test]
    fn shrinking_averages() {
        let mut stripes = ramp(800, 600);
        for (index, pixel) in stripes.pixels.iter_mut().enumerate() {
            *pixel = [(index % 800 % 2) as f32; 3];
        }
        let (photo, mask) = stripes.through_pinhole(&lens(Distortion::default()), None, 200, 150);
        let counted = photo.pixels.iter().zip(&mask.values).filter(|(_, weight)| **weight > 0.0);
        assert!(counted.clone().count() > 10_000);
        assert!(counted.into_iter().all(|(pixel, _)| (pixel[0] - 0.5).abs() < 0.15));
    }
}
