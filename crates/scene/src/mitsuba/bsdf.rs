//! BSDFs as (ρ, σ, p): a microfacet roughness α becomes p = 2/α² - 2, with the normalization "energy".

use super::element::Element;
use super::spectrum::Of;
use super::values::{Coloured, Values, note};
use crate::error::SceneError;
use crate::material::{Material, Normalization};
use crate::texture::Map;

/// Reflectance of plastics at normal incidence.
const PLASTIC: f64 = 0.04;
/// Reflectance of metals whose spectra are not read.
const METAL: f64 = 0.8;
/// The largest power, for smooth surfaces.
const SHARPEST: f64 = 2000.0;
/// Levels of BSDFs in one another.
const DEEPEST: u32 = 8;

/// What a BSDF becomes.
#[derive(Clone)]
pub(super) struct Surface {
    /// Without a name.
    pub material: Material,
    pub two_sided: bool,
    /// The texture of its albedo, or of the lobe of a metal.
    pub map: Option<Map>,
}

impl Surface {
    pub fn grey() -> Self {
        Self { material: Material { albedo: [0.5; 3], ..Material::named("") }, two_sided: false, map: None }
    }
}

pub(super) fn read<'a>(
    node: &'a Element,
    values: &Values<'a>,
    ignored: &mut Vec<String>,
) -> Result<Surface, SceneError> {
    nested(node, values, ignored, 0)
}

fn nested<'a>(
    node: &'a Element,
    values: &Values<'a>,
    ignored: &mut Vec<String>,
    depth: u32,
) -> Result<Surface, SceneError> {
    let kind = node.kind();
    let glossy = |albedo, specular, power: f64| Material {
        albedo,
        specular,
        power: power.clamp(0.0, SHARPEST),
        normalization: Normalization::Energy,
        ..Material::named("")
    };
    let power = |alpha: f64| 2.0 / (alpha * alpha) - 2.0;
    let colour = |name, ignored: &mut _| values.colour(node, name, Of::Reflectance, ignored);
    let coloured = |name, usual: [f64; 3], ignored: &mut _| -> Result<Coloured, SceneError> {
        let read = values.coloured(node, name, Of::Reflectance, ignored)?;
        Ok(read.unwrap_or(Coloured { factor: usual, map: None }))
    };
    let (material, map) = match kind {
        "twosided" | "bumpmap" | "normalmap" | "mask" => {
            let inner = values.object(node, "bsdf").filter(|_| depth < DEEPEST);
            let Some(inner) = inner else {
                return Err(node.wrong(format!("<bsdf type=\"{kind}\"> has no BSDF in it")));
            };
            if kind != "twosided" {
                node.pass_over();
                note(ignored, format!("<bsdf type=\"{kind}\">, without it"));
            }
            let surface = nested(inner, values, ignored, depth + 1)?;
            return Ok(Surface { two_sided: surface.two_sided || kind == "twosided", ..surface });
        }
        "diffuse" => {
            let Coloured { factor, map } = coloured("reflectance", [0.5; 3], ignored)?;
            (Material { albedo: factor, ..Material::named("") }, map)
        }
        "plastic" | "roughplastic" => {
            note(ignored, format!("<bsdf type=\"{kind}\">, as a lobe of 4 %"));
            let Coloured { factor, map } = coloured("diffuse_reflectance", [0.5; 3], ignored)?;
            let alpha = if kind == "plastic" { 0.0 } else { values.number(node, "alpha")?.unwrap_or(0.1) };
            let coat = colour("specular_reflectance", ignored)?.unwrap_or([1.0; 3]);
            node.pass_over();
            (glossy(factor, coat.map(|s| PLASTIC * s), power(alpha)), map)
        }
        "phong" => {
            let Coloured { factor, map } = coloured("diffuse_reflectance", [0.5; 3], ignored)?;
            let specular = colour("specular_reflectance", ignored)?.unwrap_or([0.2; 3]);
            // A lobe around the mirror direction is as wide as one of four times its power around the normal.
            let power = 4.0 * values.number(node, "exponent")?.unwrap_or(30.0);
            (glossy(factor, specular, power), map)
        }
        "conductor" | "roughconductor" => {
            note(ignored, format!("<bsdf type=\"{kind}\">, as a lobe"));
            let own = values.text(node, "material")? == Some("none");
            let Coloured { factor, map } = coloured("specular_reflectance", [1.0; 3], ignored)?;
            let alpha = if kind == "conductor" { 0.0 } else { values.number(node, "alpha")?.unwrap_or(0.1) };
            node.pass_over();
            let specular = factor.map(|s| if own { s } else { s * METAL });
            (glossy([0.0; 3], specular, power(alpha)), map)
        }
        "principled" => {
            note(ignored, format!("<bsdf type=\"{kind}\">, by base colour, metalness and roughness"));
            let metal = values.number(node, "metallic")?.unwrap_or(0.0).clamp(0.0, 1.0);
            let rough = values.number(node, "roughness")?.unwrap_or(0.5);
            let Coloured { factor: base, map } = coloured("base_color", [0.5; 3], ignored)?;
            node.pass_over();
            let specular = base.map(|b| metal * b + (1.0 - metal) * PLASTIC);
            (glossy(base.map(|b| (1.0 - metal) * b), specular, power(rough * rough)), map)
        }
        other => {
            node.pass_over();
            note(ignored, format!("<bsdf type=\"{other}\">, grey 0.5 in its place"));
            return Ok(Surface::grey());
        }
    };
    if material.specular != [0.0; 3] && material.power >= SHARPEST {
        note(ignored, format!("smooth surfaces, as lobes of power {SHARPEST}"));
    }
    Ok(Surface { material, two_sided: false, map })
}
