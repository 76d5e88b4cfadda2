//! The lens of a frame as its file has it, which may leave the size to the picture.

use glam::DVec2;

use super::{Distortion, Lens};

/// How a file states the focal length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Focal {
    /// Not at all.
    #[default]
    Unknown,
    /// Horizontally and vertically, pixels.
    Pixels(DVec2),
    /// By the horizontal field of view, radians; pixels are square.
    AngleX(f64),
    /// By the vertical field of view, radians; pixels are square.
    AngleY(f64),
}

/// A lens whose size may be that of the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Intrinsics {
    /// The focal length.
    pub focal: Focal,
    /// Columns, if stated.
    pub width: Option<u32>,
    /// Rows, if stated.
    pub height: Option<u32>,
    /// Column of the principal point, in pixels from the left edge; in the middle if not stated.
    pub centre_x: Option<f64>,
    /// Row of the principal point, in pixels from the top edge; in the middle if not stated.
    pub centre_y: Option<f64>,
    /// Distortion.
    pub distortion: Distortion,
}

impl Intrinsics {
    /// Columns and rows, if both are stated.
    pub fn size(&self) -> Option<[u32; 2]> {
        Some([self.width?, self.height?])
    }

    /// The lens, with the size of the picture where none is stated.
    ///
    /// # Errors
    /// Says what is wrong if there is no focal length, or if a value is out of range.
    pub fn lens(&self, picture: [u32; 2]) -> Result<Lens, String> {
        let [width, height] = [self.width.unwrap_or(picture[0]), self.height.unwrap_or(picture[1])];
        let size = DVec2::new(width.into(), height.into());
        let of_angle = |what: &str, angle: f64, side: f64| match angle > 0.0 && angle < std::f64::consts::PI {
            true => Ok(DVec2::splat(side / 2.0 / (angle / 2.0).tan())),
            false => Err(format!("{what} is {angle}; it must lie between 0 and π radians")),
        };
        let focal = match self.focal {
            Focal::Pixels(focal) => focal,
            Focal::AngleX(angle) => of_angle("camera_angle_x", angle, size.x)?,
            Focal::AngleY(angle) => of_angle("camera_angle_y", angle, size.y)?,
            Focal::Unknown => {
                return Err(
                    "no focal length is given; add camera_angle_x (radians) or fl_x (pixels)".to_owned()
                );
            }
        };
        let lens = Lens {
            width,
            height,
            focal,
            centre: DVec2::new(self.centre_x.unwrap_or(size.x / 2.0), self.centre_y.unwrap_or(size.y / 2.0)),
            distortion: self.distortion,
        };
        lens.check()?;
        Ok(lens)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_come_from_the_picture_where_none_is_stated() {
        let angle = std::f64::consts::FRAC_PI_2;
        let lens = Intrinsics { focal: Focal::AngleX(angle), ..Intrinsics::default() }
            .lens([80, 40])
            .expect("a lens");
        assert!((lens.focal - DVec2::splat(40.0)).length() < 1e-12);
        assert_eq!((lens.width, lens.height, lens.centre), (80, 40, DVec2::new(40.0, 20.0)));
        let stated = Intrinsics {
            width: Some(10),
            centre_x: Some(4.0),
            focal: Focal::AngleY(angle),
            ..Intrinsics::default()
        };
        let lens = stated.lens([80, 40]).expect("a lens");
        assert_eq!((lens.width, lens.height, lens.centre), (10, 40, DVec2::new(4.0, 20.0)));
        assert!((lens.focal - DVec2::splat(20.0)).length() < 1e-12);
        let of = |focal| Intrinsics { focal, ..Intrinsics::default() }.lens([80, 40]).expect_err("no lens");
        assert!(of(Focal::Unknown).contains("camera_angle_x"));
        assert!(of(Focal::AngleX(4.0)).contains("between 0 and π"));
        assert!(of(Focal::Pixels(DVec2::NAN)).contains("focal length"));
    }
}
