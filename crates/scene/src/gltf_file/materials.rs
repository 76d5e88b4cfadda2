//! Materials of glTF as (ρ, σ, p).
//!
//! With base colour b, metalness m and roughness r:
//!
//! ```text
//! ρ = (1 - m) b        σ = m b + (1 - m) 0.04        p = 2/r⁴ - 2, normalization "energy"
//! ```
//!
//! The power is that of the Blinn-Phong lobe about as wide as the microfacet distribution of roughness α = r² (Walter et al.,
//! EGSR 2007: p = 2/α² - 2). Dielectrics with r ≥ 0.4 are diffuse, σ = 0, since their 4 % are hardly seen and lobes cost bins; where
//! p < 1, σ joins ρ.
//!
//! KHR_materials_pbrSpecularGlossiness has a diffuse colour d, a specular colour s and a glossiness g, in whose terms
//!
//! ```text
//! ρ = (1 - max s) d        σ = s        r = 1 - g
//! ```

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine2, DVec2, DVec3};
use gltf::texture::WrappingMode;
use serde::Deserialize;

use super::buffers::{self, Buffers};
use crate::geometry::RawMaterial;
use crate::material::{Material, Normalization};
use crate::texture::{Encoding, Map, Texture, Wrap};
use antirad_base::output::free_name;

/// Reflectance of dielectrics at normal incidence.
const DIELECTRIC: f64 = 0.04;
/// Roughness from which dielectrics are diffuse.
const ROUGH: f64 = 0.4;
/// Specular colour up to which a material is a dielectric.
const WEAK: f64 = 0.1;
/// Metalness below which a material is a dielectric.
const METAL: f64 = 0.05;
/// The largest power that roughness stands for.
const SHARPEST: f64 = 2000.0;
/// Power below which a lobe is as wide as that of a diffuse surface, which takes its place.
const WIDE: f64 = 1.0;
/// Most bytes of a picture.
const MOST_BYTES: u64 = 1 << 29;

pub(super) struct Materials<'a> {
    path: &'a Path,
    buffers: &'a Buffers,
    textures: HashMap<(usize, Encoding), Option<Arc<Texture>>>,
    /// Index of the material of each name.
    names: HashMap<String, usize>,
    /// Whether there are pictures of a kind that is not read.
    unread: bool,
}

/// The set of texture coordinates that a material needs.
pub(super) fn texture_set(material: &gltf::Material) -> Option<u32> {
    colour_texture(material).or(material.emissive_texture()).map(|info| set(&info))
}

fn set(info: &gltf::texture::Info) -> u32 {
    let moved = info.texture_transform().and_then(|transform| transform.tex_coord());
    moved.unwrap_or(info.tex_coord())
}

/// The texture of the albedo.
fn colour_texture<'a>(material: &gltf::Material<'a>) -> Option<gltf::texture::Info<'a>> {
    match material.pbr_specular_glossiness() {
        Some(glossy) => glossy.diffuse_texture(),
        None => material.pbr_metallic_roughness().base_color_texture(),
    }
}

impl<'a> Materials<'a> {
    pub fn new(path: &'a Path, buffers: &'a Buffers) -> Self {
        Self { path, buffers, textures: HashMap::new(), names: HashMap::new(), unread: false }
    }

    /// A material; `ignored` takes what is left out.
    ///
    /// # Errors
    /// Fails if the picture of a texture cannot be read or decoded.
    pub fn read(&mut self, from: &gltf::Material, ignored: &mut Vec<String>) -> Result<RawMaterial, String> {
        let mut ignore = |what: &str| {
            if !ignored.iter().any(|known| known == what) {
                ignored.push(what.to_owned());
            }
        };
        if from.alpha_mode() != gltf::material::AlphaMode::Opaque {
            ignore("transparency");
        }
        if from.normal_texture().is_some() {
            ignore("normal maps");
        }
        if from.index().is_none() {
            let grey = Material { albedo: [0.5; 3], ..Material::named("default") };
            return Ok(RawMaterial::of_file(grey, self.path));
        }
        let name = self.name(from);
        let (reflecting, rough) = match from.pbr_specular_glossiness() {
            Some(glossy) => self.specular_glossy(&name, &glossy, &mut ignore)?,
            None => self.metallic_rough(&name, &from.pbr_metallic_roughness(), &mut ignore)?,
        };
        if from.extras().is_none() && power(rough) > SHARPEST {
            ignore("roughness below 0.18, which is taken as 0.18");
        }
        let strength = from.emissive_strength().map_or(1.0, f64::from);
        let emission = DVec3::from(from.emissive_factor().map(f64::from)) * strength;
        let material = Material { emission: emission.into(), ..reflecting };
        let exact = from.extras().as_ref().and_then(|extras| Exact::of(extras.get()));
        let material = exact.map_or(material, |exact| exact.material(&name));
        let mut raw = RawMaterial::of_file(material, self.path);
        raw.two_sided = from.double_sided();
        raw.maps.albedo = match colour_texture(from) {
            Some(info) => self.map(&info)?,
            None => None,
        };
        match from.emissive_texture() {
            Some(info) if emission != DVec3::ZERO && texture_set(from) != Some(set(&info)) => {
                ignore("emission textures with coordinates of their own, whose means are taken");
                raw.material.emission = (emission * self.mean(&info, Encoding::Srgb)?).into();
            }
            Some(info) if emission != DVec3::ZERO => raw.maps.emission = self.map(&info)?,
            _ => {}
        }
        if self.unread {
            ignore("textures that are neither PNG nor JPEG");
        }
        Ok(raw)
    }

    /// What reflects of a material of metalness and roughness, and the roughness.
    fn metallic_rough(
        &mut self,
        name: &str,
        from: &gltf::material::PbrMetallicRoughness,
        ignore: &mut impl FnMut(&str),
    ) -> Result<(Material, f64), String> {
        let (mut metal, mut rough) = (f64::from(from.metallic_factor()), f64::from(from.roughness_factor()));
        if let Some(info) = from.metallic_roughness_texture() {
            let mean = self.mean(&info, Encoding::Linear)?;
            ignore("variation of metalness and roughness over a material, whose means are taken");
            (metal, rough) = (metal * mean.z, rough * mean.y);
        }
        let [r, g, b, _] = from.base_color_factor().map(f64::from);
        let rough = rough.clamp(0.0, 1.0);
        Ok((reflecting(name, [r, g, b], metal.clamp(0.0, 1.0), rough), rough))
    }

    /// The same of a material of specular colour and glossiness.
    fn specular_glossy(
        &mut self,
        name: &str,
        from: &gltf::material::PbrSpecularGlossiness,
        ignore: &mut impl FnMut(&str),
    ) -> Result<(Material, f64), String> {
        let mut specular = DVec3::from(from.specular_factor().map(f64::from));
        let mut gloss = f64::from(from.glossiness_factor());
        let [r, g, b, _] = from.diffuse_factor().map(f64::from);
        if let Some(info) = from.specular_glossiness_texture() {
            ignore("variation of specular colour and glossiness over a material, whose means are taken");
            specular *= self.mean(&info, Encoding::Srgb)?;
            gloss *= self.mean(&info, Encoding::Alpha)?.x;
        } else if specular == DVec3::ONE && [r, g, b] != [0.0; 3] {
            // The default, which leaves nothing to the diffuse colour: nobody who gives one means that.
            specular = DVec3::splat(DIELECTRIC);
        }
        let rough = 1.0 - gloss.clamp(0.0, 1.0);
        let left = 1.0 - specular.max_element().clamp(0.0, 1.0);
        let dielectric = specular.max_element() <= WEAK;
        let colour = [r, g, b].map(|d| if dielectric { d } else { left * d });
        Ok((with_lobe(name, colour, specular.into(), dielectric, rough), rough))
    }

    /// The mean of a texture; 1 for one that is not read.
    fn mean(&mut self, info: &gltf::texture::Info, encoding: Encoding) -> Result<DVec3, String> {
        Ok(self.texture(&info.texture(), encoding)?.map_or(DVec3::ONE, |texture| texture.mean()))
    }

    /// The name of a material; names need not differ in the file.
    fn name(&mut self, from: &gltf::Material) -> String {
        let index = from.index().unwrap_or(usize::MAX);
        let given = from.name().map(str::trim).filter(|name| !name.is_empty());
        let name = given.map_or(format!("material {index}"), str::to_owned);
        let name = free_name(&name, |name| self.names.get(name).is_none_or(|&known| known == index));
        self.names.insert(name.clone(), index);
        name
    }

    fn map(&mut self, info: &gltf::texture::Info) -> Result<Option<Map>, String> {
        let place = info.texture_transform().map_or(DAffine2::IDENTITY, |t| {
            let [scale, offset] = [t.scale(), t.offset()].map(|v| DVec2::from(v.map(f64::from)));
            // Angles run counter-clockwise in a plane whose second axis points down.
            DAffine2::from_scale_angle_translation(scale, -f64::from(t.rotation()), offset)
        });
        let wrap =
            [info.texture().sampler().wrap_s(), info.texture().sampler().wrap_t()].map(|mode| match mode {
                WrappingMode::Repeat => Wrap::Repeat,
                WrappingMode::ClampToEdge => Wrap::Clamp,
                WrappingMode::MirroredRepeat => Wrap::Mirror,
            });
        Ok(self.texture(&info.texture(), Encoding::Srgb)?.map(|texture| Map { texture, place, wrap }))
    }

    fn texture(
        &mut self,
        texture: &gltf::Texture,
        encoding: Encoding,
    ) -> Result<Option<Arc<Texture>>, String> {
        // Without one it needs an extension for other kinds of pictures.
        let Some(image) = texture.source() else {
            self.unread = true;
            return Ok(None);
        };
        if let Some(known) = self.textures.get(&(image.index(), encoding)) {
            return Ok(known.clone());
        }
        let wrong = |message: String| format!("image {}: {message}", image.index());
        let read = match image.source() {
            gltf::image::Source::Uri { uri, .. } => {
                Texture::decode(&buffers::fetch(uri, self.path, MOST_BYTES).map_err(wrong)?, encoding)
            }
            gltf::image::Source::View { view, .. } => {
                let bytes = self.buffers.view(&view);
                let bytes = bytes.ok_or_else(|| wrong("lies past the end of its buffer".to_owned()))?;
                Texture::decode(bytes, encoding)
            }
        };
        let read = read.map_err(wrong)?.map(Arc::new);
        self.unread |= read.is_none();
        self.textures.insert((image.index(), encoding), read.clone());
        Ok(read)
    }
}

/// A material that was exported from here, in `extras`.
#[derive(Deserialize)]
struct Exact {
    diffuse: f64,
    albedo: [f64; 3],
    specular: [f64; 3],
    power: f64,
    emission: [f64; 3],
    normalization: Normalization,
}

impl Exact {
    fn of(extras: &str) -> Option<Self> {
        #[derive(Deserialize)]
        struct Extras {
            antirad: Exact,
        }
        serde_json::from_str::<Extras>(extras).ok().map(|extras| extras.antirad)
    }

    fn material(self, name: &str) -> Material {
        let Self { diffuse, albedo, specular, power, emission, normalization } = self;
        Material { name: name.to_owned(), diffuse, albedo, specular, power, emission, normalization }
    }
}

fn power(rough: f64) -> f64 {
    2.0 / rough.powi(4) - 2.0
}

fn reflecting(name: &str, base: [f64; 3], metal: f64, rough: f64) -> Material {
    let metal = if metal < METAL { 0.0 } else { metal };
    let albedo = base.map(|b| (1.0 - metal) * b);
    let specular = base.map(|b| metal * b + (1.0 - metal) * DIELECTRIC);
    with_lobe(name, albedo, specular, metal == 0.0, rough)
}

fn with_lobe(name: &str, albedo: [f64; 3], specular: [f64; 3], dielectric: bool, rough: f64) -> Material {
    if dielectric && rough >= ROUGH {
        return Material { albedo, ..Material::named(name) };
    }
    let power = power(rough).clamp(0.0, SHARPEST);
    if power < WIDE {
        let sum = [0, 1, 2].map(|k| albedo[k] + specular[k]);
        return Material { albedo: sum, ..Material::named(name) };
    }
    let normalization = Normalization::Energy;
    Material { albedo, specular, power, normalization, ..Material::named(name) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metals_reflect_in_lobes_and_rough_dielectrics_do_not() {
        let base = [0.8, 0.4, 0.2];
        let plastic = reflecting("a", base, 0.0, 0.5);
        assert_eq!((plastic.albedo, plastic.is_glossy()), (base, false));
        let polished = reflecting("b", base, 0.0, 0.2);
        assert_eq!((polished.albedo, polished.specular), (base, [0.04; 3]));
        assert!((polished.power - 1248.0).abs() < 1e-6, "{}", polished.power);
        let copper = reflecting("c", base, 1.0, 0.5);
        assert_eq!((copper.albedo, copper.specular), ([0.0; 3], base));
        assert!((copper.power - 30.0).abs() < 1e-9);
        for material in [plastic, polished, copper, reflecting("d", [1.0; 3], 1.0, 0.0)] {
            assert!(material.total_albedo() < 1.02, "{}: {}", material.name, material.total_albedo());
        }
    }
}
