//! `<transform>`: steps, applied in their order.

use glam::{DMat3, DMat4, DVec3};
use roxmltree::Node;

use super::values::Values;
use crate::error::SceneError;

pub(super) fn read(node: Node, values: &Values) -> Result<DMat4, SceneError> {
    let mut whole = DMat4::IDENTITY;
    for step in node.children().filter(Node::is_element) {
        let wrong = |message: String| values.wrong(step, message);
        let matrix = match step.tag_name().name() {
            "translate" => DMat4::from_translation(values.vector(step, 0.0)?),
            "scale" => DMat4::from_scale(values.vector(step, 1.0)?),
            "rotate" => {
                let angle = values.numbers(step, "angle")?.unwrap_or_default();
                let (&[angle], Some(axis)) = (&angle[..], values.vector(step, 0.0)?.try_normalize()) else {
                    return Err(wrong("a rotation needs an angle and an axis".to_owned()));
                };
                DMat4::from_axis_angle(axis, angle.to_radians())
            }
            "matrix" => match values.numbers(step, "value")?.as_deref() {
                // Row by row.
                Some(m) if m.len() == 16 => {
                    DMat4::from_cols_array(&std::array::from_fn(|k| m[k])).transpose()
                }
                Some(m) if m.len() == 9 => {
                    DMat4::from_mat3(DMat3::from_cols_array(&std::array::from_fn(|k| m[k])).transpose())
                }
                _ => return Err(wrong("a matrix needs 16 or 9 numbers".to_owned())),
            },
            "lookat" => look_at(step, values)?,
            other => return Err(wrong(format!("<{other}> is no transform that is read"))),
        };
        whole = matrix * whole;
    }
    match whole.is_finite() && whole.row(3) == glam::DVec4::W {
        true => Ok(whole),
        false => Err(values.wrong(node, "the transform is not affine, or not finite".to_owned())),
    }
}

/// The view along +z, with +x to the left.
fn look_at(step: Node, values: &Values) -> Result<DMat4, SceneError> {
    let point = |name: &str| -> Result<Option<DVec3>, SceneError> {
        match values.numbers(step, name)?.as_deref() {
            None => Ok(None),
            Some(&[x, y, z]) => Ok(Some(DVec3::new(x, y, z))),
            Some(_) => Err(values.wrong(step, format!("`{name}` needs three numbers"))),
        }
    };
    let (Some(origin), Some(target)) = (point("origin")?, point("target")?) else {
        return Err(values.wrong(step, "lookat needs origin and target".to_owned()));
    };
    let up = point("up")?.unwrap_or(DVec3::Y);
    let ahead = (target - origin).normalize_or_zero();
    let Some(left) = up.cross(ahead).try_normalize() else {
        return Err(values.wrong(step, "origin, target and up of lookat lie on one line".to_owned()));
    };
    Ok(DMat4::from_cols(
        left.extend(0.0),
        ahead.cross(left).extend(0.0),
        ahead.extend(0.0),
        origin.extend(1.0),
    ))
}
