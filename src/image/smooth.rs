//! Corner colours, for smooth pictures.

use glam::DVec3;
use rayon::prelude::*;

use super::ImageError;
use crate::scene::{Fans, Scene, Welded};

/// Cosine of the largest angle between faces of one smooth surface, 30°; larger ones are sharp edges.
const SAME_SURFACE: f64 = 0.866_025_403_784_438_6;

/// For each corner of each face, the area-weighted mean of the colours of the faces that meet there, have the same material, and
/// whose normals differ by at most 30°. Faces meet where corners have the same position, whatever the indices of their vertices.
pub fn corner_colours(scene: &Scene, colours: &[[f32; 3]]) -> Result<Vec<[[f32; 3]; 3]>, ImageError> {
    let (given, wanted) = (colours.len(), scene.triangles.len());
    if given != wanted {
        return Err(ImageError::Colours { given, wanted });
    }
    scene.check_geometry()?;
    let welded = Welded::exactly(scene.vertices.iter().copied());
    let around = Fans::of(welded.first.len(), scene.triangles.iter().map(|t| welded.positions(t.vertices)));
    let face = |number: usize| {
        let [a, b, c] = scene.corners(number);
        let twice_area = (b - a).cross(c - a);
        (twice_area.length(), twice_area.normalize_or_zero())
    };
    let faces: Vec<(f64, DVec3)> = (0..wanted).into_par_iter().map(face).collect();
    let corner_colour = |number: usize, vertex: u32| {
        let own = colours[number].map(f64::from);
        let mut sum = [0.0; 3];
        let mut weight = 0.0;
        for &other in around.around(welded.position[vertex as usize]) {
            let other = other as usize;
            let (area, normal) = faces[other];
            let same_material = scene.triangles[other].material == scene.triangles[number].material;
            // A sum of differences: faces of one colour keep it to the last bit.
            if same_material && normal.dot(faces[number].1) >= SAME_SURFACE {
                weight += area;
                for channel in 0..3 {
                    sum[channel] += area * (f64::from(colours[other][channel]) - own[channel]);
                }
            }
        }
        // Faces without area have no neighbours.
        let weight = if weight > 0.0 { weight } else { 1.0 };
        [0, 1, 2].map(|channel| (own[channel] + sum[channel] / weight) as f32)
    };
    let corners =
        |number: usize| scene.triangles[number].vertices.map(|vertex| corner_colour(number, vertex));
    Ok((0..wanted).into_par_iter().map(corners).collect())
}
