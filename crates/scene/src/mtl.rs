//! Reads MTL files: Kd = albedo (δ = 1), Ks = σ, Ns = p, Ke = emitted radiance in W/(m² sr).
//!
//! Why not `tobj`: see [`super::obj`]. Among other defects, it panics at `Kd .3`.

use std::collections::HashMap;
use std::path::Path;

use glam::{DAffine2, DVec2};

use super::error::{Place, SceneError, nearest};
use super::material::Material;
use super::statements::{Statement, number, statements};
use super::texture::Wrap;

/// Keys that have no meaning for Blinn-Phong radiosity, or none that pictures would show.
const MEANINGLESS: [&str; 4] = ["Ka", "Ni", "illum", "sharpness"];
/// Keys whose effect on a picture is lost.
const IGNORED: [&str; 21] = [
    "d", "Tr", "Tf", "bump", "disp", "decal", "refl", "norm", "Pr", "Pm", "Ps", "Pc", "Pcr", "aniso",
    "anisor", "map_Ka", "map_Ks", "map_Ns", "map_d", "map_bump", "map_Bump",
];
const READ: [&str; 7] = ["newmtl", "Kd", "Ks", "Ns", "Ke", "map_Kd", "map_Ke"];

/// A material and the line of its `newmtl`.
pub(super) struct MtlMaterial {
    pub material: Material,
    pub line: usize,
    pub albedo: Option<TextureFile>,
    pub emission: Option<TextureFile>,
}

/// A texture that a material names.
pub(super) struct TextureFile {
    pub name: String,
    /// Maps the coordinates of `vt` to those of the picture.
    pub place: DAffine2,
    pub wrap: Wrap,
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
            let material = new_material(statement.rest(), &mut lines, place)?;
            materials.push(MtlMaterial { material, line, albedo: None, emission: None });
            continue;
        }
        let Some(MtlMaterial { material, albedo, emission, .. }) = materials.last_mut() else {
            return Err(place.error(format!("`{key}` before any material; start one with `newmtl NAME`")));
        };
        match key {
            "Kd" => material.albedo = rgb(&statement, place)?,
            "Ks" => material.specular = rgb(&statement, place)?,
            "Ke" => material.emission = rgb(&statement, place)?,
            "Ns" => material.power = scalar(&statement, place)?,
            "map_Kd" => *albedo = texture_file(&statement),
            "map_Ke" => *emission = texture_file(&statement),
            _ if MEANINGLESS.contains(&key) || is_opaque(key, statement.rest()) => {}
            _ => ignored.add(key, line),
        }
    }
    ignored.warn(path, warnings);
    for MtlMaterial { material, albedo, emission, .. } in &mut materials {
        // Textures multiply Kd and Ke; where those are black or missing, some programs mean the texture alone.
        let alone = |factor: &mut [f64; 3], map: &Option<TextureFile>| {
            if map.is_some() && *factor == [0.0; 3] {
                *factor = [1.0; 3];
            }
        };
        alone(&mut material.albedo, albedo);
        alone(&mut material.emission, emission);
    }
    Ok(materials)
}

/// `map_Kd [-option value …] FILE`, in which options `-s` and `-o` scale and move the coordinates, and `-clamp on` keeps them within
/// the picture. Names may contain blanks.
fn texture_file(statement: &Statement) -> Option<TextureFile> {
    let mut rest = statement.rest();
    let (mut scale, mut offset, mut wrap) = (DVec2::ONE, DVec2::ZERO, Wrap::Repeat);
    let next = |rest: &mut &str| -> Option<String> {
        let word = rest.split_whitespace().next()?.to_owned();
        *rest = rest[word.len()..].trim_start();
        Some(word)
    };
    while rest.starts_with('-') {
        let option = next(&mut rest)?;
        // The numbers of -o, -s and -t are one to three; other options have one value, -mm has two.
        let mut numbers = Vec::new();
        match option.as_str() {
            "-o" | "-s" | "-t" => {
                while numbers.len() < 3 {
                    let Some(Ok(number)) = rest.split_whitespace().next().map(str::parse::<f64>) else {
                        break;
                    };
                    numbers.push(number);
                    next(&mut rest)?;
                }
            }
            "-mm" => {
                next(&mut rest)?;
                next(&mut rest)?;
            }
            "-clamp" => wrap = if next(&mut rest)? == "on" { Wrap::Clamp } else { Wrap::Repeat },
            _ => {
                next(&mut rest)?;
            }
        }
        let target = match option.as_str() {
            "-s" => &mut scale,
            "-o" => &mut offset,
            _ => continue,
        };
        target.x = numbers.first().copied().unwrap_or(target.x);
        target.y = numbers.get(1).copied().unwrap_or(target.y);
    }
    // Coordinates count from the lower left corner, pictures from the upper left.
    let upright = DAffine2::from_scale_angle_translation(DVec2::new(1.0, -1.0), 0.0, DVec2::Y);
    let place = upright * DAffine2::from_scale_angle_translation(scale, 0.0, offset);
    let name = rest.replace('\\', "/");
    (!name.is_empty()).then_some(TextureFile { name, place, wrap, line: statement.line })
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
                "{}: ignored, without a meaning here: {}.",
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
