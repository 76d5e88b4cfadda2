//! Cuts triangles over which a texture varies, so that light transport sees it.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use glam::DVec3;

use super::Scene;
use super::material::numbered;
use super::pattern::Pattern;

/// What [`Scene::refine_textures`] did.
#[derive(Clone, Debug)]
pub struct TextureRefined {
    /// Per new triangle, the index of the old triangle that it is a part of.
    pub parents: Vec<u32>,
    /// Number of rounds of cutting.
    pub rounds: u32,
    /// Whether `max_triangles` prevented further cuts.
    pub full: bool,
}

impl Scene {
    /// Cuts triangles into four, as [`Scene::split`] does, where the mean of albedo or emission over one of sixteen equal parts
    /// differs from the triangle's by more than `tolerance`: of albedo absolutely, of emission as a share of the scene's brightest. The
    /// most uneven ones first, until none is left, `max_triangles` would be exceeded, or `levels` rounds are done. Each part gets a
    /// material with its own means. A texture too fine for sixteen parts to differ is left as it is.
    #[doc(hidden)]
    pub fn refine_textures(&mut self, tolerance: f64, max_triangles: usize, levels: u32) -> TextureRefined {
        let mut refined =
            TextureRefined { parents: (0..self.triangles.len() as u32).collect(), rounds: 0, full: false };
        while refined.rounds < levels {
            let brightest = self.materials.iter().flat_map(|m| m.emission).fold(0.0, f64::max);
            let mut uneven: Vec<(f64, u32)> = (0..self.triangles.len())
                .map(|t| (self.unevenness(t, brightest), t as u32))
                .filter(|(unevenness, _)| *unevenness > tolerance)
                .collect();
            uneven.sort_by(|(a, i), (b, j)| b.total_cmp(a).then(i.cmp(j)));
            let room = max_triangles.saturating_sub(self.triangles.len()) / 3;
            refined.full = uneven.len() > room;
            uneven.truncate(room);
            if uneven.is_empty() {
                break;
            }
            let mut chosen: Vec<u32> = uneven.into_iter().map(|(_, t)| t).collect();
            chosen.sort_unstable();
            let parents = self.split(&chosen);
            let cut: HashSet<u32> = chosen.into_iter().collect();
            self.take_means(|t| cut.contains(&parents[t]));
            refined.parents = parents.into_iter().map(|parent| refined.parents[parent as usize]).collect();
            refined.rounds += 1;
        }
        refined
    }

    /// The largest difference between the means over a sixteenth of a triangle and over all of it.
    fn unevenness(&self, triangle: usize, brightest: f64) -> f64 {
        let Some((pattern, maps)) = self.patterns.get(triangle) else { return 0.0 };
        let material = self.material(triangle);
        let parts = pattern.quarters().into_iter().flat_map(|quarter| quarter.quarters());
        let weights = [
            DVec3::from(material.diffuse_albedo()),
            DVec3::from(material.emission) / brightest.max(f64::MIN_POSITIVE),
        ];
        let difference = |part: Pattern| {
            let factors = part.own_means(maps);
            let of = |k: usize| (weights[k] * (pattern.ratio(k, factors[k]) - 1.0)).abs().max_element();
            of(0).max(of(1))
        };
        parts.map(difference).fold(0.0, f64::max)
    }

    /// Gives triangles materials with the means of their own patterns.
    fn take_means(&mut self, of: impl Fn(usize) -> bool) {
        let mut names: HashSet<String> = self.materials.iter().map(|m| m.name.clone()).collect();
        let mut copies: HashMap<(u32, [[u64; 3]; 2]), u32> = HashMap::new();
        let mut counts: HashMap<u32, u64> = HashMap::new();
        let patterns = Arc::make_mut(&mut self.patterns);
        for (t, triangle) in self.triangles.iter_mut().enumerate().filter(|(t, _)| of(*t)) {
            let Some(factors) = patterns.take_means(t) else { continue };
            let base = triangle.material;
            let key = (base, factors.map(|ratio| ratio.to_array().map(f64::to_bits)));
            triangle.material = *copies.entry(key).or_insert_with(|| {
                let material = &self.materials[base as usize];
                let count = counts.entry(base).or_insert(0);
                let name = numbered(&material.name, count, |name| names.contains(name));
                names.insert(name.clone());
                let copy = material.scaled(name, factors);
                self.materials.push(copy);
                self.materials.len() as u32 - 1
            });
        }
    }
}
