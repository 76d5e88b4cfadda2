//! Albedo textures that are fitted: their texels are unknowns.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine2, DVec2, DVec3};

use super::atlas::{Crowded, NO_CHART};
use super::geometry::Maps;
use super::texture::{Map, Texture, weights};
use super::{Patterns, Scene};

/// Samples along a side of a triangle for its mean, at least and at most.
const SAMPLES: [f64; 2] = [2.0, 32.0];

/// An albedo texture over some triangles of a scene, by their texture coordinates, whose texels may change.
///
/// Texture coordinates (0, 0) are the upper left corner, and the texture repeats. Between the centres of texels it is linear.
#[derive(Clone, Debug)]
pub struct Painting {
    size: [u32; 2],
    maps: u32,
    triangles: Vec<u32>,
    /// Per triangle, the weights of texels in its mean.
    means: Vec<Vec<(u32, f64)>>,
    /// Of an atlas, the chart of each texel; empty where texture coordinates were given.
    chart_of: Vec<u32>,
}

impl Scene {
    /// Gives triangles a texture of their own, which starts with their albedo, one value each. Each must have a material that no
    /// other shares ([`Self::split_materials`]).
    ///
    /// Triangles some of which have no texture coordinates get others, all of them: those of an atlas, whose charts share no texel.
    ///
    /// # Errors
    /// Fails if the atlas has more charts than the texture has room for.
    #[doc(hidden)]
    pub fn paint(&mut self, triangles: &[u32], size: [u32; 2]) -> Result<(Painting, Vec<DVec3>), Crowded> {
        let given = triangles.iter().map(|&t| self.patterns.uvs(t as usize)).collect::<Option<_>>();
        let (uvs, chart_of): (Vec<[DVec2; 3]>, Vec<u32>) = match given {
            Some(uvs) => (uvs, Vec::new()),
            None => {
                let atlas = self.atlas(triangles, size)?;
                (atlas.uvs, atlas.chart_of)
            }
        };
        let means: Vec<Vec<(u32, f64)>> = uvs.iter().map(|corners| mean_weights(size, *corners)).collect();
        let patterns = Arc::make_mut(&mut self.patterns);
        let maps = patterns.add_maps(Maps::default());
        for (&t, uvs) in triangles.iter().zip(uvs) {
            patterns.set_uvs(t as usize, uvs);
            patterns.set(t as usize, maps, uvs, [DVec3::ONE; 2]);
        }
        let painting = Painting { size, maps, triangles: triangles.to_vec(), means, chart_of };
        let texels = painting.texels_of(|t| self.material(t).albedo.into());
        self.set_painting(&painting, texels.clone());
        Ok((painting, texels))
    }

    /// Changes the texels of a painting, row by row from the top, and with them the albedo of its triangles, which is their mean.
    #[doc(hidden)]
    pub fn set_painting(&mut self, painting: &Painting, texels: Vec<DVec3>) {
        let patterns = Arc::make_mut(&mut self.patterns);
        for (&t, weights) in painting.triangles.iter().zip(&painting.means) {
            let mean: DVec3 = weights.iter().map(|&(texel, weight)| weight * texels[texel as usize]).sum();
            if let Some(uvs) = patterns.uvs(t as usize) {
                patterns.set(t as usize, painting.maps, uvs, [mean, DVec3::ONE]);
            }
            let material = self.triangles[t as usize].material;
            self.materials[material as usize].albedo = mean.into();
        }
        let texture = Arc::new(Texture::of_light(painting.size, texels));
        let albedo = Some(Map::repeated(texture, DAffine2::IDENTITY));
        patterns.set_maps(painting.maps, Maps { albedo, emission: None });
    }
}

impl Painting {
    /// Columns and rows of texels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The triangles that it covers.
    pub fn triangles(&self) -> &[u32] {
        &self.triangles
    }

    /// The weights of texels in the mean over each of the triangles.
    #[doc(hidden)]
    pub fn means(&self) -> &[Vec<(u32, f64)>] {
        &self.means
    }

    /// The same over the parts of its triangles. `triangle_of`: of each part, in the order of all.
    pub(super) fn over(&self, triangle_of: impl Iterator<Item = u32>) -> Self {
        let places: HashMap<u32, usize> = self.triangles.iter().copied().zip(0..).collect();
        let mean = |(part, triangle): (u32, u32)| Some((part, self.means[*places.get(&triangle)?].clone()));
        let (triangles, means) = (0..).zip(triangle_of).filter_map(mean).unzip();
        Self { triangles, means, chart_of: self.chart_of.clone(), ..*self }
    }

    /// Number of texels.
    pub fn texels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }

    /// Pairs of texels next to each other. In an atlas these are of the same chart: beyond its border lies another part of the surface, or
    /// nothing.
    #[doc(hidden)]
    pub fn neighbours(&self) -> Vec<[u32; 2]> {
        let [columns, rows] = self.size;
        let is_one_surface =
            |&[a, b]: &[u32; 2]| match (self.chart_of.get(a as usize), self.chart_of.get(b as usize)) {
                (Some(a), Some(b)) => a == b && *a != NO_CHART,
                _ => true,
            };
        let of = |texel: u32| {
            let right = (texel % columns + 1 < columns).then(|| [texel, texel + 1]);
            let below = (texel / columns + 1 < rows).then(|| [texel, texel + columns]);
            right.into_iter().chain(below)
        };
        (0..columns * rows).flat_map(of).filter(is_one_surface).collect()
    }

    /// Texels that have the albedo of the triangles which they cover.
    #[doc(hidden)]
    pub fn texels_of(&self, albedo: impl Fn(usize) -> DVec3) -> Vec<DVec3> {
        let mut sums = vec![(DVec3::ZERO, 0.0); self.texels()];
        for (&t, weights) in self.triangles.iter().zip(&self.means) {
            let albedo = albedo(t as usize);
            for &(texel, weight) in weights {
                let (sum, all) = &mut sums[texel as usize];
                *sum += weight * albedo;
                *all += weight;
            }
        }
        sums.into_iter().map(|(sum, all)| if all > 0.0 { sum / all } else { DVec3::ZERO }).collect()
    }

    /// Whether it covers a triangle of a scene with these patterns.
    #[doc(hidden)]
    pub fn covers(&self, patterns: &Patterns, triangle: usize) -> bool {
        patterns.place(triangle, DVec3::ZERO).is_some_and(|(maps, _)| maps == self.maps)
    }

    /// The weights of the texels around a point of a triangle that it covers, by barycentric coordinates, in the albedo there.
    #[doc(hidden)]
    pub fn weights(&self, patterns: &Patterns, triangle: usize, barycentric: DVec3) -> [(u32, f64); 4] {
        let uv = patterns.place(triangle, barycentric).map_or(DVec2::ZERO, |(_, uv)| uv);
        weights(self.size, uv)
    }

    /// Derivatives by texels, from those by the albedo of triangles, which is a mean of texels.
    #[doc(hidden)]
    pub fn pull_back(&self, by_triangle: impl Fn(usize) -> DVec3, by_texels: &mut [DVec3]) {
        for (&t, weights) in self.triangles.iter().zip(&self.means) {
            let by = by_triangle(t as usize);
            weights.iter().for_each(|&(texel, weight)| by_texels[texel as usize] += weight * by);
        }
    }
}

/// The weights of texels in the mean over a triangle: at the centroids of equal parts, about as many as it has texels.
fn mean_weights(size: [u32; 2], [a, b, c]: [DVec2; 3]) -> Vec<(u32, f64)> {
    let scale = DVec2::new(f64::from(size[0]), f64::from(size[1]));
    let texels = ((b - a) * scale).perp_dot((c - a) * scale).abs() / 2.0;
    let n = (4.0 * texels).sqrt().ceil().clamp(SAMPLES[0], SAMPLES[1]) as u32;
    let step = 1.0 / (3.0 * f64::from(n));
    let mut all = Vec::new();
    let mut add = |u: f64, v: f64| all.extend(weights(size, a + (b - a) * u + (c - a) * v));
    for i in 0..n {
        for j in 0..n - i {
            let (u, v) = (f64::from(3 * i + 1) * step, f64::from(3 * j + 1) * step);
            add(u, v);
            if i + j + 1 < n {
                // The part that points the other way.
                add(u + step, v + step);
            }
        }
    }
    all.sort_unstable_by_key(|&(texel, _)| texel);
    let share = f64::from(n * n).recip();
    let mut merged: Vec<(u32, f64)> = Vec::new();
    for (texel, weight) in all {
        match merged.last_mut() {
            Some((last, sum)) if *last == texel => *sum += share * weight,
            _ => merged.push((texel, share * weight)),
        }
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::super::{Material, Triangle};
    use super::*;

    fn square() -> Scene {
        let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
        let triangles = [[0, 1, 2], [0, 2, 3]].into_iter().zip(0..);
        let triangles = triangles.map(|(vertices, material)| Triangle { vertices, material }).collect();
        let materials =
            vec![Material::named("a"), Material { albedo: [0.2, 0.4, 0.6], ..Material::named("b") }];
        Scene::new("s", vertices, triangles, materials).expect("a scene")
    }

    #[test]
    fn means_and_points_are_those_of_texels() {
        let mut scene = square();
        let uvs = |t: [u32; 3]| t.map(|v| scene.vertices[v as usize].truncate() * 0.9 + 0.05);
        let uvs = [uvs([0, 1, 2]), uvs([0, 2, 3])];
        Arc::make_mut(&mut scene.patterns).extend_uvs(0, &uvs);
        let (painting, start) = scene.paint(&[0, 1], [8, 4]).expect("painted");
        assert!(start.iter().all(|texel| texel.is_finite()));
        let texels: Vec<DVec3> =
            (0..32).map(|k| DVec3::new(0.5 + 0.4 * (2.3 * f64::from(k)).sin(), 0.3, 0.9)).collect();
        scene.set_painting(&painting, texels.clone());
        for t in 0..2 {
            let (mut sum, n) = (DVec3::ZERO, 200);
            for i in 0..n {
                for j in 0..n - i {
                    let (u, v) = ((f64::from(i) + 1.0 / 3.0) / 200.0, (f64::from(j) + 1.0 / 3.0) / 200.0);
                    let b = DVec3::new(1.0 - u - v, u, v);
                    let at = scene.patterns.at(t, b).expect("a pattern").value[0];
                    let value = at * DVec3::from(scene.material(t).albedo);
                    let weights = painting.weights(&scene.patterns, t, b).to_vec();
                    let expected: DVec3 = weights.iter().map(|&(k, w)| w * texels[k as usize]).sum();
                    assert!(value.abs_diff_eq(expected, 1e-12), "{value} {expected}");
                    sum += value;
                }
            }
            let mean = sum / f64::from(n * (n + 1) / 2);
            assert!(mean.abs_diff_eq(DVec3::from(scene.material(t).albedo), 0.01), "{mean}");
        }
    }

    /// Two squares that look the same way, apart from each other: no texel of one is next to one of the other.
    #[test]
    fn without_texture_coordinates_there_is_an_atlas() {
        let mut scene = square();
        let beyond: Vec<DVec3> = scene.vertices.iter().map(|v| *v + DVec3::Z).collect();
        scene.vertices.extend(beyond);
        let copies = scene.triangles.clone().into_iter().map(|t| t.vertices.map(|v| v + 4));
        scene.triangles.extend(copies.zip(2..).map(|(vertices, material)| Triangle { vertices, material }));
        scene
            .materials
            .extend([0.3, 0.9].map(|albedo| Material { albedo: [albedo; 3], ..Material::named("c") }));
        scene.meshes[0].range.end = 4;
        let (painting, start) = scene.paint(&[0, 1, 2, 3], [32, 16]).expect("painted");
        for t in 0..4 {
            let expected = [0.0, 0.2, 0.3, 0.9][t];
            // Texels along the diagonal belong to both triangles.
            let found = scene.material(t).albedo[0];
            assert!((found - expected).abs() <= 0.1, "{t}: {found}, not {expected}");
        }
        assert!(start.iter().all(|texel| texel.is_finite()));
        let mut reached: Vec<bool> = vec![false; painting.texels()];
        for &(texel, _) in painting.means()[..2].iter().flatten() {
            reached[texel as usize] = true;
        }
        for _ in 0..64 {
            for [a, b] in painting.neighbours() {
                let either = reached[a as usize] || reached[b as usize];
                (reached[a as usize], reached[b as usize]) = (either, either);
            }
        }
        let of_other = painting.means()[2..].iter().flatten();
        assert!(of_other.filter(|(_, weight)| *weight > 0.0).all(|(texel, _)| !reached[*texel as usize]));
    }

    #[test]
    fn textures_are_written_and_read() {
        let mut scene = square();
        let uvs = [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|v: usize| scene.vertices[v].truncate() * 0.9 + 0.05));
        Arc::make_mut(&mut scene.patterns).extend_uvs(0, &uvs);
        let (painting, _) = scene.paint(&[0, 1], [8, 4]).expect("painted");
        let texels = (0..32).map(|k| DVec3::new(0.5 + 0.4 * (2.3 * f64::from(k)).sin(), 0.3, 0.9)).collect();
        scene.set_painting(&painting, texels);
        let folder = tempfile::tempdir().expect("a folder");
        scene.save(&folder.path().join("s.toml")).expect("written");
        let read = Scene::load(&folder.path().join("s.toml"), &crate::LoadOptions::default()).expect("read");
        for t in 0..2 {
            for b in [DVec3::new(0.2, 0.3, 0.5), DVec3::new(0.6, 0.1, 0.3), DVec3::splat(1.0 / 3.0)] {
                let albedo = |scene: &Scene| {
                    scene.patterns.at(t, b).expect("a pattern").value[0]
                        * DVec3::from(scene.material(t).albedo)
                };
                assert!(
                    albedo(&read).abs_diff_eq(albedo(&scene), 1e-4),
                    "{} {}",
                    albedo(&read),
                    albedo(&scene)
                );
            }
        }
    }
}
