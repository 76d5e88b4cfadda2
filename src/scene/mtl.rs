//! Reads MTL files: Kd = albedo (δ = 1), Ks = σ, Ns = p, Ke = emitted radiance in W/(m² sr).
//!
//! Why not `tobj`: see [`super::obj`]. Among other defects, it panics at `Kd .3`.

use std::collections::HashMap;
use std::path::Path;

use super::error::{Place, SceneError, nearest};
use super::material::Material;
use super::statements::{Statement, number, statements};

/// Keys that have no meaning for Blinn-Phong radiosity, or none that pictures would show.
const MEANINGLESS: [&str; 4] = ["Ka", "Ni", "illum", "sharpness"];
/// Keys whose effect on a picture is lost.
const IGNORED: [&str; 22] = [
    "d", "Tr", "Tf", "bump", "disp", "decal", "refl", "norm", "Pr", "Pm", "Ps", "Pc", "Pcr", "aniso",
    "anisor", "map_Ka", "map_Ks", "map_Ns", "map_d", "map_bump", "map_Bump", "map_Kd",
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
    let mut ignored = Ignored::default();
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
            _ if MEANINGLESS.contains(&key) || is_opaque(key, statement.rest()) => {}
            _ => ignored.add(key, line),
        }
    }
    ignored.warn(path, warnings);
    Ok(materials)
}

/// Whether the statement says that a material is opaque: `d 1`, `Tr 0`, `Tf 1 1 1`.
fn is_opaque(key: &str, rest: &str) -> bool {
    let opaque = match key {
        "d" | "Tf" => 1.0,
        "Tr" => 0.0,
        _ => return false,
    };
    rest.split_whitespace().all(|word| word.parse() == Ok(opaque))
}

/// Keys that are ignored though they may matter, in order of appearance, with the lines of the first and how often.
#[derive(Default)]
struct Ignored(Vec<(String, usize, usize)>);

impl Ignored {
    fn add(&mut self, key: &str, line: usize) {
        match self.0.iter_mut().find(|(known, ..)| known == key) {
            Some((.., times)) => *times += 1,
            None => self.0.push((key.to_owned(), line, 1)),
        }
    }

    /// One warning for all keys of the format; one for each key outside of it, which may be misspelt.
    fn warn(self, path: &Path, warnings: &mut Vec<String>) {
        let (known, unknown): (Vec<_>, Vec<_>) =
            self.0.into_iter().partition(|(key, ..)| IGNORED.contains(&key.as_str()));
        if let Some(&(_, line, _)) = known.first() {
            let each = known.iter().map(|(key, _, times)| match times {
                1 => format!("`{key}`"),
                _ => format!("`{key}` ({times} times)"),
            });
            warnings.push(format!(
                "{}: ignored, for materials are opaque and of one colour each: {}.",
                Place { path, line },
                each.collect::<Vec<_>>().join(", ")
            ));
        }
        for (key, line, _) in unknown {
            let hint =
                nearest(&key, READ).map_or(String::new(), |known| format!("; did you mean `{known}`?"));
            let end = if hint.is_empty() { "." } else { "" };
            warnings.push(format!("{}: unknown key `{key}` is ignored{hint}{end}", Place { path, line }));
        }
    }
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
