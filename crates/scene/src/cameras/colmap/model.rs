//! COLMAP's models of lenses.

use glam::DVec2;

use super::super::{Distortion, Focal, Intrinsics};

/// Names of the models by their numbers in binary files.
pub(super) const NAMES: [&str; 12] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
];

/// How many parameters a model has. Says that it is not read, if so.
pub(super) fn parameters(model: &str) -> Result<usize, String> {
    match model {
        "SIMPLE_PINHOLE" => Ok(3),
        "PINHOLE" | "SIMPLE_RADIAL" => Ok(4),
        "RADIAL" => Ok(5),
        "OPENCV" => Ok(8),
        other => Err(format!(
            "the model {other} is not read, only SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL and OPENCV; undistort pictures and \
             cameras with `colmap image_undistorter`, and give its folder"
        )),
    }
}

/// The lens of a model with as many parameters as [`parameters`] says. Says what is wrong with it.
pub(super) fn intrinsics(model: &str, size: [u64; 2], given: &[f64]) -> Result<Intrinsics, String> {
    let wanted = parameters(model)?;
    if given.len() != wanted {
        return Err(format!(
            "the model {model} has {wanted} parameters, but {} are given; correct them",
            given.len()
        ));
    }
    let none = Distortion::default();
    let (focal, centre, distortion) = match (model, given) {
        ("PINHOLE", &[fx, fy, cx, cy]) => (DVec2::new(fx, fy), [cx, cy], none),
        ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => (DVec2::splat(f), [cx, cy], Distortion { k1, ..none }),
        ("RADIAL", &[f, cx, cy, k1, k2]) => (DVec2::splat(f), [cx, cy], Distortion { k1, k2, ..none }),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            (DVec2::new(fx, fy), [cx, cy], Distortion { k1, k2, p1, p2, ..none })
        }
        // SIMPLE_PINHOLE: no other has three.
        (_, &[f, cx, cy]) => (DVec2::splat(f), [cx, cy], none),
        (model, _) => return Err(format!("the model {model} is not read")),
    };
    let side = |pixels: u64| u32::try_from(pixels).unwrap_or(u32::MAX);
    let [width, height] = size.map(side);
    let intrinsics = Intrinsics {
        focal: Focal::Pixels(focal),
        width: Some(width),
        height: Some(height),
        centre_x: Some(centre[0]),
        centre_y: Some(centre[1]),
        distortion,
    };
    intrinsics.lens([width, height])?;
    Ok(intrinsics)
}
