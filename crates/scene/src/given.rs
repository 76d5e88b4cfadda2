//! Meshes as their files have them, of scenes in which they are simplified: values of a solve or a fit come back on these.

use antirad_base::parallel;
use glam::DVec3;
use std::collections::HashMap;
use std::sync::Arc;

use super::simplify::{NearestTriangle, beside};
use super::{Mesh, Scene, Triangle};

/// Meshes before they were simplified.
#[derive(Clone, Debug, Default)]
pub struct GivenMeshes {
    /// Positions, m.
    pub(super) vertices: Vec<DVec3>,
    /// The triangles of meshes, by the meshes' names.
    pub(super) meshes: HashMap<String, Vec<[u32; 3]>>,
}

impl Scene {
    /// The scene with the meshes that were simplified as their files have them, and of each of its triangles, the one of this scene from
    /// which it has its material and texture: the nearest of the same mesh. `None` if no mesh was simplified.
    ///
    /// Texture coordinates are those of that triangle, continued over its plane. Vertices of simplified meshes that this scene has moved are
    /// where the file has them.
    #[doc(hidden)]
    pub fn with_given_meshes(&self) -> Option<(Self, Vec<u32>)> {
        let given = self.given.as_ref()?;
        let first_vertex = self.vertices.len() as u32;
        let others = self.other_sides();
        let mut scene = Self { given: None, creases: Vec::new(), triangles: Vec::new(), ..self.clone() };
        scene.vertices.extend_from_slice(&given.vertices);
        // Of each triangle, its own and its corners there.
        let mut rows: Vec<(u32, [DVec3; 3])> = Vec::new();
        for (k, Mesh { name, range }) in self.meshes.iter().enumerate() {
            let first = scene.triangles.len() as u32;
            match given.meshes.get(name).filter(|_| !range.is_empty()) {
                None => {
                    rows.extend(range.clone().map(|t| (t, DVec3::AXES)));
                    scene
                        .triangles
                        .extend_from_slice(&self.triangles[range.start as usize..range.end as usize]);
                }
                Some(triangles) => {
                    let nearest =
                        NearestTriangle::new(range.clone().map(|t| self.corners(t as usize)).collect());
                    let place = |v: u32| given.vertices[v as usize];
                    let row = |corners: &[u32; 3]| {
                        let [a, b, c] = corners.map(place);
                        let found = nearest.find((a + b + c) / 3.0, (b - a).cross(c - a));
                        range.start + found.map_or(0, |(t, _)| t)
                    };
                    let found: Vec<u32> = parallel::map(triangles, row);
                    // Then second sides, as in this scene.
                    let turned = |(&[a, b, c], &t): (&[u32; 3], &u32)| {
                        let other = others[t as usize].filter(|other| range.contains(other))?;
                        (t < other).then_some(([a, c, b], other))
                    };
                    let seconds: Vec<_> = triangles.iter().zip(&found).filter_map(turned).collect();
                    for (corners, t) in triangles.iter().copied().zip(found).chain(seconds) {
                        let own = self.corners(t as usize);
                        rows.push((t, corners.map(|v| beside(own, place(v)))));
                        let vertices = corners.map(|v| first_vertex + v);
                        scene.triangles.push(Triangle { vertices, ..self.triangles[t as usize] });
                    }
                    scene.origins.iter_mut().skip(k).take(1).for_each(|origin| origin.lines.clear());
                }
            }
            scene.meshes[k].range = first..scene.triangles.len() as u32;
        }
        Arc::make_mut(&mut scene.patterns).rearrange(rows.iter().copied());
        scene.leave_out_vertices(|_| true);
        scene.update_degenerate();
        Some((scene, rows.into_iter().map(|(t, _)| t).collect()))
    }

    /// Leaves out those of some vertices that no triangle has.
    pub(super) fn leave_out_vertices(&mut self, some: impl Fn(u32) -> bool) {
        let mut stays: Vec<bool> = (0..self.vertices.len() as u32).map(|v| !some(v)).collect();
        self.triangles.iter().flat_map(|t| t.vertices).for_each(|v| stays[v as usize] = true);
        let mut next = 0;
        let number = |&stays: &bool| {
            next += u32::from(stays);
            next - u32::from(stays)
        };
        let numbers: Vec<u32> = stays.iter().map(number).collect();
        let mut stays = stays.into_iter();
        self.vertices.retain(|_| stays.next().unwrap_or(true));
        for triangle in &mut self.triangles {
            triangle.vertices = triangle.vertices.map(|v| numbers[v as usize]);
        }
    }
}
