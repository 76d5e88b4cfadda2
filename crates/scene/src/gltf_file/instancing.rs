//! Places of a node's mesh by EXT_mesh_gpu_instancing.

use glam::{DMat4, DQuat, DVec3, DVec4};
use serde::Deserialize;

use super::accessor::Accessors;

pub(super) const NAME: &str = "EXT_mesh_gpu_instancing";

#[derive(Deserialize)]
struct Instancing {
    attributes: Attributes,
}

/// Accessors of a row for each instance; other attributes, such as colours, do not move it.
#[derive(Default, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
struct Attributes {
    translation: Option<usize>,
    rotation: Option<usize>,
    scale: Option<usize>,
}

/// The place of each instance relative to the node; one that is the node's own without the extension.
///
/// # Errors
/// Fails if an accessor cannot be read, if attributes differ in length, or if a rotation is zero.
pub(super) fn places(
    document: &gltf::Document,
    node: &gltf::Node,
    accessors: &Accessors,
) -> Result<Vec<DMat4>, String> {
    let Some(value) = node.extension_value(NAME) else { return Ok(vec![DMat4::IDENTITY]) };
    let wrong = |what: String| format!("{NAME}: {what}");
    let Instancing { attributes } =
        Instancing::deserialize(value).map_err(|error| wrong(error.to_string()))?;
    let accessor = |index: usize| {
        document.accessors().nth(index).ok_or_else(|| wrong(format!("accessor {index} is past the end")))
    };
    let threes = |index: Option<usize>| match index {
        Some(index) => accessors.rows::<3>(&accessor(index)?).map(Some),
        None => Ok(None),
    };
    let (translations, scales) = (threes(attributes.translation)?, threes(attributes.scale)?);
    let rotations = match attributes.rotation {
        Some(index) => Some(accessors.rows::<4>(&accessor(index)?)?),
        None => None,
    };
    let counts = [
        translations.as_ref().map(Vec::len),
        rotations.as_ref().map(Vec::len),
        scales.as_ref().map(Vec::len),
    ];
    let mut stated = counts.into_iter().flatten();
    let count = stated.next().unwrap_or(1);
    if let Some(other) = stated.find(|other| *other != count) {
        return Err(wrong(format!("attributes have {count} and {other} rows; they must be as long")));
    }
    let place = |k: usize| {
        let translation = translations.as_ref().map_or(DVec3::ZERO, |rows| rows[k].into());
        let scale = scales.as_ref().map_or(DVec3::ONE, |rows| rows[k].into());
        let rotation = match &rotations {
            Some(rows) => DVec4::from(rows[k])
                .try_normalize()
                .map(DQuat::from_vec4)
                .ok_or_else(|| wrong(format!("the rotation of instance {k} is zero")))?,
            None => DQuat::IDENTITY,
        };
        Ok(DMat4::from_scale_rotation_translation(scale, rotation, translation))
    };
    (0..count).map(place).collect()
}
