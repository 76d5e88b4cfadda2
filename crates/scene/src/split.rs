//! Splits materials, so that parts of a scene that share one can change separately.

use std::collections::{HashMap, HashSet};

use super::{Material, Scene};

impl Scene {
    /// Gives triangles that share a material but differ in label separate copies of it.
    ///
    /// `labels`: one per triangle, in the scene's order; triangles beyond its end have none. A material whose triangles all
    /// have one label keeps its name; the others become `NAME.1`, `NAME.2` …, in order of appearance, in place of the old
    /// one. The appearance of triangles does not change.
    #[doc(hidden)]
    pub fn split_materials(&mut self, labels: &[u64]) {
        // Per material, its labels in order of appearance.
        let mut parts: Vec<Vec<u64>> = vec![Vec::new(); self.materials.len()];
        let mut part_of: HashMap<(u32, u64), usize> = HashMap::new();
        let label = |triangle: usize| labels.get(triangle).copied().unwrap_or(0);
        for (at, triangle) in self.triangles.iter().enumerate() {
            let own = &mut parts[triangle.material as usize];
            part_of.entry((triangle.material, label(at))).or_insert_with(|| {
                own.push(label(at));
                own.len() - 1
            });
        }
        let mut taken: HashSet<String> = self.materials.iter().map(|m| m.name.clone()).collect();
        let mut first = Vec::with_capacity(parts.len());
        let mut materials = Vec::with_capacity(part_of.len());
        for (material, parts) in self.materials.drain(..).zip(&parts) {
            first.push(materials.len());
            if parts.len() < 2 {
                materials.push(material);
                continue;
            }
            let mut number = 0u64;
            for _ in parts {
                let name = loop {
                    number += 1;
                    let name = format!("{}.{number}", material.name);
                    if taken.insert(name.clone()) {
                        break name;
                    }
                };
                materials.push(Material { name, ..material.clone() });
            }
        }
        self.materials = materials;
        for (at, triangle) in self.triangles.iter_mut().enumerate() {
            let part = part_of.get(&(triangle.material, label(at))).copied().unwrap_or(0);
            triangle.material = (first[triangle.material as usize] + part) as u32;
        }
    }

    /// A copy of the scene with an emission per triangle, RGB, W/(m² sr), in the scene's order; triangles
    /// beyond its end keep theirs. Each triangle then has a material of its own, with the old name.
    pub fn with_emission(&self, emission: &[[f64; 3]]) -> Self {
        let own = |i: usize| {
            let old = self.material(i);
            Material { emission: emission.get(i).copied().unwrap_or(old.emission), ..old.clone() }
        };
        let materials = (0..self.triangles.len()).map(own).collect();
        let mut changed = Self { materials, ..self.clone() };
        changed.triangles.iter_mut().zip(0..).for_each(|(triangle, own)| triangle.material = own);
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::super::Triangle;
    use super::*;
    use glam::DVec3;

    #[test]
    fn every_label_gets_a_material_of_its_own() {
        let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let triangles = [1, 1, 0, 1, 2].map(|material| Triangle { vertices: [0, 1, 2], material }).to_vec();
        let material = |name: &str, rho: f64| Material { albedo: [rho; 3], ..Material::named(name) };
        let materials = vec![
            material("red", 0.1),
            material("white", 0.2),
            material("white.1", 0.3),
            material("spare", 0.4),
        ];
        let mut scene = Scene::new("s", vertices, triangles, materials).expect("a scene");
        let before: Vec<_> = (0..5).map(|i| scene.material(i).albedo).collect();
        scene.split_materials(&[7, 9, 7, 7, 3]);
        let names = |scene: &Scene| (0..5).map(|i| scene.material(i).name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&scene), ["white.2", "white.3", "red", "white.2", "white.1"]);
        assert_eq!((0..5).map(|i| scene.material(i).albedo).collect::<Vec<_>>(), before);
        assert_eq!(scene.materials.last().map(|m| m.name.as_str()), Some("spare"));
        scene.split_materials(&[0, 1, 2, 3, 4]);
        assert_eq!(names(&scene), ["white.2.1", "white.3", "red", "white.2.2", "white.1"]);
        assert!(scene.check(true).is_ok());
    }

    #[test]
    fn emissions_by_triangle() {
        let triangles = [0, 0, 1].map(|material| Triangle { vertices: [0, 1, 2], material }).to_vec();
        let lamp = Material { emission: [3.0; 3], albedo: [0.5; 3], ..Material::named("lamp") };
        let scene = Scene::new(
            "s",
            vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            triangles,
            vec![Material::named("wall"), lamp],
        )
        .expect("a scene");
        let changed = scene.with_emission(&[[1.0; 3], [2.0; 3]]);
        assert_eq!([0, 1, 2].map(|i| changed.material(i).emission[0]), [1.0, 2.0, 3.0]);
        assert_eq!(changed.material(2), scene.material(2));
        assert_eq!(scene.material(0).emission, [0.0; 3]);
    }
}
