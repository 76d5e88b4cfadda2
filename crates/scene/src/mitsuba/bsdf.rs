//! BSDFs as (ρ, σ, p): a microfacet roughness α becomes p = 2/α² - 2, with the normalization "energy".

use std::collections::HashMap;

use roxmltree::Node;

use super::spectrum::Of;
use super::values::Values;
use crate::error::SceneError;
use crate::material::{Material, Normalization};

/// Reflectance of plastics at normal incidence.
const PLASTIC: f64 = 0.04;
/// Reflectance of metals whose spectra are not read.
const METAL: f64 = 0.8;
/// The largest power, for smooth surfaces.
const SHARPEST: f64 = 2000.0;
/// Levels of BSDFs in one another.
const DEEPEST: u32 = 8;

/// The material of a BSDF, without a name, and whether it has two sides.
pub(super) fn read<'a, 'i>(
    node: Node<'a, 'i>,
    by_id: &HashMap<&'a str, Node<'a, 'i>>,
    values: &Values,
    ignored: &mut Vec<String>,
) -> Result<(Material, bool), SceneError> {
    nested(node, by_id, values, ignored, 0)
}

fn nested<'a, 'i>(
    node: Node<'a, 'i>,
    by_id: &HashMap<&'a str, Node<'a, 'i>>,
    values: &Values,
    ignored: &mut Vec<String>,
    depth: u32,
) -> Result<(Material, bool), SceneError> {
    let kind = node.attribute("type").unwrap_or_default();
    let black = Material::named("");
    let glossy = |albedo, specular, power: f64| Material {
        albedo,
        specular,
        power: power.clamp(0.0, SHARPEST),
        normalization: Normalization::Energy,
        ..Material::named("")
    };
    let power = |alpha: f64| 2.0 / (alpha * alpha) - 2.0;
    let colour = |name, ignored: &mut _| values.colour(node, name, Of::Reflectance, ignored);
    let mut approximate = |what: String| {
        if !ignored.contains(&what) {
            ignored.push(what);
        }
    };
    let material = match kind {
        "twosided" | "bumpmap" | "normalmap" | "mask" => {
            let inner =
                node.children().filter(Node::is_element).find_map(|child| match child.has_tag_name("ref") {
                    true => child.attribute("id").and_then(|id| by_id.get(id)).copied(),
                    false => Some(child).filter(|child| child.has_tag_name("bsdf")),
                });
            let inner = inner.filter(|inner| inner.has_tag_name("bsdf") && depth < DEEPEST);
            let Some(inner) = inner else {
                return Err(values.wrong(node, format!("<bsdf type=\"{kind}\"> has no BSDF in it")));
            };
            if kind != "twosided" {
                approximate(format!("<bsdf type=\"{kind}\">, without it"));
            }
            let (material, two_sided) = nested(inner, by_id, values, ignored, depth + 1)?;
            return Ok((material, two_sided || kind == "twosided"));
        }
        "diffuse" => {
            let albedo = colour("reflectance", ignored)?.unwrap_or([0.5; 3]);
            Material { albedo, ..black }
        }
        "plastic" | "roughplastic" => {
            approximate(format!("<bsdf type=\"{kind}\">, as a lobe of 4 %"));
            let albedo = colour("diffuse_reflectance", ignored)?.unwrap_or([0.5; 3]);
            let alpha = if kind == "plastic" { 0.0 } else { values.number(node, "alpha")?.unwrap_or(0.1) };
            let coat = colour("specular_reflectance", ignored)?.unwrap_or([1.0; 3]);
            glossy(albedo, coat.map(|s| PLASTIC * s), power(alpha))
        }
        "phong" => {
            let albedo = colour("diffuse_reflectance", ignored)?.unwrap_or([0.5; 3]);
            let specular = colour("specular_reflectance", ignored)?.unwrap_or([0.2; 3]);
            // A lobe around the mirror direction is as wide as one of four times its power around the normal.
            glossy(albedo, specular, 4.0 * values.number(node, "exponent")?.unwrap_or(30.0))
        }
        "conductor" | "roughconductor" => {
            approximate(format!("<bsdf type=\"{kind}\">, as a lobe"));
            let usual = [METAL; 3];
            let own = values.text(node, "material")?.as_deref() == Some("none");
            let specular = colour("specular_reflectance", ignored)?;
            let alpha = if kind == "conductor" { 0.0 } else { values.number(node, "alpha")?.unwrap_or(0.1) };
            let specular = specular.unwrap_or([1.0; 3]).map(|s| if own { s } else { s * usual[0] });
            glossy([0.0; 3], specular, power(alpha))
        }
        "principled" => {
            approximate(format!("<bsdf type=\"{kind}\">, by base colour, metalness and roughness"));
            let base = colour("base_color", ignored)?.unwrap_or([0.5; 3]);
            let metal = values.number(node, "metallic")?.unwrap_or(0.0).clamp(0.0, 1.0);
            let rough = values.number(node, "roughness")?.unwrap_or(0.5);
            let specular = base.map(|b| metal * b + (1.0 - metal) * PLASTIC);
            glossy(base.map(|b| (1.0 - metal) * b), specular, power(rough * rough))
        }
        other => {
            approximate(format!("<bsdf type=\"{other}\">, grey 0.5 in its place"));
            Material { albedo: [0.5; 3], ..black }
        }
    };
    let smooth = format!("smooth surfaces, as lobes of power {SHARPEST}");
    if material.specular != [0.0; 3] && material.power >= SHARPEST && !ignored.contains(&smooth) {
        ignored.push(smooth);
    }
    Ok((material, false))
}
