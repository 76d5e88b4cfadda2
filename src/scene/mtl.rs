//! Reads MTL files: Kd = albedo (δ = 1), Ks = σ, Ns = p, Ke = emitted radiance in W/(m² sr).
//!
//! Why not `tobj`: see [`super::obj`]. Among other defects, it panics at `Kd .3`.

use std::collections::HashMap;
use std::path::Path;

use super::error::{Place, SceneError, nearest};
use super::material::Material;
use super::statements::{Statement, number, statements};

/// Keys of the format that have no meaning for Blinn-Phong radiosity.
const IGNORED: [&str; 26] = [
    "Ka",
    "Ni",
    "d",
    "Tr",
    "Tf",
    "illum",
    "sharpness",
    "bump",
    "disp",
    "decal",
    "refl",
    "norm",
    "Pr",
    "Pm",
    "Ps",
    "Pc",
    "Pcr",
    "aniso",
    "anisor",
    "map_Ka",
    "map_Ks",
    "map_Ke",
    "map_Ns",
    "map_d",
    "map_bump",
    "map_Bump",
];
const READ: [&str; 6] = ["newmtl", "Kd", "Ks", "Ns", "Ke", "map_Kd"];

/// A material and the line of its `newmtl`.
pub(super) struct MtlMaterial {
    pub material: Material,
    pub line: usize,
}

/// Reads the text of the file at `path`. Adds to `warnings` what is ignored but may matter.
pub(super) fn parse(
    text: &str,
    path: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<MtlMaterial>, SceneError> {
    let mut materials: Vec<MtlMaterial> = Vec::new();
    let mut lines = HashMap::new();
    for statement in statements(text) {
        let line = statement.line;
        let place = Place { path, line };
        let key = statement.keyword();
        if key == "newmtl" {
            materials
                .push(MtlMaterial { material: new_material(statement.rest(), &mut lines, place)?, line });
            continue;
        }
        let Some(MtlMaterial { material, .. }) = materials.last_mut() else {
            return Err(place.error(format!("`{key}` before any material; start one with `newmtl NAME`")));
        };
        match key {
            "Kd" => material.albedo = rgb(&statement, place)?,
            "Ks" => material.specular = rgb(&statement, place)?,
            "Ke" => material.emission = rgb(&statement, place)?,
            "Ns" => material.power = scalar(&statement, place)?,
            "map_Kd" => warnings.push(format!(
                "{place}: the texture {} of material \"{}\" is ignored; its albedo is Kd.",
                statement.rest(),
                material.name
            )),
            _ if IGNORED.contains(&key) => {}
            _ => warnings.push(match nearest(key, READ) {
                Some(known) => {
                    format!("{place}: unknown key `{key}` is ignored; did you mean `{known}`?")
                }
                None => format!("{place}: unknown key `{key}` is ignored."),
            }),
        }
    }
    Ok(materials)
}

/// `lines`: lines of the materials before this one.
fn new_material(
    name: &str,
    lines: &mut HashMap<String, usize>,
    place: Place,
) -> Result<Material, SceneError> {
    if name.is_empty() {
        return Err(place.error("`newmtl` without a name; expected `newmtl NAME`"));
    }
    match lines.insert(name.to_owned(), place.line) {
        Some(first) => Err(place
            .error(format!("material \"{name}\" is already defined at line {first}; rename one of the two"))),
        None => Ok(Material::named(name)),
    }
}

/// Three numbers, or one for all channels.
fn rgb(statement: &Statement, place: Place) -> Result<[f64; 3], SceneError> {
    match numbers(statement, place)?[..] {
        [grey] => Ok([grey; 3]),
        [r, g, b] => Ok([r, g, b]),
        ref other => Err(place.error(format!(
            "`{}` has {} numbers; expected `{0} r g b`",
            statement.keyword(),
            other.len()
        ))),
    }
}

fn scalar(statement: &Statement, place: Place) -> Result<f64, SceneError> {
    match numbers(statement, place)?[..] {
        [value] => Ok(value),
        ref other => {
            Err(place.error(format!("`{}` has {} numbers; expected one", statement.keyword(), other.len())))
        }
    }
}

fn numbers(statement: &Statement, place: Place) -> Result<Vec<f64>, SceneError> {
    statement.words().map(|word| number(word, place)).collect()
}
