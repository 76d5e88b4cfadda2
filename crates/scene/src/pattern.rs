//! How albedo and emission vary within triangles: by textures, and by colours of corners.
//!
//! Light transport knows their means, which are the materials of triangles. Pictures show them point by point: as factors, so that
//! a material that changes takes its texture with it.

use std::sync::Arc;

use glam::{DVec2, DVec3};

use super::geometry::{Maps, quarters};
use super::texture::{Map, Texel, Texture};

/// Factors of albedo and emission within triangles, whose means over a triangle are 1. Empty where nothing is textured.
#[derive(Clone, Debug, Default)]
pub struct Patterns {
    maps: Vec<Maps>,
    /// Pattern of each triangle; `None` where it does not vary.
    of: Vec<Option<Pattern>>,
    /// Texture coordinates of the corners of each triangle, NaN where it has none; whether or not there is a texture.
    uvs: Vec<[DVec2; 3]>,
}

/// The pattern of one triangle.
#[derive(Clone, Debug)]
pub(super) struct Pattern {
    /// Index of its textures.
    maps: u32,
    /// Texture coordinates of the corners.
    uvs: [DVec2; 3],
    /// Factors of the albedo at the corners.
    colours: [DVec3; 3],
    /// Means of what multiplies albedo and emission.
    means: [DVec3; 2],
}

/// Factors of albedo and emission at a point, and their derivatives by its barycentric coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Factors {
    /// Factors of albedo and emission.
    pub value: [DVec3; 2],
    /// Their derivatives by the three barycentric coordinates.
    pub slope: [[DVec3; 3]; 2],
}

impl Pattern {
    /// The pattern of a face, and the means of what multiplies its albedo and emission. The pattern is `None`
    /// if both are constant over the face. `uvs` and `colours`: texture coordinates and colours of the
    /// corners, where it has some.
    pub fn new(
        maps: &Maps,
        index: u32,
        uvs: Option<[DVec2; 3]>,
        colours: Option<[DVec3; 3]>,
    ) -> (Option<Self>, [DVec3; 2]) {
        let colours = colours.unwrap_or([DVec3::ONE; 3]);
        let uvs = uvs.filter(|_| maps.albedo.is_some() || maps.emission.is_some());
        let means = Self::means(maps, uvs, colours);
        let mapped = uvs.is_some_and(|corners| corners.iter().all(|uv| uv.is_finite()));
        let varies = mapped || colours != [colours[0]; 3];
        let uvs = uvs.filter(|_| mapped).unwrap_or([DVec2::NAN; 3]);
        (varies.then_some(Self { maps: index, uvs, colours, means }), means)
    }

    fn means(maps: &Maps, uvs: Option<[DVec2; 3]>, colours: [DVec3; 3]) -> [DVec3; 2] {
        let mean = |map: &Option<Map>| match (map, uvs) {
            (Some(map), Some(uvs)) => map.mean_over(uvs),
            (Some(map), None) => map.texture.mean(),
            _ => DVec3::ONE,
        };
        let [a, b, c] = colours;
        [(a + b + c) / 3.0 * mean(&maps.albedo), mean(&maps.emission)]
    }

    /// The four parts of a triangle that is cut at the midpoints of its edges; they keep its means, as they keep its material.
    pub fn quarters(&self) -> [Self; 4] {
        quarters(DVec3::AXES, DVec3::midpoint).map(|corners| self.part(corners))
    }

    /// A part with such corners, in barycentric coordinates: it keeps the means, as it keeps the material.
    fn part(&self, corners: [DVec3; 3]) -> Self {
        if corners == DVec3::AXES {
            return self.clone();
        }
        let [[p, q, r], [a, b, c]] = [self.uvs.map(|uv| uv.extend(0.0)), self.colours];
        Self {
            uvs: corners.map(|at| (p * at.x + q * at.y + r * at.z).truncate()),
            colours: corners.map(|at| a * at.x + b * at.y + c * at.z),
            ..self.clone()
        }
    }

    /// The means of its own place, where it is part of a triangle that was cut.
    pub fn own_means(&self, maps: &Maps) -> [DVec3; 2] {
        Self::means(maps, Some(self.uvs), self.colours)
    }

    /// A factor of albedo (0) or emission (1) by the mean of it; 1 where a channel is black all over, and so has no pattern.
    pub fn ratio(&self, of: usize, factor: DVec3) -> DVec3 {
        DVec3::select(self.means[of].cmpgt(DVec3::ZERO), factor / self.means[of], DVec3::ONE)
    }

    fn at(&self, maps: &Maps, b: DVec3) -> Factors {
        let uv = self.uvs[0] * b.x + self.uvs[1] * b.y + self.uvs[2] * b.z;
        let texel = |map: &Option<Map>| match map {
            Some(map) if uv.is_finite() => map.at(uv),
            _ => Texel { value: DVec3::ONE, slope: [DVec3::ZERO; 2] },
        };
        let (albedo, emission) = (texel(&maps.albedo), texel(&maps.emission));
        let uvs = if uv.is_finite() { self.uvs } else { [DVec2::ZERO; 3] };
        let along = |texel: &Texel| uvs.map(|uv| texel.slope[0] * uv.x + texel.slope[1] * uv.y);
        let colour = self.colours[0] * b.x + self.colours[1] * b.y + self.colours[2] * b.z;
        let by_albedo = along(&albedo);
        let of_colours = [0, 1, 2].map(|k| by_albedo[k] * colour + albedo.value * self.colours[k]);
        let values = [albedo.value * colour, emission.value];
        let slopes = [of_colours, along(&emission)];
        let by_mean = |k: usize, by: DVec3| {
            DVec3::select(self.means[k].cmpgt(DVec3::ZERO), by / self.means[k], DVec3::ZERO)
        };
        Factors {
            value: [0, 1].map(|k| self.ratio(k, values[k])),
            slope: [0, 1].map(|k| slopes[k].map(|by| by_mean(k, by))),
        }
    }
}

impl Patterns {
    /// Whether no triangle has a pattern.
    #[doc(hidden)]
    pub fn is_empty(&self) -> bool {
        self.of.iter().all(Option::is_none)
    }

    /// Whether the textures that are fitted have the same texels as those of another state of the same scene.
    #[doc(hidden)]
    pub fn same_texels(&self, other: &Self) -> bool {
        let same = |(a, b): (&Maps, &Maps)| match (&a.albedo, &b.albedo) {
            (Some(a), Some(b)) => Arc::ptr_eq(&a.texture, &b.texture) || a.texture.same_light(&b.texture),
            (None, None) => true,
            _ => false,
        };
        self.maps.len() == other.maps.len() && self.maps.iter().zip(&other.maps).all(same)
    }

    /// The textures of albedo that are fitted, each with its index.
    pub(super) fn fitted(&self) -> Vec<(u32, Arc<Texture>)> {
        let albedo = |(index, maps): (u32, &Maps)| {
            maps.albedo.as_ref().filter(|map| map.texture.is_light()).map(|map| (index, map.texture.clone()))
        };
        (0..).zip(&self.maps).filter_map(albedo).collect()
    }

    /// The first index of a texture of albedo.
    pub(super) fn index_of(&self, texture: &Arc<Texture>) -> u32 {
        let is_it = |maps: &Maps| maps.albedo.as_ref().is_some_and(|map| Arc::ptr_eq(&map.texture, texture));
        self.maps.iter().position(is_it).unwrap_or_default() as u32
    }

    /// The texture of albedo with an index.
    pub(super) fn albedo_map(&self, index: u32) -> Option<&Texture> {
        Some(&self.maps.get(index as usize)?.albedo.as_ref()?.texture)
    }

    /// Adds textures that patterns refer to by the index returned.
    pub(super) fn add_maps(&mut self, maps: Maps) -> u32 {
        self.maps.push(maps);
        self.maps.len() as u32 - 1
    }

    /// Appends the patterns of triangles that follow the first `before`, which have none unless some were given.
    pub(super) fn extend(&mut self, before: usize, patterns: Vec<Option<Pattern>>) {
        self.of.resize(before, None);
        self.of.extend(patterns);
    }

    /// Gives triangles from the first on patterns.
    pub(super) fn put(&mut self, first: usize, patterns: Vec<Option<Pattern>>) {
        if patterns.iter().any(Option::is_some) {
            self.of.resize(self.of.len().max(first + patterns.len()), None);
            self.of[first..first + patterns.len()].clone_from_slice(&patterns);
        }
    }

    /// Appends the texture coordinates of triangles that follow the first `before`.
    pub(super) fn extend_uvs(&mut self, before: usize, uvs: &[[DVec2; 3]]) {
        self.uvs.resize(before, [DVec2::NAN; 3]);
        self.uvs.extend(uvs);
    }

    /// Gives a triangle texture coordinates.
    pub(super) fn set_uvs(&mut self, triangle: usize, uvs: [DVec2; 3]) {
        if self.uvs.len() <= triangle {
            self.uvs.resize(triangle + 1, [DVec2::NAN; 3]);
        }
        self.uvs[triangle] = uvs;
    }

    /// Whether there are neither patterns nor texture coordinates.
    pub(super) fn is_bare(&self) -> bool {
        self.of.is_empty() && self.uvs.is_empty()
    }

    /// The texture coordinates of a triangle's corners, if it has some.
    #[doc(hidden)]
    pub fn uvs(&self, triangle: usize) -> Option<[DVec2; 3]> {
        self.uvs.get(triangle).copied().filter(|uvs| uvs.iter().all(|uv| uv.is_finite()))
    }

    /// Gives a triangle a pattern by its texture coordinates, with such means.
    pub(super) fn set(&mut self, triangle: usize, maps: u32, uvs: [DVec2; 3], means: [DVec3; 2]) {
        if self.of.len() <= triangle {
            self.of.resize(triangle + 1, None);
        }
        self.of[triangle] = Some(Pattern { maps, uvs, colours: [DVec3::ONE; 3], means });
    }

    /// Replaces textures.
    pub(super) fn set_maps(&mut self, index: u32, maps: Maps) {
        if let Some(to) = self.maps.get_mut(index as usize) {
            *to = maps;
        }
    }

    /// The textures of a triangle, by their index, and the texture coordinates of its corners.
    pub(super) fn textured(&self, triangle: usize) -> Option<(u32, [DVec2; 3])> {
        let Pattern { maps, uvs, .. } = self.of.get(triangle)?.as_ref()?;
        Some((*maps, *uvs))
    }

    /// The textures of a triangle, by their index, and its texture coordinates at a point.
    pub(super) fn place(&self, triangle: usize, b: DVec3) -> Option<(u32, DVec2)> {
        let Pattern { maps, uvs, .. } = self.of.get(triangle)?.as_ref()?;
        Some((*maps, uvs[0] * b.x + uvs[1] * b.y + uvs[2] * b.z))
    }

    pub(super) fn get(&self, triangle: usize) -> Option<(&Pattern, &Maps)> {
        let pattern = self.of.get(triangle)?.as_ref()?;
        Some((pattern, self.maps.get(pattern.maps as usize)?))
    }

    /// The factors at a point of a triangle, by its barycentric coordinates.
    #[doc(hidden)]
    pub fn at(&self, triangle: usize, barycentric: DVec3) -> Option<Factors> {
        self.get(triangle).map(|(pattern, maps)| pattern.at(maps, barycentric))
    }

    /// Whether a triangle has a pattern.
    #[doc(hidden)]
    pub fn vary(&self, triangle: usize) -> bool {
        self.get(triangle).is_some()
    }

    /// Whether two triangles have the same texture, or none, along the edge that they share. `corners`: of both ends, the corner of each.
    #[doc(hidden)]
    pub fn continue_over_edge(&self, [a, b]: [usize; 2], corners: [[usize; 2]; 2]) -> bool {
        let same = |a: DVec2, b: DVec2| a == b || a.is_nan() && b.is_nan();
        match (self.get(a), self.get(b)) {
            (None, None) => true,
            (Some((a, _)), Some((b, _))) => {
                a.maps == b.maps
                    && corners.iter().all(|&[i, j]| same(a.uvs[i], b.uvs[j]) && a.colours[i] == b.colours[j])
            }
            _ => false,
        }
    }

    /// How many texels lie between two points of a triangle, by their barycentric coordinates, at most.
    #[doc(hidden)]
    pub fn texels_between(&self, triangle: usize, from: DVec3, to: DVec3) -> f64 {
        let Some((Pattern { uvs, .. }, maps)) = self.get(triangle) else { return 0.0 };
        let [from, to] = [from, to].map(|b| uvs[0] * b.x + uvs[1] * b.y + uvs[2] * b.z);
        let across = |map: &Option<Map>| map.as_ref().map_or(0.0, |map| map.texels_across([from, to, to]));
        across(&maps.albedo).max(across(&maps.emission))
    }

    /// Gives a triangle the means of its own place; returns their ratios to those before.
    pub(super) fn take_means(&mut self, triangle: usize) -> Option<[DVec3; 2]> {
        let pattern = self.of.get_mut(triangle)?.as_mut()?;
        let means = pattern.own_means(self.maps.get(pattern.maps as usize)?);
        let ratios = [0, 1].map(|k| pattern.ratio(k, means[k]));
        pattern.means = means;
        Some(ratios)
    }

    /// Turns a triangle: its last two corners change places.
    pub(super) fn turn(&mut self, triangle: usize) {
        if let Some(Some(pattern)) = self.of.get_mut(triangle) {
            pattern.uvs.swap(1, 2);
            pattern.colours.swap(1, 2);
        }
        if let Some(uvs) = self.uvs.get_mut(triangle) {
            uvs.swap(1, 2);
        }
    }

    /// Replaces triangles: each new one is a part of an old one, or all of it, by its corners in barycentric coordinates.
    pub(super) fn rearrange(&mut self, new: impl Iterator<Item = (u32, [DVec3; 3])>) {
        if self.is_bare() {
            return;
        }
        let part = |uvs: &[DVec2; 3], corners: [DVec3; 3]| {
            corners.map(|at| uvs[0] * at.x + uvs[1] * at.y + uvs[2] * at.z)
        };
        let of = |(old, corners): (u32, [DVec3; 3])| {
            let pattern = self.of.get(old as usize).and_then(|of| Some(of.as_ref()?.part(corners)));
            (pattern, self.uvs.get(old as usize).map_or([DVec2::NAN; 3], |uvs| part(uvs, corners)))
        };
        let (of, uvs): (Vec<_>, Vec<_>) = new.map(of).unzip();
        self.of = if self.of.is_empty() { Vec::new() } else { of };
        self.uvs = if self.uvs.is_empty() { Vec::new() } else { uvs };
    }
}
