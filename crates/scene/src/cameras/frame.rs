//! One posed picture.

use std::path::PathBuf;

use glam::{DMat3, DVec3};

use super::{Intrinsics, Lens, Similarity};
use crate::Camera;

/// How far the axes of a pose may be from unit length and from right angles: files have few digits.
const RIGID: f64 = 1e-3;

/// A picture with the pose and the lens of its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Name, after the picture: unlike those of all other frames of the set.
    pub name: String,
    /// The picture, as the file has it: perhaps without suffix, perhaps elsewhere.
    pub picture: PathBuf,
    /// Centre of projection.
    pub position: DVec3,
    /// Unit vector along the optical axis.
    pub forward: DVec3,
    /// Unit vector to the top of the picture.
    pub up: DVec3,
    /// The lens, as far as the file has it.
    #[doc(hidden)]
    pub intrinsics: Intrinsics,
}

impl Frame {
    /// A frame from its centre and the axes of its camera in the world: to the right, up and forwards. Says what is wrong with the pose.
    pub(super) fn new(
        picture: PathBuf,
        position: DVec3,
        [right, up, forward]: [DVec3; 3],
        intrinsics: Intrinsics,
    ) -> Result<Self, String> {
        let axes = [right, up, forward];
        if !position.is_finite() || axes.iter().any(|axis| !axis.is_finite()) {
            return Err("its pose is not finite; correct it, or remove the frame".to_owned());
        }
        let is_unit = |axis: &DVec3| (axis.length() - 1.0).abs() <= RIGID;
        let dots = [right.dot(up), up.dot(forward), forward.dot(right)];
        if !axes.iter().all(is_unit) || dots.iter().any(|dot| dot.abs() > RIGID) {
            return Err(format!(
                "its pose is not rigid: the axes of the camera are {:.4}, {:.4} and {:.4} long, with cosines between them of up \
                 to {:.4}; take scale and shear out of the poses",
                right.length(),
                up.length(),
                forward.length(),
                dots.iter().fold(0.0, |most: f64, dot| most.max(dot.abs()))
            ));
        }
        if DMat3::from_cols(right, up, -forward).determinant() < 0.0 {
            return Err("its pose mirrors the world; negate one axis of the cameras".to_owned());
        }
        let forward = forward.normalize();
        let up = (up - forward * up.dot(forward)).normalize();
        Ok(Self { name: String::new(), picture, position, forward, up, intrinsics })
    }

    /// The centred pinhole camera of this frame, with the field of view of a lens.
    #[doc(hidden)]
    pub fn camera(&self, lens: &Lens, width: u32, height: u32) -> Camera {
        Camera {
            name: self.name.clone(),
            position: self.position,
            target: self.position + self.forward,
            up: self.up,
            fov_x_degrees: lens.fov_x_degrees(),
            width,
            height,
        }
    }

    /// Moves the frame from the world of its set into that of a scene.
    #[doc(hidden)]
    pub fn transform(&mut self, to_scene: &Similarity) {
        self.position = to_scene.point(self.position);
        self.forward = to_scene.direction(self.forward);
        self.up = to_scene.direction(self.up);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(axes: [DVec3; 3]) -> Result<Frame, String> {
        Frame::new(PathBuf::from("a.png"), DVec3::ONE, axes, Intrinsics::default())
    }

    #[test]
    fn poses_are_rigid() {
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::NEG_Z];
        let good = frame([x, y + DVec3::new(0.0, 0.0, 1e-5), z]).expect("a few digits");
        assert!(good.up.dot(good.forward).abs() < 1e-15 && (good.up.length() - 1.0).abs() < 1e-15);
        for (axes, part) in [
            ([x * 2.0, y * 2.0, z * 2.0], "not rigid"),
            ([x, (x + y).normalize(), z], "cosines between them of up to 0.7071"),
            ([x, y, -z], "mirrors"),
            ([x, y * f64::NAN, z], "not finite"),
            ([DVec3::ZERO, y, z], "not rigid"),
        ] {
            let error = frame(axes).expect_err(part);
            assert!(error.contains(part), "{error}");
        }
    }
}
