//! Fewer triangles for a mesh of much the same shape, since light needs none as small as those of a scan.
//!
//! The crate `meshopt` collapses edges, those first that move the surface, its texture coordinates and its colours least (quadrics of
//! Garland and Heckbert, SIGGRAPH 1997 and Visualization 1998), and keeps triangles regular: small where a surface curves, and of much the
//! same size on planes, over which light varies. Vertices that remain do not move. Open edges, borders of regions and seams of texture
//! coordinates stay where they are: only vertices along them go.

mod curved;
mod nearest;

use super::bounds;
use antirad_base::parallel;
use curved::curved;
use glam::{DVec2, DVec3};
use meshopt::{SimplifyOptions, SimplifyVertex, simplify_with_attributes_and_locks_decoder};
use nearest::Nearest;
use std::collections::HashMap;

pub(super) use nearest::{Nearest as NearestTriangle, beside};

/// Texture coordinates and colours.
const ATTRIBUTES: usize = 5;
/// Of the mesh's size: the shift that counts as much as a colour that is off by 1.
const COLOUR: f64 = 0.01;
/// Of the mesh's size: no error is too large, the number of triangles decides.
const LARGEST: f32 = 1.0;

/// What a corner of a triangle has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub place: DVec3,
    /// Texture coordinates, NaN where there are none.
    pub uv: DVec2,
    pub colour: DVec3,
}

/// The corners of the triangles that remain, each by a triangle of those given and the number of its corner there. They are at most `most`,
/// unless borders prevent that. All three corners are of triangles of one region, and in the order in which the triangles of this region
/// came.
pub(super) fn simplified(triangles: &[[Corner; 3]], regions: &[u32], most: usize) -> Vec<[(u32, usize); 3]> {
    let (low, high) = bounds(triangles.iter().flatten().map(|corner| corner.place));
    let size = (high - low).max_element();
    let mut known = HashMap::new();
    // Of each vertex, a corner.
    let mut corners: Vec<(u32, usize)> = Vec::new();
    let mut indices = Vec::with_capacity(3 * triangles.len());
    for ((t, own), region) in (0..).zip(triangles).zip(regions) {
        let places = own.map(|corner| bits(corner.place));
        if places[0] == places[1] || places[1] == places[2] || places[2] == places[0] {
            continue;
        }
        for (k, corner) in own.iter().enumerate() {
            let values = (corner.uv.to_array().map(f64::to_bits), corner.colour.to_array().map(f64::to_bits));
            indices.push(*known.entry((places[k], region, values)).or_insert_with(|| {
                corners.push((t, k));
                corners.len() as u32 - 1
            }));
        }
    }
    if indices.is_empty() {
        return Vec::new();
    }
    let of = |&(t, k): &(u32, usize)| &triangles[t as usize][k];
    let centre = 0.5 * (low + high);
    let places: Vec<DVec3> = corners.iter().map(|corner| of(corner).place).collect();
    let positions: Vec<[f32; 3]> =
        places.iter().map(|place| ((place - centre) / size).as_vec3().to_array()).collect();
    let finite = |x: f64| if x.is_finite() { x as f32 } else { 0.0 };
    let attributes: Vec<f32> = corners
        .iter()
        .flat_map(|corner| {
            let Corner { uv, colour, .. } = of(corner);
            [uv.x, uv.y, colour.x, colour.y, colour.z].map(finite)
        })
        .collect();
    // A texture that is off by a distance counts as much as a surface that is.
    let along = (stretch(triangles) / size) as f32;
    let weights: [f32; ATTRIBUTES] = [along, along, COLOUR as f32, COLOUR as f32, COLOUR as f32];
    let stays = |curved: bool| if curved { SimplifyVertex::Priority } else { SimplifyVertex::empty() };
    let rather: Vec<SimplifyVertex> = curved(&places, indices.as_chunks().0).into_iter().map(stays).collect();
    let left = simplify_with_attributes_and_locks_decoder(
        &indices,
        &positions,
        &attributes,
        &weights,
        size_of::<[f32; ATTRIBUTES]>(),
        &rather,
        (3 * most).min(indices.len()),
        LARGEST,
        SimplifyOptions::RegularizeLight,
        None,
    );
    left.as_chunks().0.iter().map(|face: &[u32; 3]| face.map(|vertex| corners[vertex as usize])).collect()
}

fn bits(place: DVec3) -> [u64; 3] {
    // Adding zero turns -0 into +0.
    (place + DVec3::ZERO).to_array().map(f64::to_bits)
}

/// Metres per unit of texture coordinates, in the mean over the area that has some; 0 without any.
fn stretch(triangles: &[[Corner; 3]]) -> f64 {
    let areas = |[a, b, c]: &[Corner; 3]| {
        let flat = (b.uv - a.uv).perp_dot(c.uv - a.uv).abs();
        let area = (b.place - a.place).cross(c.place - a.place).length();
        if flat.is_finite() { [area, flat] } else { [0.0; 2] }
    };
    let [area, flat] = triangles.iter().map(areas).fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
    if flat > 0.0 { (area / flat).sqrt() } else { 0.0 }
}

/// How far the middles of some triangles are from a surface, m: root mean square by area, and at most.
pub(super) fn apart(given: &[[DVec3; 3]], surface: Vec<[DVec3; 3]>) -> [f64; 2] {
    let surface = Nearest::new(surface);
    let of = |&[a, b, c]: &[DVec3; 3]| {
        let normal = (b - a).cross(c - a);
        let (_, distance) = surface.find((a + b + c) / 3.0, normal).unwrap_or_default();
        (normal.length(), distance)
    };
    let found: Vec<(f64, f64)> = parallel::map(given, of);
    let all: f64 = found.iter().map(|(area, _)| area).sum();
    let squares: f64 = found.iter().map(|(area, distance)| area * distance * distance).sum();
    let farthest = found.iter().map(|(_, distance)| *distance).fold(0.0, f64::max);
    [(squares / all.max(f64::MIN_POSITIVE)).sqrt(), farthest]
}

#[cfg(test)]
mod tests;
