//! Colours of corners, for pictures that do not show the triangles.

use std::collections::HashMap;

use glam::DVec3;
use rayon::prelude::*;

use super::ImageError;
use crate::scene::Scene;

/// Cosine of the largest angle between faces that one surface has; more is an edge, which stays sharp: 30°.
const SAME_SURFACE: f64 = 0.866_025_403_784_438_6;

/// For each corner of each face, the mean of the colours around it, weighted by area: over the faces that meet there,
/// have the same material, and are turned by at most 30°. Faces meet where corners have the same position, whatever
/// the indices of their vertices.
pub fn corner_colours(scene: &Scene, colours: &[[f32; 3]]) -> Result<Vec<[[f32; 3]; 3]>, ImageError> {
    let (given, wanted) = (colours.len(), scene.triangles.len());
    if given != wanted {
        return Err(ImageError::Colours { given, wanted });
    }
    scene.check_geometry()?;
    let around = FacesAround::new(scene);
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
        for &other in around.vertex(vertex) {
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

/// The faces that meet at each position.
struct FacesAround {
    /// Of each vertex: the number of its position.
    position: Vec<u32>,
    /// Position p has `faces[start[p]..start[p + 1]]`.
    start: Vec<usize>,
    faces: Vec<u32>,
}

impl FacesAround {
    fn new(scene: &Scene) -> Self {
        let mut positions = HashMap::new();
        let position: Vec<u32> = scene
            .vertices
            .iter()
            .map(|vertex| {
                // Adding zero makes both zeros the same.
                let key = (*vertex + DVec3::ZERO).to_array().map(f64::to_bits);
                let next = positions.len() as u32;
                *positions.entry(key).or_insert(next)
            })
            .collect();
        let corners = || {
            (0u32..).zip(&scene.triangles).flat_map(|(number, triangle)| {
                triangle.vertices.map(|vertex| (position[vertex as usize] as usize, number))
            })
        };
        let mut start = vec![0; positions.len() + 1];
        for (place, _) in corners() {
            start[place + 1] += 1;
        }
        for place in 1..start.len() {
            start[place] += start[place - 1];
        }
        let mut end = start.clone();
        let mut faces = vec![0; 3 * scene.triangles.len()];
        for (place, number) in corners() {
            faces[end[place]] = number;
            end[place] += 1;
        }
        Self { position, start, faces }
    }

    fn vertex(&self, vertex: u32) -> &[u32] {
        let position = self.position[vertex as usize] as usize;
        &self.faces[self.start[position]..self.start[position + 1]]
    }
}
