//! The pinhole camera.

use glam::DVec3;

use super::SceneError;

const MAX_PIXELS: u32 = 16384;

/// A pinhole camera, right-handed, looking from `position` to `target`.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Name, for messages and files.
    pub name: String,
    /// Centre of projection, m.
    pub position: DVec3,
    /// A point on the optical axis, m.
    pub target: DVec3,
    /// A direction that points up in the picture.
    pub up: DVec3,
    /// Horizontal field of view in degrees, in (0, 180).
    pub fov_x_degrees: f64,
    /// Columns of its picture, pixels.
    pub width: u32,
    /// Rows of its picture, pixels.
    pub height: u32,
}

impl Camera {
    /// A camera named "auto" that frames the bounding box of the vertices from the front (+z), above and slightly right.
    pub fn framing(vertices: &[DVec3]) -> Self {
        const FOV_DEGREES: f64 = 45.0;
        let low = vertices.iter().copied().reduce(DVec3::min).unwrap_or_default();
        let high = vertices.iter().copied().reduce(DVec3::max).unwrap_or_default();
        let target = low.midpoint(high);
        let radius = (high - low).length() / 2.0;
        let distance = if radius > 0.0 { radius / (FOV_DEGREES / 2.0).to_radians().sin() } else { 1.0 };
        Self {
            name: String::from("auto"),
            position: target + DVec3::new(0.35, 0.3, 1.0).normalize() * distance,
            target,
            up: DVec3::Y,
            fov_x_degrees: FOV_DEGREES,
            width: 256,
            height: 256,
        }
    }

    /// Says what is wrong with the camera, if anything.
    ///
    /// # Errors
    /// Fails if a vector is not finite, if position, target and up define no view, or if the field of view,
    /// the width or the height is out of range.
    pub fn check(&self) -> Result<(), SceneError> {
        let refuse = |message: String| Err(SceneError::Camera { name: self.name.clone(), message });
        for (what, vector) in [("position", self.position), ("target", self.target), ("up", self.up)] {
            if !vector.is_finite() {
                return refuse(format!("{what} is {vector}; it must be finite"));
            }
        }
        let Some(view) = (self.target - self.position).try_normalize() else {
            return refuse(format!("position and target are both {}; move one of them", self.position));
        };
        let Some(up) = self.up.try_normalize() else {
            return refuse(String::from("up has no length; use for example [0, 1, 0]"));
        };
        if view.cross(up).length() < 1e-6 {
            return refuse(format!(
                "up {} is parallel to the view; choose another, for example [0, 0, 1]",
                self.up
            ));
        }
        if !(self.fov_x_degrees > 0.0 && self.fov_x_degrees < 180.0) {
            return refuse(format!("fov_x_degrees is {}; it must lie between 0 and 180", self.fov_x_degrees));
        }
        for (what, pixels) in [("width", self.width), ("height", self.height)] {
            if pixels == 0 || pixels > MAX_PIXELS {
                return refuse(format!("{what} is {pixels} pixels; it must lie in 1 to {MAX_PIXELS}"));
            }
        }
        Ok(())
    }
}
