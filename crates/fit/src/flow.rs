//! How pictures change where cameras move: what they show moves in them, and keeps its radiance.

use antirad_render::image::View;
use antirad_scene::Camera;
use glam::{DVec2, DVec3};

/// A picture after a small motion of its camera, by the brightness constancy of optical flow (Lucas and Kanade 1981): I(u) - ∇I · Δu, with Δu
/// the motion in the picture of the point that a pixel shows. `points`: that point per pixel. At a silhouette it is what is in front that moves.
pub(super) fn moved(picture: &[DVec3], points: &[Option<DVec3>], from: &Camera, to: &Camera) -> Vec<DVec3> {
    let (width, height) = (from.width as usize, from.height as usize);
    let [before, after] = [from, to].map(View::new);
    let pixel = |at: usize| {
        // Forward differences keep more of an edge, which is one pixel wide, than central ones.
        // At the far border they end there.
        let pair = |place: usize, count: usize, stride: usize| {
            let first = place.min(count.max(2) - 2);
            [first, (first + 1).min(count - 1)].map(|other| at - place * stride + other * stride)
        };
        let (across, down) = (pair(at % width, width, 1), pair(at / width, height, width));
        let shown = across.iter().chain(&down).filter_map(|&pixel| points[pixel]);
        let nearest = shown.min_by(|a, b| before.depth(*a).total_cmp(&before.depth(*b)));
        let DVec2 { x, y } = nearest.map_or(DVec2::ZERO, |point| after.place(point) - before.place(point));
        let slope = |[from, to]: [usize; 2]| picture[to] - picture[from];
        picture[at] - slope(across) * x - slope(down) * y
    };
    (0..picture.len()).map(pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall with a smooth pattern, seen before and after: the change is that of the pattern at the points that are seen.
    #[test]
    fn a_patterned_wall_moves_in_the_picture() {
        let camera = Camera {
            name: String::from("c"),
            position: DVec3::new(0.1, 0.2, 2.0),
            target: DVec3::new(0.0, 0.1, 0.0),
            up: DVec3::Y,
            fov_x_degrees: 60.0,
            width: 120,
            height: 90,
        };
        let pattern = |p: DVec3| DVec3::new(1.0 + 0.3 * (2.0 * p.x).sin(), 1.0 + 0.5 * p.y, 1.0 + p.x * p.y);
        let shot = |camera: &Camera| -> (Vec<DVec3>, Vec<Option<DVec3>>) {
            let view = View::new(camera);
            let point = |at: usize| {
                let ray = view.ray((at % 120) as f64 + 0.5, (at / 120) as f64 + 0.5);
                camera.position - ray * (camera.position.z / ray.z)
            };
            let points: Vec<DVec3> = (0..120 * 90).map(point).collect();
            (points.iter().map(|p| pattern(*p)).collect(), points.into_iter().map(Some).collect())
        };
        let (picture, points) = shot(&camera);
        for (turn, shift) in
            [(DVec3::ZERO, DVec3::new(0.004, -0.003, 0.01)), (DVec3::new(0.01, 0.0, 0.0), DVec3::ZERO)]
        {
            let to = Camera {
                position: camera.position + shift,
                target: camera.target + shift + turn,
                ..camera.clone()
            };
            let (found, exact) = (moved(&picture, &points, &camera, &to), shot(&to).0);
            let (mut error, mut change) = (0.0, 0.0);
            for ((found, exact), before) in found.iter().zip(&exact).zip(&picture) {
                error += (*found - *exact).length_squared();
                change += (*exact - *before).length_squared();
            }
            assert!((error / change).sqrt() < 0.05, "{}", (error / change).sqrt());
        }
    }
}
