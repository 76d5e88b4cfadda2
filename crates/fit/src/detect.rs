//! Which triangles may be lamps: those that photos show bright, and what no photo shows.
//!
//! Candidates are generous. A fit of their emission, which cannot be negative, finds which of them shine: what is bright because a
//! lamp lights it is explained by that lamp.

use super::first_hits::first_hits;
use super::median::median;
use super::target::Target;
use antirad_scene::{Edges, Rays, Scene, Welded, free_name, sides};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashSet};

/// A part of a scene that may be a lamp.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Name of its mesh, with a number where a mesh has several.
    pub name: String,
    /// Its triangles, ascending.
    pub triangles: Vec<u32>,
    /// Whether a target shows it.
    pub is_seen: bool,
}

/// Where nothing clips, what is so many times as bright as the median of its picture is bright.
const BRIGHT: f64 = 10.0;
/// The same for bright triangles of a larger part that is not: most often a lamp lights them.
const BRIGHT_SPOT: f64 = 50.0;
/// Share of the pixels of a triangle that must be bright, over all pictures: the brightest walls are, in some of them.
const OFTEN: f64 = 0.7;
const OFTEN_OF_SPOT: f64 = 0.95;
/// Share of a connected part that must be bright for all of it to be a candidate, with what pictures do not show of it.
const MOST: f64 = 0.4;
/// Fewest pixels that show a candidate.
const PIXELS: u32 = 4;
/// Most candidates that no picture shows, the largest ones.
const UNSEEN: usize = 4;
/// Corners closer than this share of the scene's size are one, where triangles are asked for their neighbours.
const TOUCH: f64 = 1e-5;

/// What pictures show of a triangle.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    pixels: u32,
    bright: u32,
    spot: u32,
}

/// Parts of a scene that may be lamps, those that pictures show first, each in the order of their triangles.
///
/// A triangle counts as bright if most pixels that show it are clipped ([`Target::clip`]) or, where nothing clips, ten times as bright as
/// the median of their picture. Bright triangles that touch are a candidate, with all of their connected part of the mesh if most of what
/// is seen of it is bright; otherwise they must be five times as bright, as a lamp nearby often lights such spots.
pub fn candidates(scene: &Scene, targets: &[Target]) -> Vec<Candidate> {
    let seen = seen(scene, targets);
    let is_bright = |t: u32| {
        let Seen { pixels, bright, .. } = seen[t as usize];
        pixels > 0 && f64::from(bright) >= OFTEN * f64::from(pixels)
    };
    let is_spot = |t: u32| {
        let Seen { pixels, spot, .. } = seen[t as usize];
        pixels > 0 && f64::from(spot) >= OFTEN_OF_SPOT * f64::from(pixels)
    };
    let size =
        |triangles: &[u32]| triangles.iter().map(|&t| scene.area_vector(t as usize).length()).sum::<f64>();
    let (mut found, mut unseen) = (Vec::new(), Vec::new());
    let (low, high) = antirad_scene::bounds(scene.vertices.iter().copied());
    let welded = Welded::within((high - low).length().max(1.0) * TOUCH, scene.vertices.iter().copied());
    let parts = |triangles: Vec<u32>| parts(scene, &welded, triangles);
    for part in scene.meshes.iter().flat_map(|mesh| parts(mesh.range.clone().collect())) {
        let shown: Vec<u32> = part.iter().copied().filter(|&t| seen[t as usize].pixels > 0).collect();
        let bright: Vec<u32> = shown.iter().copied().filter(|&t| is_bright(t)).collect();
        if shown.is_empty() {
            unseen.push(part);
        } else if size(&bright) >= MOST * size(&shown) && size(&bright) > 0.0 {
            found.push(part);
        } else {
            found.extend(parts(shown.into_iter().filter(|&t| is_spot(t)).collect()));
        }
    }
    found.retain(|part| part.iter().map(|&t| seen[t as usize].bright).sum::<u32>() >= PIXELS);
    unseen.sort_by(|a, b| size(b).total_cmp(&size(a)).then(a.cmp(b)));
    unseen.truncate(UNSEEN);
    unseen.sort();
    let mut taken = HashSet::new();
    let mut named = |triangles: Vec<u32>, is_seen: bool| {
        let mesh = scene.meshes.iter().find(|mesh| triangles.first().is_some_and(|t| mesh.range.contains(t)));
        let name = mesh.map_or("lamp", |mesh| mesh.name.as_str());
        let name = free_name(name, |name| taken.insert(name.to_owned()));
        Candidate { name, triangles, is_seen }
    };
    let mut all: Vec<Candidate> = found.into_iter().map(|part| named(part, true)).collect();
    all.extend(unseen.into_iter().map(|part| named(part, false)));
    all
}

/// How many pixels show each triangle, over all targets.
pub(super) fn pixels(scene: &Scene, targets: &[Target]) -> Vec<u32> {
    seen(scene, targets).into_iter().map(|seen| seen.pixels).collect()
}

/// What the pixels of all targets show.
fn seen(scene: &Scene, targets: &[Target]) -> Vec<Seen> {
    let rays = scene.rays();
    targets.par_iter().map(|target| look(scene, &rays, target)).reduce(
        || vec![Seen::default(); scene.triangles.len()],
        |mut all, more| {
            for (to, more) in all.iter_mut().zip(more) {
                to.pixels += more.pixels;
                to.bright += more.bright;
                to.spot += more.spot;
            }
            all
        },
    )
}

/// What the pixels of a target show, by one ray each.
fn look(scene: &Scene, rays: &Rays, target: &Target) -> Vec<Seen> {
    let [limit, limit_of_spot] = match target.clip {
        Some(clip) => [clip; 2],
        None => [BRIGHT, BRIGHT_SPOT].map(|factor| factor * usual_brightness(target)),
    };
    let mut seen = vec![Seen::default(); scene.triangles.len()];
    for (at, triangle) in first_hits(rays, target) {
        let brightest = target.pixels[at].max_element();
        let is_clipped = target.is_bound(at, brightest);
        seen[triangle].pixels += 1;
        seen[triangle].bright += u32::from(is_clipped || brightest >= limit);
        seen[triangle].spot += u32::from(is_clipped || brightest >= limit_of_spot);
    }
    seen
}

/// The median of the brightest channels of the pixels that count.
fn usual_brightness(target: &Target) -> f64 {
    let counts = |(at, _): &(usize, &DVec3)| target.mask_at(*at) > 0.0;
    let pixels = target.pixels.iter().enumerate().filter(counts);
    median(pixels.map(|(_, pixel)| pixel.max_element()).collect()).unwrap_or(0.0)
}

/// Connected parts of some triangles, ascending, over edges of (nearly) the same corners.
fn parts(scene: &Scene, welded: &Welded, triangles: Vec<u32>) -> Vec<Vec<u32>> {
    let corners = |t: u32| welded.positions(scene.triangles[t as usize].vertices);
    let directed = triangles.iter().flat_map(|&t| sides(corners(t)).map(|side| (t, side)));
    // Disjoint sets; the root of each is its first triangle.
    let mut root: BTreeMap<u32, u32> = triangles.iter().map(|&t| (t, t)).collect();
    fn find(root: &mut BTreeMap<u32, u32>, t: u32) -> u32 {
        let mut at = t;
        while root[&at] != at {
            let next = root[&root[&at]];
            root.insert(at, next);
            at = next;
        }
        at
    }
    for edge in Edges::new(directed).iter() {
        let mut around = edge.triangles();
        let Some(first) = around.next() else { continue };
        for other in around {
            let (a, b) = (find(&mut root, first), find(&mut root, other));
            root.insert(a.max(b), a.min(b));
        }
    }
    let mut of_root: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for t in triangles {
        let first = find(&mut root, t);
        of_root.entry(first).or_default().push(t);
    }
    of_root.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_render::image::View;
    use antirad_scene::{Camera, Material, SceneBuilder, Shape};
    use glam::DAffine3;

    /// A floor, a lamp above it in view, and a box behind the camera.
    fn scene() -> Scene {
        let mut builder = SceneBuilder::new();
        let grey = Material::named("grey");
        builder.shape("floor", Shape::Quad { cells: 4 }, &grey, DAffine3::from_scale(DVec3::splat(4.0)));
        let lamp = DAffine3::from_translation(DVec3::Y) * DAffine3::from_scale(DVec3::splat(0.5));
        builder.shape("panel", Shape::Quad { cells: 2 }, &grey, lamp);
        builder.shape("behind", Shape::Quad { cells: 1 }, &grey, DAffine3::from_translation(DVec3::Y * 20.0));
        builder.finish("s").expect("a scene")
    }

    fn camera() -> Camera {
        let (position, up) = (DVec3::new(0.0, 6.0, 0.0), DVec3::Z);
        Camera { position, target: DVec3::ZERO, up, width: 48, height: 48, ..Camera::framing(&[]) }
    }

    fn target(scene: &Scene, lamp: f64, clip: Option<f64>) -> Target {
        let camera = camera();
        let (rays, view) = (scene.rays(), View::new(&camera));
        let panel = scene.meshes[1].range.clone();
        let pixel = |at: usize| {
            let ray = view.ray((at % 48) as f64 + 0.5, (at / 48) as f64 + 0.5);
            let hit = rays.nearest(camera.position, ray, None);
            let value = if hit.is_some_and(|(t, _)| panel.contains(&(t as u32))) { lamp } else { 0.1 };
            DVec3::splat(clip.map_or(value, |clip| value.min(clip)))
        };
        let target =
            Target::new(camera.clone(), (0..48 * 48).map(pixel).collect(), None, 1.0).expect("a target");
        Target { clip, ..target }
    }

    #[test]
    fn what_is_bright_or_never_seen_may_be_a_lamp() {
        let scene = scene();
        for (lamp, clip) in [(5.0, None), (5.0, Some(1.0))] {
            let found = candidates(&scene, &[target(&scene, lamp, clip)]);
            let names: Vec<(&str, bool)> = found.iter().map(|c| (c.name.as_str(), c.is_seen)).collect();
            assert_eq!(names, [("panel", true), ("behind", false)]);
            assert_eq!(found[0].triangles, scene.meshes[1].range.clone().collect::<Vec<_>>());
        }
        // No brighter than its surroundings.
        let found = candidates(&scene, &[target(&scene, 0.2, None)]);
        assert_eq!(found.len(), 1);
        assert!(!found[0].is_seen);
    }
}
