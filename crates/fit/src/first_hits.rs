//! What pixels show.

use super::target::Target;
use antirad_render::image::View;
use antirad_scene::Rays;

/// Each pixel of a target that counts and shows something, with the nearest triangle at its centre.
pub(super) fn first_hits<'a>(
    rays: &'a Rays,
    target: &'a Target,
) -> impl Iterator<Item = (usize, usize)> + 'a {
    let camera = &target.camera;
    let (view, width) = (View::new(camera), camera.width as usize);
    let counting = (0..target.pixels.len()).filter(|&at| target.mask_at(at) > 0.0);
    counting.filter_map(move |at| {
        let ray = view.ray((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        let (triangle, _) = rays.nearest(camera.position, ray, None)?;
        Some((at, triangle))
    })
}
