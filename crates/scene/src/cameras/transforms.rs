//! `transforms.json`, as NeRF, Blender, instant-ngp and nerfstudio have it.

use std::path::{Path, PathBuf};

use glam::DVec2;
use serde::Deserialize;
use serde_json::Value;

use super::similarity::affine;
use super::{CameraSet, Distortion, Focal, Frame, Intrinsics, cannot_be_read, refuse};
use crate::SceneError;

/// The name that the file has in most data sets.
pub(super) const USUAL_NAME: &str = "transforms.json";

/// Longest file that is read: a million frames take less.
const MOST_BYTES: u64 = 1 << 30;

/// Names of `camera_model` whose distortion is radial and tangential.
const MODELS: [&str; 5] = ["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"];

/// What describes a lens: at the top for all frames, or in a frame.
#[derive(Default, Deserialize)]
struct LensTable {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
}

#[derive(Deserialize)]
struct FrameTable {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
}

pub(super) fn read(path: &Path) -> Result<CameraSet, SceneError> {
    let bytes = antirad_base::input::read_at_most(path, MOST_BYTES).map_err(cannot_be_read(path))?;
    let whole: Value = serde_json::from_slice(&bytes).map_err(|error| SceneError::Line {
        path: path.to_path_buf(),
        line: error.line().max(1),
        message: no_json(&bytes, &error),
    })?;
    let Some(frames) = whole.get("frames") else {
        return Err(refuse(
            path,
            "it has no `frames`; give a transforms.json, whose frames have file_path and transform_matrix",
        ));
    };
    let Some(frames) = frames.as_array() else {
        return Err(refuse(
            path,
            "its `frames` are no list; give a list of frames with file_path and transform_matrix",
        ));
    };
    let shared = LensTable::deserialize(&whole).map_err(|error| refuse(path, error.to_string()))?;
    let frame = |(number, value): (usize, &Value)| {
        frame(value, &shared).map_err(|message| {
            let name = value.get("file_path").and_then(Value::as_str).map(|name| format!(" (\"{name}\")"));
            refuse(path, format!("frame {number}{}, from 0: {message}", name.unwrap_or_default()))
        })
    };
    let frames = frames.iter().enumerate().map(frame).collect::<Result<_, _>>()?;
    let pictures = path.parent().unwrap_or(Path::new("")).to_path_buf();
    Ok(CameraSet { path: path.to_path_buf(), pictures, frames })
}

/// The message for text that is no JSON. Programs in Python write NaN, which JSON has not.
fn no_json(bytes: &[u8], error: &serde_json::Error) -> String {
    let line = bytes.split(|&byte| byte == b'\n').nth(error.line().saturating_sub(1)).unwrap_or_default();
    match ["NaN", "Infinity"].iter().find(|word| line.windows(word.len()).any(|part| part == word.as_bytes()))
    {
        Some(word) => format!("{word} is no number of JSON; correct the frame's matrix, or remove the frame"),
        None => format!("it is no JSON: {error}; write it again"),
    }
}

fn frame(value: &Value, shared: &LensTable) -> Result<Frame, String> {
    let needed = ["file_path", "transform_matrix"];
    if let Some(key) = needed.iter().find(|key| value.get(**key).is_none()) {
        return Err(format!("it has no `{key}`; add it, or remove the frame"));
    }
    let own = LensTable::deserialize(value).map_err(|error| error.to_string())?;
    let FrameTable { file_path, transform_matrix } =
        FrameTable::deserialize(value).map_err(|error| error.to_string())?;
    // Programs on Windows write their own separators.
    let file_path = PathBuf::from(file_path.replace('\\', "/"));
    if file_path.file_name().is_none() {
        return Err("its file_path names no file; give that of its picture".to_owned());
    }
    let intrinsics = intrinsics(&own, shared)?;
    let [right, up, backward, position] =
        affine(&transform_matrix).map_err(|message| format!("transform_matrix: {message}"))?;
    Frame::new(file_path, position, [right, up, -backward], intrinsics)
        .map_err(|message| format!("transform_matrix: {message}"))
}

/// The lens of a frame: its own values before those of the file.
fn intrinsics(own: &LensTable, shared: &LensTable) -> Result<Intrinsics, String> {
    if let Some(model) = own.camera_model.as_ref().or(shared.camera_model.as_ref())
        && !MODELS.contains(&model.as_str())
    {
        return Err(format!(
            "camera_model {model} is not read, only {}; undistort the pictures first, for example with `colmap image_undistorter`",
            MODELS.join(", ")
        ));
    }
    let either = |of: fn(&LensTable) -> Option<f64>| of(own).or(of(shared));
    if own.is_fisheye.or(shared.is_fisheye) == Some(true)
        || either(|lens| lens.k4).is_some_and(|k4| k4 != 0.0)
    {
        return Err("fisheye lenses (is_fisheye, k4) are not read; undistort the pictures first".to_owned());
    }
    let side = |what: &str, of: fn(&LensTable) -> Option<f64>| match either(of) {
        None => Ok(None),
        Some(pixels) if pixels.fract() == 0.0 && (1.0..=65536.0).contains(&pixels) => Ok(Some(pixels as u32)),
        Some(pixels) => Err(format!("{what} is {pixels}; it must be a whole number of pixels, 1 to 65536")),
    };
    let coefficient = |of: fn(&LensTable) -> Option<f64>| either(of).unwrap_or(0.0);
    let intrinsics = Intrinsics {
        focal: match focal(own, shared.fl_y) {
            Focal::Unknown => focal(shared, own.fl_y),
            focal => focal,
        },
        width: side("w", |lens| lens.w)?,
        height: side("h", |lens| lens.h)?,
        centre_x: either(|lens| lens.cx),
        centre_y: either(|lens| lens.cy),
        distortion: Distortion {
            k1: coefficient(|lens| lens.k1),
            k2: coefficient(|lens| lens.k2),
            k3: coefficient(|lens| lens.k3),
            p1: coefficient(|lens| lens.p1),
            p2: coefficient(|lens| lens.p2),
        },
    };
    // What does not depend on the picture is wrong at once.
    let size = intrinsics.size();
    if size.is_some() || intrinsics.focal == Focal::Unknown {
        intrinsics.lens(size.unwrap_or([1, 1]))?;
    }
    Ok(intrinsics)
}

/// The focal length that one table states; the vertical one of the other goes with a horizontal one in pixels.
fn focal(table: &LensTable, other_y: Option<f64>) -> Focal {
    let LensTable { camera_angle_x, camera_angle_y, fl_x, fl_y, .. } = *table;
    match (fl_x, camera_angle_x, fl_y, camera_angle_y) {
        (Some(x), ..) => Focal::Pixels(DVec2::new(x, fl_y.or(other_y).unwrap_or(x))),
        (None, Some(angle), ..) => Focal::AngleX(angle),
        (None, None, Some(y), _) => Focal::Pixels(DVec2::splat(y)),
        (None, None, None, Some(angle)) => Focal::AngleY(angle),
        (None, None, None, None) => Focal::Unknown,
    }
}
