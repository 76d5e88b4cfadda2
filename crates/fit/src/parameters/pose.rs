//! Poses of cameras: how the unknowns of one move it, and the derivatives by them.
//!
//! The unknowns are a displacement and a rotation vector about the camera's position, in axes of the scene. What the camera sees moves by
//! about as much with one unit of each.

use super::super::median::median;
use super::super::motion::Motion;
use antirad_render::image::{CameraGradient, View};
use antirad_scene::{Camera, Scene};
use glam::DVec3;

/// Radians per unit of a rotation. A displacement has as many times the depth of what the camera sees.
const ROTATION: f64 = 0.01;

/// Unknowns of a pose.
pub(super) const UNKNOWNS: usize = 6;

/// A camera as given, and the scale of its displacement.
pub(super) struct Pose<'a> {
    /// The camera, before it moves.
    pub camera: &'a Camera,
    /// Metres per unit of the displacement.
    pub scale: f64,
}

impl Pose<'_> {
    /// The motion from the camera as given, for some unknowns.
    pub fn motion(&self, x: &[f64]) -> Motion {
        Motion {
            translation: self.scale * DVec3::from_slice(x),
            rotation: ROTATION * DVec3::from_slice(&x[3..]),
            ..Motion::at_rest(self.camera.position)
        }
    }

    /// The camera for some unknowns.
    pub fn moved(&self, x: &[f64]) -> Camera {
        let motion = self.motion(x);
        let turn = Motion { rotation: motion.rotation, ..Motion::at_rest(DVec3::ZERO) };
        let camera = self.camera;
        Camera {
            position: motion.place(camera.position),
            target: motion.place(camera.target),
            up: turn.place(camera.up),
            ..camera.clone()
        }
    }

    /// The derivative by the unknowns, from that by the camera.
    pub fn pull_back(&self, x: &[f64], by: &CameraGradient) -> [f64; UNKNOWNS] {
        let (camera, motion) = (self.camera, self.motion(x));
        let places = [(camera.position, by.position), (camera.target, by.target)];
        let of_places = motion.pull_back(places.into_iter());
        // A direction: it turns, and has no place.
        let of_up = motion.pull_back(std::iter::once((camera.position + camera.up, by.up)));
        let DVec3 { x, y, z } = self.scale * of_places.translation;
        let turn = ROTATION * (of_places.rotation + of_up.rotation);
        [x, y, z, turn.x, turn.y, turn.z]
    }
}

/// A bound on the components of a rotation vector, in units of the unknowns.
pub(super) fn largest_rotation(degrees: f64) -> f64 {
    degrees.to_radians() / ROTATION
}

/// The change of an unknown of a pose that moves the picture by half a pixel.
pub(super) fn half_a_pixel(camera: &Camera) -> f64 {
    View::new(camera).tan_half_x / f64::from(camera.width) / ROTATION
}

/// Metres per unit of a camera's displacement.
pub(super) fn scale(scene: &Scene, camera: &Camera) -> f64 {
    ROTATION * depth(scene, camera)
}

/// How far off half of the vertices in a camera's picture are, whatever hides them; if there are none, its target.
fn depth(scene: &Scene, camera: &Camera) -> f64 {
    let view = View::new(camera);
    let in_picture = |vertex: &DVec3| {
        let way = *vertex - view.position;
        let depth = way.dot(view.forward);
        let inside = way.dot(view.right).abs() <= depth * view.tan_half_x
            && way.dot(view.up).abs() <= depth * view.tan_half_y;
        (depth > 0.0 && inside).then_some(depth)
    };
    let depths = scene.vertices.iter().filter_map(in_picture).collect();
    median(depths).unwrap_or_else(|| (camera.target - camera.position).length())
}
