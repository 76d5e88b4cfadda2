//! Albedo textures of meshes as values that pictures depend on.

use crate::arrays::{self, Numbers};
use crate::errors::invalid;
use antirad::glam::DVec3;
use antirad::render::SceneGradient;
use antirad::scene::{self, Painting};
use pyo3::prelude::*;
use std::ops::Range;

/// Name of a mesh, rows and columns of its texture.
pub type Size = (String, u32, u32);

/// Textures over some meshes of a scene.
pub struct Textures {
    /// The scene with the textures, in which each of their triangles has a material of its own.
    scene: scene::Scene,
    /// Per material of it, the index of the given scene's material that it is part of.
    part_of: Vec<u32>,
    paintings: Vec<Painting>,
    /// The meshes, in the same order.
    meshes: Vec<scene::Mesh>,
}

impl Textures {
    pub fn new(given: &scene::Scene, sizes: &[Size]) -> PyResult<Self> {
        let mut meshes: Vec<scene::Mesh> = Vec::new();
        for (name, rows, columns) in sizes {
            let Some(mesh) = given.meshes.iter().find(|mesh| mesh.name == *name) else {
                let names: Vec<&str> = given.meshes.iter().map(|mesh| mesh.name.as_str()).collect();
                return Err(invalid(format!(
                    "there is no mesh {name:?}; the scene has {}",
                    names.join(", ")
                )));
            };
            if *columns == 0 || *rows == 0 || mesh.range.is_empty() {
                return Err(invalid(format!(
                    "the texture of mesh {name:?} has no texels, or the mesh no triangles"
                )));
            }
            meshes.push(mesh.clone());
        }
        let mut scene = given.clone();
        if !meshes.is_empty() {
            let own = |t: u32| meshes.iter().any(|mesh| mesh.range.contains(&t));
            let label = |t: u32| if own(t) { 1 + u64::from(t) } else { 0 };
            let labels: Vec<u64> = (0..given.triangles.len() as u32).map(label).collect();
            scene.split_materials(&labels);
        }
        let mut part_of = vec![0; scene.materials.len()];
        for (part, whole) in scene.triangles.iter().zip(&given.triangles) {
            part_of[part.material as usize] = whole.material;
        }
        let mut paintings = Vec::new();
        for (mesh, (name, rows, columns)) in meshes.iter().zip(sizes) {
            let triangles: Vec<u32> = mesh.range.clone().collect();
            let (painting, _) = scene.paint(&triangles, [*columns, *rows]).map_err(|crowded| {
                invalid(format!("mesh {name:?} has no texture coordinates, and {crowded}"))
            })?;
            paintings.push(painting);
        }
        Ok(Self { scene, part_of, paintings, meshes })
    }

    /// The scene with textures, to plan for.
    pub fn scene(&self) -> &scene::Scene {
        &self.scene
    }

    pub fn paintings(&self) -> Vec<Painting> {
        self.paintings.clone()
    }

    /// Columns of each texture.
    pub fn columns(&self) -> Vec<u32> {
        self.paintings.iter().map(|painting| painting.size()[0]).collect()
    }

    /// A scene with the materials, vertices and cameras of a changed one, and with texels (rows, columns, 3) for each texture.
    pub fn applied(&self, changed: scene::Scene, texels: &[Numbers]) -> PyResult<scene::Scene> {
        if texels.len() != self.paintings.len() {
            let (given, wanted) = (texels.len(), self.paintings.len());
            return Err(invalid(format!(
                "textures has {given} arrays; it must have {wanted}, one for each mesh"
            )));
        }
        if self.paintings.is_empty() {
            return Ok(changed);
        }
        let mut scene = self.scene.clone();
        for (part, whole) in scene.materials.iter_mut().zip(&self.part_of) {
            let name = std::mem::take(&mut part.name);
            *part = scene::Material { name, ..changed.materials[*whole as usize].clone() };
        }
        for ((painting, mesh), numbers) in self.paintings.iter().zip(&self.meshes).zip(texels) {
            let [columns, rows] = painting.size();
            let texels = arrays::pixels(&format!("texture of {:?}", mesh.name), numbers, columns, rows)?;
            let is_albedo = |texel: &DVec3| texel.to_array().iter().all(|value| (0.0..1.0).contains(value));
            if let Some(at) = texels.iter().position(|texel| !is_albedo(texel)) {
                let (row, column) = (at / columns as usize, at % columns as usize);
                return Err(invalid(format!(
                    "the texture of mesh {:?} is {} in row {row}, column {column}; an albedo must be 0 or more and below 1",
                    mesh.name, texels[at]
                )));
            }
            scene.set_painting(painting, texels);
        }
        let scene::Scene { vertices, cameras, degenerate, .. } = changed;
        Ok(scene::Scene { vertices, cameras, degenerate, ..scene })
    }

    /// Derivatives by the materials of the given scene, and by texels in place of the albedo of what they cover.
    pub fn pull_back(&self, given: &scene::Scene, mut by_triangle: SceneGradient) -> SceneGradient {
        if let Some(albedo) = &mut by_triangle.albedo {
            let covered =
                |mesh: &scene::Mesh| -> Range<usize> { mesh.range.start as usize..mesh.range.end as usize };
            self.meshes.iter().for_each(|mesh| albedo[covered(mesh)].fill(DVec3::ZERO));
        }
        by_triangle.by_material(given)
    }
}
