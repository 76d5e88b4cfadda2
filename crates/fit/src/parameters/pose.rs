//! Poses of cameras: how unknowns move them, and the derivatives by them.
//!
//! The unknowns are a displacement and a rotation vector about the camera's position, in axes of the scene; of cameras that move together,
//! about the middle between them, with a factor on all distances. What a camera sees moves by about as much with one unit of each.

use super::super::median::median;
use super::super::motion::{FreeMotion, Motion, MotionGradient};
use antirad_render::image::{CameraGradient, View};
use antirad_scene::{Camera, Scene, bounds};
use glam::DVec3;

/// Radians per unit of a rotation. A displacement has as many times the depth of what the camera sees.
const ROTATION: f64 = 0.01;

/// The motion of the cameras of some views, about the middle between their places, of which such parts are unknown.
pub(super) fn free_motion(scene: &Scene, views: &[usize], parts: [bool; 3]) -> FreeMotion {
    let cameras = || views.iter().map(|&view| &scene.cameras[view]);
    let (low, high) = bounds(cameras().map(|camera| camera.position));
    let depth = median(cameras().map(|camera| depth(scene, camera)).collect()).unwrap_or(1.0);
    let units = [ROTATION * depth, ROTATION, ROTATION];
    FreeMotion { centre: low.midpoint(high), units: [0, 1, 2].map(|k| parts[k].then_some(units[k])) }
}

/// A camera that is moved.
pub(super) fn moved(camera: &Camera, motion: &Motion) -> Camera {
    Camera {
        position: motion.place(camera.position),
        target: motion.place(camera.target),
        up: turn(motion).place(camera.up),
        ..camera.clone()
    }
}

/// The derivative by the motion, from that by the camera after it.
pub(super) fn pull_back(camera: &Camera, motion: &Motion, by: &CameraGradient) -> MotionGradient {
    let places = [(camera.position, by.position), (camera.target, by.target)];
    let mut gradient = motion.pull_back(places.into_iter());
    gradient.rotation += turn(motion).pull_back(std::iter::once((camera.up, by.up))).rotation;
    gradient
}

/// What a motion does to directions.
fn turn(motion: &Motion) -> Motion {
    Motion { rotation: motion.rotation, ..Motion::at_rest(DVec3::ZERO) }
}

/// The change of an unknown of a pose that moves the picture by half a pixel.
pub(super) fn half_a_pixel(camera: &Camera) -> f64 {
    View::new(camera).tan_half_x / f64::from(camera.width) / ROTATION
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
