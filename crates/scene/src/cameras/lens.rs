//! The lens of a photograph: a pinhole with radial and tangential distortion.

use glam::{DMat2, DVec2, DVec3};

/// Most pixels along a side of a photograph.
const MOST_PIXELS: u32 = 1 << 16;
/// How far a pixel of a centred pinhole may be from that of a lens that passes for one, pixels.
const SAME: f64 = 1e-3;
/// Tangent of the largest angle to the optical axis at which a distortion is evaluated: 87 degrees.
const WIDEST: f64 = 20.0;

/// Coefficients of the model of OpenCV: radial k1, k2, k3, tangential p1, p2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// Of r².
    pub k1: f64,
    /// Of r⁴.
    pub k2: f64,
    /// Of r⁶.
    pub k3: f64,
    /// Tangential, vertical.
    pub p1: f64,
    /// Tangential, horizontal.
    pub p2: f64,
}

impl Distortion {
    /// Whether straight lines stay straight.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Where a point at depth 1 appears.
    fn distort(&self, p: DVec2) -> DVec2 {
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let tangential = DVec2::new(
            2.0 * self.p1 * p.x * p.y + self.p2 * (r2 + 2.0 * p.x * p.x),
            self.p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * self.p2 * p.x * p.y,
        );
        radial * p + tangential
    }

    /// The derivative of [`Self::distort`].
    fn derivative(&self, p: DVec2) -> DMat2 {
        let DVec2 { x, y } = p;
        let r2 = p.length_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        // Of the radial factor by r², twice: by x it is this times x.
        let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3));
        let across = slope * x * y + 2.0 * (self.p1 * x + self.p2 * y);
        DMat2::from_cols(
            DVec2::new(radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x, across),
            DVec2::new(across, radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x),
        )
    }

    /// The largest radius at depth 1 up to which the distortion is one to one. Beyond it the picture would fold back.
    fn reach(&self) -> f64 {
        const DIRECTIONS: usize = 32;
        const STEPS: usize = 256;
        if self.is_none() {
            return f64::INFINITY;
        }
        let unfolded = |radius: f64| {
            (0..DIRECTIONS).all(|k| {
                let direction = DVec2::from_angle(std::f64::consts::TAU * k as f64 / DIRECTIONS as f64);
                let derivative = self.derivative(radius * direction);
                // Both stretches stay positive: along the radius and of areas.
                derivative.determinant() > 0.0 && direction.dot(derivative * direction) > 0.0
            })
        };
        // Steps grow with the radius.
        let radius = |k: usize| WIDEST * (k as f64 / STEPS as f64).powi(2);
        let Some(first) = (0..=STEPS).find(|&k| !unfolded(radius(k))) else {
            return WIDEST;
        };
        let (mut good, mut bad) = (radius(first.saturating_sub(1)), radius(first));
        for _ in 0..50 {
            let middle = f64::midpoint(good, bad);
            *(if unfolded(middle) { &mut good } else { &mut bad }) = middle;
        }
        good
    }
}

/// A lens with the size of its picture. Pixels are counted from the upper left corner of the picture, so that the centre of the first
/// is at (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Columns of the picture.
    pub width: u32,
    /// Rows of the picture.
    pub height: u32,
    /// Focal length horizontally and vertically, pixels.
    pub focal: DVec2,
    /// The principal point, pixels.
    pub centre: DVec2,
    /// Distortion.
    pub distortion: Distortion,
}

impl Lens {
    /// Says what is wrong with the lens, if anything.
    ///
    /// # Errors
    /// Fails if a value is not finite, if the size or the focal length is out of range, or if the distortion folds at the principal point.
    pub fn check(&self) -> Result<(), String> {
        for (what, pixels) in [("width", self.width), ("height", self.height)] {
            if pixels == 0 || pixels > MOST_PIXELS {
                return Err(format!("its {what} is {pixels} pixels; it must lie in 1 to {MOST_PIXELS}"));
            }
        }
        if !(self.focal.is_finite() && self.focal.min_element() > 0.0) {
            return Err(format!("its focal length is {} pixels; it must be finite and above 0", self.focal));
        }
        if !self.centre.is_finite() {
            return Err(format!("its principal point is {}; it must be finite", self.centre));
        }
        let Distortion { k1, k2, k3, p1, p2 } = self.distortion;
        if [k1, k2, k3, p1, p2].iter().any(|k| !k.is_finite()) {
            return Err("a coefficient of its distortion is not finite; correct it".to_owned());
        }
        let size = DVec2::new(self.width.into(), self.height.into());
        if self.centre.cmplt(DVec2::ZERO).any() || self.centre.cmpgt(size).any() {
            return Err(format!(
                "its principal point is {}, outside of the picture of {} x {}; undistort the pictures first",
                self.centre, self.width, self.height
            ));
        }
        if self.half_width() <= 0.0 || !self.half_width().is_finite() {
            return Err(format!(
                "its distortion k1 = {k1}, k2 = {k2} folds the picture at its centre; correct it"
            ));
        }
        let fov = self.fov_x_degrees();
        if !(fov > 1e-6 && fov < 179.9) {
            return Err(format!("its horizontal field of view is {fov} degrees; correct the focal length"));
        }
        Ok(())
    }

    /// The pixel at which a direction appears, given to the right, down and forwards; `None` behind the camera, and where the
    /// distortion would fold the picture. It may lie outside of the picture.
    pub fn project(&self, direction: DVec3) -> Option<DVec2> {
        self.projection().project(direction)
    }

    /// What projects many directions.
    pub fn projection(&self) -> Projection {
        Projection { lens: *self, reach: self.distortion.reach() }
    }

    /// Tangent of half the horizontal field of the centred pinhole that keeps the picture's: of the side that reaches further.
    fn half_width(&self) -> f64 {
        let (left, right) =
            (self.centre.x / self.focal.x, (f64::from(self.width) - self.centre.x) / self.focal.x);
        if self.distortion.is_none() {
            return left.max(right);
        }
        let reach = self.distortion.reach();
        // At the height of the principal point the distortion is monotone within its reach.
        let undistorted = |side: f64, sign: f64| {
            let (mut low, mut high) = (0.0, reach);
            for _ in 0..80 {
                let middle = f64::midpoint(low, high);
                let seen = sign * self.distortion.distort(DVec2::new(sign * middle, 0.0)).x;
                *(if seen <= side { &mut low } else { &mut high }) = middle;
            }
            low
        };
        undistorted(left, -1.0).max(undistorted(right, 1.0))
    }

    /// The same lens for a picture of another size.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let factor =
            DVec2::new(width.into(), height.into()) / DVec2::new(self.width.into(), self.height.into());
        Self { width, height, focal: self.focal * factor, centre: self.centre * factor, ..*self }
    }

    /// The horizontal field of view of the centred pinhole that takes the place of this lens.
    pub fn fov_x_degrees(&self) -> f64 {
        2.0 * self.half_width().atan().to_degrees()
    }

    /// Whether the lens is a centred pinhole with square pixels, to a thousandth of a pixel everywhere in the picture.
    pub fn is_centred_pinhole(&self) -> bool {
        const STEPS: u32 = 16;
        let projection = self.projection();
        let size = DVec2::new(self.width.into(), self.height.into());
        let half = self.half_width();
        (0..=STEPS).all(|row| {
            (0..=STEPS).all(|column| {
                let pixel = size * DVec2::new(column.into(), row.into()) / f64::from(STEPS);
                let seen = projection.project(pinhole_ray(size, half, pixel));
                seen.is_some_and(|seen| (seen - pixel).abs().max_element() <= SAME)
            })
        })
    }

    /// The direction, to the right, down and forwards, of a point of the picture of the centred pinhole that takes the place of this
    /// lens, in pixels of a picture of some size.
    pub fn pinhole_rays(&self, width: u32, height: u32) -> impl Fn(DVec2) -> DVec3 + Sync {
        let (size, half) = (DVec2::new(width.into(), height.into()), self.half_width());
        move |pixel| pinhole_ray(size, half, pixel)
    }
}

fn pinhole_ray(size: DVec2, half_width: f64, pixel: DVec2) -> DVec3 {
    ((pixel - size / 2.0) * (2.0 * half_width / size.x)).extend(1.0)
}

/// A lens with what its projection needs.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    lens: Lens,
    reach: f64,
}

impl Projection {
    /// As [`Lens::project`].
    pub fn project(&self, direction: DVec3) -> Option<DVec2> {
        let p = direction.truncate() / direction.z;
        let shown = direction.z > 0.0 && p.length() <= self.reach;
        shown.then(|| self.lens.distortion.distort(p) * self.lens.focal + self.lens.centre)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain() -> Lens {
        Lens {
            width: 320,
            height: 240,
            focal: DVec2::splat(200.0),
            centre: DVec2::new(160.0, 120.0),
            distortion: Distortion::default(),
        }
    }

    #[test]
    fn points_appear_where_opencv_has_them() {
        let lens = Lens {
            focal: DVec2::new(210.0, 190.0),
            centre: DVec2::new(150.0, 130.0),
            distortion: Distortion { k1: -0.1, k2: 0.02, k3: 0.003, p1: 0.001, p2: -0.002 },
            ..plain()
        };
        // cv2.projectPoints of (0.3, -0.2, 1), by hand: r² = 0.13.
        let (x, y, r2) = (0.3, -0.2, 0.13);
        let radial = 1.0 - 0.1 * r2 + 0.02 * r2 * r2 + 0.003 * r2 * r2 * r2;
        let u = x * radial + 2.0 * 0.001 * x * y - 0.002 * (r2 + 2.0 * x * x);
        let v = y * radial + 0.001 * (r2 + 2.0 * y * y) - 2.0 * 0.002 * x * y;
        let seen = lens.project(DVec3::new(0.6, -0.4, 2.0)).expect("in front");
        assert!((seen - DVec2::new(210.0 * u + 150.0, 190.0 * v + 130.0)).length() < 1e-12, "{seen}");
        assert_eq!(lens.project(DVec3::NEG_Z), None);
        assert_eq!(lens.project(DVec3::X), None);
        // The derivative by differences.
        let (p, step) = (DVec2::new(0.4, -0.3), 1e-6);
        for axis in [DVec2::X, DVec2::Y] {
            let (ahead, behind) =
                (lens.distortion.distort(p + step * axis), lens.distortion.distort(p - step * axis));
            let difference = (ahead - behind) / (2.0 * step);
            assert!((difference - lens.distortion.derivative(p) * axis).length() < 1e-8);
        }
    }

    #[test]
    fn a_distortion_does_not_fold() {
        // r (1 - r²/4) turns at r² = 4/3, where it is 0.77.
        let lens = Lens { distortion: Distortion { k1: -0.25, ..Distortion::default() }, ..plain() };
        let turn = (4.0_f64 / 3.0).sqrt();
        assert!((lens.distortion.reach() - turn).abs() < 1e-9);
        assert!(lens.project(DVec3::new(turn - 1e-6, 0.0, 1.0)).is_some());
        assert_eq!(lens.project(DVec3::new(turn + 1e-6, 0.0, 1.0)), None);
        // The field ends where the picture does: 0.8 is beyond the turn.
        assert!((lens.fov_x_degrees() - 2.0 * turn.atan().to_degrees()).abs() < 1e-6);
        // It is the inverse of the distortion where there is one.
        let lens = Lens { focal: DVec2::splat(400.0), ..lens };
        let half = (lens.fov_x_degrees() / 2.0).to_radians().tan();
        assert!((half * (1.0 - half * half / 4.0) - 0.4).abs() < 1e-12);
    }

    #[test]
    fn which_lenses_are_pinholes() {
        assert!(plain().is_centred_pinhole());
        let moved = |by: f64| Lens { centre: DVec2::new(160.0 + by, 120.0), ..plain() };
        assert!(moved(4e-4).is_centred_pinhole() && !moved(0.01).is_centred_pinhole());
        let squeezed = |by: f64| Lens { focal: DVec2::new(200.0, 200.0 * (1.0 + by)), ..plain() };
        assert!(squeezed(1e-6).is_centred_pinhole() && !squeezed(1e-4).is_centred_pinhole());
        let bent = |k1: f64| Lens { distortion: Distortion { k1, ..Distortion::default() }, ..plain() };
        assert!(bent(1e-9).is_centred_pinhole() && !bent(1e-4).is_centred_pinhole());
    }

    #[test]
    fn what_is_no_lens() {
        assert_eq!(plain().check(), Ok(()));
        let bent = |k1: f64| Distortion { k1, ..Distortion::default() };
        for (lens, part) in [
            (Lens { width: 0, ..plain() }, "width is 0"),
            (Lens { focal: DVec2::new(200.0, -1.0), ..plain() }, "focal length"),
            (Lens { centre: DVec2::NAN, ..plain() }, "principal point"),
            (Lens { centre: DVec2::new(-5.0, 0.0), ..plain() }, "outside of the picture"),
            (Lens { distortion: bent(f64::INFINITY), ..plain() }, "not finite"),
            (Lens { distortion: bent(-1e300), ..plain() }, "folds"),
            (Lens { focal: DVec2::splat(1e300), ..plain() }, "field of view"),
        ] {
            let error = lens.check().expect_err(part);
            assert!(error.contains(part), "{error}");
        }
    }
}
