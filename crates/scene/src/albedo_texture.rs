//! Textures of albedo, for programs that show them.

use glam::{DVec2, DVec3};

use super::{Scene, Wrap};

/// How a texture of albedo lies on a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlbedoTexture {
    /// Which texture, for [`Scene::albedo_png`].
    pub index: u32,
    /// How the picture goes on beyond its edges, along both axes.
    pub wrap: [Wrap; 2],
    /// Texture coordinates of the corners, of which (0, 0) is the upper left corner of the picture.
    pub uvs: [DVec2; 3],
    /// What multiplies the texture to give the albedo.
    pub factor: [f64; 3],
}

impl Scene {
    /// The texture of a triangle's albedo, if it has one.
    #[doc(hidden)]
    pub fn albedo_texture(&self, triangle: usize) -> Option<AlbedoTexture> {
        let (pattern, maps) = self.patterns.get(triangle)?;
        let map = maps.albedo.as_ref()?;
        let (_, uvs) = self.patterns.textured(triangle)?;
        let albedo = DVec3::from(self.material(triangle).albedo);
        uvs.iter().all(|uv| uv.is_finite()).then(|| AlbedoTexture {
            wrap: map.wrap,
            index: self.patterns.index_of(&map.texture),
            uvs: uvs.map(|uv| map.place.transform_point2(uv)),
            factor: (albedo * pattern.ratio(0, DVec3::ONE)).into(),
        })
    }

    /// A texture of albedo as a PNG of 16 bits in sRGB.
    ///
    /// # Errors
    /// Fails if it cannot be encoded. The error says why.
    #[doc(hidden)]
    pub fn albedo_png(&self, index: u32) -> Result<Vec<u8>, String> {
        let texture = self.patterns.albedo_map(index).ok_or("there is no such texture")?;
        texture.png().map_err(|error| error.to_string())
    }
}
