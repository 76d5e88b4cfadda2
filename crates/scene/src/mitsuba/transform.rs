//! `<transform>`: steps, applied in their order.

use glam::{DMat3, DMat4, DVec3};

use super::element::Element;
use super::values::Values;
use crate::error::SceneError;

pub(super) fn read<'a>(node: &'a Element, values: &Values<'a>) -> Result<DMat4, SceneError> {
    let mut whole = DMat4::IDENTITY;
    for step in &node.children {
        let matrix = match step.tag.as_str() {
            "translate" => DMat4::from_translation(values.vector(step, 0.0)?),
            "scale" => DMat4::from_scale(values.vector(step, 1.0)?),
            "rotate" => {
                let angle = values.numbers(step, "angle")?.unwrap_or_default();
                let (&[angle], Some(axis)) = (&angle[..], values.vector(step, 0.0)?.try_normalize()) else {
                    return Err(step.wrong("a rotation needs an angle and an axis"));
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
                _ => return Err(step.wrong("a matrix needs 16 or 9 numbers")),
            },
            "lookat" => look_at(step, values)?,
            other => return Err(step.wrong(format!("<{other}> is no transform that is read"))),
        };
        whole = matrix * whole;
    }
    match whole.is_finite() && whole.row(3) == glam::DVec4::W {
        true => Ok(whole),
        false => Err(node.wrong("the transform is not affine, or not finite")),
    }
}

/// The view along +z, with +x to the left.
fn look_at<'a>(step: &'a Element, values: &Values<'a>) -> Result<DMat4, SceneError> {
    let point = |name: &str| -> Result<Option<DVec3>, SceneError> {
        match values.numbers(step, name)?.as_deref() {
            None => Ok(None),
            Some(&[x, y, z]) => Ok(Some(DVec3::new(x, y, z))),
            Some(_) => Err(step.wrong(format!("`{name}` needs three numbers"))),
        }
    };
    let (Some(origin), Some(target)) = (point("origin")?, point("target")?) else {
        return Err(step.wrong("lookat needs origin and target"));
    };
    let up = point("up")?.unwrap_or(DVec3::Y);
    let ahead = (target - origin).normalize_or_zero();
    let Some(left) = up.cross(ahead).try_normalize() else {
        return Err(step.wrong("origin, target and up of lookat lie on one line"));
    };
    Ok(DMat4::from_cols(
        left.extend(0.0),
        ahead.cross(left).extend(0.0),
        ahead.extend(0.0),
        origin.extend(1.0),
    ))
}
