//! Target of a view: a picture, its camera, and which of its pixels count.

use super::exposure::Exposure;
use super::noise::Noise;
use super::response::UnknownResponse;
use antirad_render::image::{ImageError, Label, Photo, PhotoMask};
use antirad_scene::Camera;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// A picture is not a valid target.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TargetError {
    /// A file cannot be read as a picture.
    #[error("{}: cannot be read as a picture: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the reader.
        reason: String,
    },
    #[error(
        "{what} is {got_width} x {got_height} pixels, but camera \"{camera}\" takes {width} x {height}; give it that size or a \
         whole multiple of it, or change the camera's width and height"
    )]
    /// A picture or mask differs in size from the camera's pictures.
    Size {
        /// The picture or its mask.
        what: &'static str,
        /// Width of the picture or mask, pixels.
        got_width: u32,
        /// Height of the picture or mask, pixels.
        got_height: u32,
        /// Name of the camera.
        camera: String,
        /// Width of the camera's pictures, pixels.
        width: u32,
        /// Height of the camera's pictures, pixels.
        height: u32,
    },
    /// A pixel is infinite or not a number.
    #[error(
        "the picture is {value} at column {x}, row {y} (from 0, from the top left); mask the pixel out or repair it"
    )]
    NotFinite {
        /// Column, from 0 at the left.
        x: usize,
        /// Row, from 0 at the top.
        y: usize,
        /// The value there.
        value: f64,
    },
    /// A mask has a value outside 0 to 1.
    #[error("the mask is {value} at column {x}, row {y}; it must lie in 0 to 1")]
    Mask {
        /// Column, from 0 at the left.
        x: usize,
        /// Row, from 0 at the top.
        y: usize,
        /// The value there.
        value: f64,
    },
    /// No pixel is left to compare.
    #[error("no pixel is left to compare with: the mask is 0 everywhere, or the picture all clipped")]
    Nothing,
    /// A response other than a linear one is stated for a picture of floats.
    #[error(
        "the picture has floats, which are linear radiance; `response` is for PNG, JPEG and TIFF of integers: remove it"
    )]
    Response,
    /// A weight, given here, is not finite or not above 0.
    #[error("the weight is {0}; it must be finite and above 0")]
    Weight(f64),
}

impl TargetError {
    /// The message, with the file once.
    pub(super) fn of(&self, path: &Path) -> String {
        match self {
            Self::Read { .. } => self.to_string(),
            _ => format!("{}: {self}", path.display()),
        }
    }
}

/// A validated target.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// The camera, with the picture's size.
    pub camera: Camera,
    /// Linear RGB radiance, row by row from the top, W/(m² sr).
    pub pixels: Vec<DVec3>,
    /// Weight of each pixel, 0 to 1; 1 if `None`.
    pub mask: Option<Vec<f64>>,
    /// Weight of this view relative to the others.
    pub weight: f64,
    /// Value from which on a channel of a pixel is only a lower bound: the picture is clipped there.
    pub clip: Option<f64>,
    /// Pixels that are lower bounds altogether, as they are means of pixels of which some are clipped; `None`: none.
    #[doc(hidden)]
    pub bounds: Option<Vec<bool>>,
    /// What of the relation between radiance and the picture's numbers is unknown.
    pub exposure: Exposure,
    /// The response of the camera, if it is unknown.
    #[doc(hidden)]
    pub response: Option<UnknownResponse>,
    /// How bright the camera's settings make the picture, up to a factor that pictures of one camera share: exposure time in seconds times
    /// ISO over the square of the f-number, where the file of a photograph has them.
    #[doc(hidden)]
    pub exposure_guess: Option<f64>,
    /// Noise of the picture, in its unit: where it is large, the losses [`LossKind::Huber`](super::LossKind::Huber) and
    /// [`LossKind::RelativeL2`](super::LossKind::RelativeL2) count differences for less. `None`: they know of none.
    pub noise: Option<Noise>,
    /// The set of photographs that it is of; `None`: it is alone.
    #[doc(hidden)]
    pub set: Option<String>,
    /// What segmentation says that each pixel shows ([`segments`](super::segments)); `None` if it says nothing.
    #[doc(hidden)]
    pub labels: Option<Vec<Option<Label>>>,
}

impl Target {
    /// A target from its parts, validated. Masked pixels may hold any value.
    ///
    /// # Errors
    /// Fails if the size of the picture or mask is not the camera's, if a mask value is outside 0 to 1, if
    /// the weight is not positive and finite, if no pixel counts, or if one that counts is not finite.
    pub fn new(
        camera: Camera,
        pixels: Vec<DVec3>,
        mask: Option<Vec<f64>>,
        weight: f64,
    ) -> Result<Self, TargetError> {
        let width = camera.width as usize;
        let expected = width * camera.height as usize;
        let size = |what, got: usize| TargetError::Size {
            what,
            got_width: got as u32,
            got_height: 1,
            camera: camera.name.clone(),
            width: camera.width,
            height: camera.height,
        };
        if pixels.len() != expected {
            return Err(size("the picture", pixels.len()));
        }
        if let Some(mask) = &mask {
            if mask.len() != expected {
                return Err(size("the mask", mask.len()));
            }
            if let Some(at) = mask.iter().position(|m| !(0.0..=1.0).contains(m)) {
                return Err(TargetError::Mask { x: at % width, y: at / width, value: mask[at] });
            }
        }
        if !(weight > 0.0 && weight.is_finite()) {
            return Err(TargetError::Weight(weight));
        }
        let target = Self {
            camera,
            pixels,
            mask,
            weight,
            clip: None,
            bounds: None,
            exposure: Exposure::default(),
            response: None,
            exposure_guess: None,
            noise: None,
            set: None,
            labels: None,
        };
        if target.mask_sum() == 0.0 {
            return Err(TargetError::Nothing);
        }
        let bad = |at: &usize| target.mask_at(*at) > 0.0 && !target.pixels[*at].is_finite();
        if let Some(at) = (0..expected).find(bad) {
            let value = target.pixels[at].to_array().into_iter().find(|v| !v.is_finite()).unwrap_or(f64::NAN);
            return Err(TargetError::NotFinite { x: at % width, y: at / width, value });
        }
        Ok(target)
    }

    /// This target with values that are lower bounds from `clip` on.
    #[doc(hidden)]
    pub fn clipped_from(self, clip: f64) -> Self {
        Self { clip: Some(clip), ..self }
    }

    /// This target with an exposure to be fitted.
    #[doc(hidden)]
    pub fn exposed(self, exposure: Exposure) -> Self {
        Self { exposure, ..self }
    }

    /// This target with a response to be fitted.
    #[doc(hidden)]
    pub fn responding(self, response: UnknownResponse) -> Self {
        Self { response: Some(response), ..self }
    }

    /// This target with such a noise.
    #[doc(hidden)]
    pub fn noisy(self, noise: Noise) -> Self {
        Self { noise: Some(noise), ..self }
    }

    /// Whether a channel of a pixel, of this value, is only a lower bound.
    #[doc(hidden)]
    pub fn is_bound(&self, pixel: usize, expected: f64) -> bool {
        let is_mean_of_clipped = || self.bounds.as_ref().is_some_and(|bounds| bounds[pixel]);
        self.clip.is_some_and(|clip| expected >= clip) || is_mean_of_clipped()
    }

    /// Whether the expected value of a channel of a pixel is only a lower bound, and a value is not below it.
    #[doc(hidden)]
    pub fn keeps_bound(&self, pixel: usize, value: f64, expected: f64) -> bool {
        value >= expected && self.is_bound(pixel, expected)
    }

    /// This target with means over blocks of `factor` x `factor` pixels, weighted by the mask. A mean is a lower bound if a pixel of its block
    /// is one. Rows and columns are a multiple of the factor.
    pub(super) fn averaged(&self, factor: u32) -> Self {
        if factor == 1 {
            return self.clone();
        }
        let width = self.camera.width as usize;
        let camera = Camera {
            width: self.camera.width / factor,
            height: self.camera.height / factor,
            ..self.camera.clone()
        };
        let factor = factor as usize;
        let block = |index: usize| {
            let (row, column) = (index / camera.width as usize, index % camera.width as usize);
            let pixel = move |k: usize| (row * factor + k / factor) * width + column * factor + k % factor;
            (0..factor * factor).map(pixel).filter(|&at| self.mask_at(at) > 0.0)
        };
        let weight = |index: usize| block(index).map(|at| self.mask_at(at)).sum::<f64>();
        let mean = |index: usize| {
            let sum: DVec3 = block(index).map(|at| self.mask_at(at) * self.pixels[at]).sum();
            if weight(index) > 0.0 { sum / weight(index) } else { DVec3::ZERO }
        };
        let has_bound = |index: usize| {
            block(index)
                .any(|at| self.pixels[at].to_array().into_iter().any(|value| self.is_bound(at, value)))
        };
        let pixels = camera.width as usize * camera.height as usize;
        let of_block = (factor * factor) as f64;
        Self {
            pixels: (0..pixels).map(mean).collect(),
            mask: self.mask.as_ref().map(|_| (0..pixels).map(|index| weight(index) / of_block).collect()),
            bounds: self.clip.map(|_| (0..pixels).map(has_bound).collect()),
            camera,
            weight: self.weight,
            clip: self.clip,
            exposure: self.exposure,
            response: self.response,
            exposure_guess: self.exposure_guess,
            noise: self.noise.map(|noise| noise.of_means(of_block)),
            set: self.set.clone(),
            // Which triangles share a value is known by then.
            labels: None,
        }
    }

    /// Weight of a pixel, from the mask.
    #[doc(hidden)]
    pub fn mask_at(&self, pixel: usize) -> f64 {
        self.mask.as_ref().map_or(1.0, |mask| mask[pixel])
    }

    /// Sum of the weights of all pixels.
    #[doc(hidden)]
    pub fn mask_sum(&self) -> f64 {
        self.mask.as_ref().map_or(self.pixels.len() as f64, |mask| mask.iter().sum())
    }
}

/// A picture from a file, for [`Target::new`].
#[derive(Clone, Debug, PartialEq)]
pub struct TargetPicture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear RGB, W/(m² sr), row by row from the top.
    pub pixels: Vec<DVec3>,
    /// Per pixel, whether it is clipped at the maximum of the file's format, so that its value is only a lower bound.
    #[doc(hidden)]
    pub clipped: Vec<bool>,
}

impl TargetPicture {
    /// Reads an EXR, or a PNG, JPEG, TIFF or Radiance HDR; JPEG upright, as its EXIF data say.
    ///
    /// Float formats are linear. Integer ones are decoded from sRGB to linear, and their white becomes radiance `white`, W/(m² sr); an
    /// alpha channel is ignored.
    ///
    /// # Errors
    /// Fails if the file cannot be read, is in no known format, or is an EXR with several layers, none of them without a name.
    pub fn read(path: &Path, white: f64) -> Result<Self, TargetError> {
        Self::read_layer(path, white, None)
    }

    /// Reads a layer of an EXR, such as `ViewLayer.Combined`.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or has no such layer.
    #[doc(hidden)]
    pub fn read_layer(path: &Path, white: f64, layer: Option<&str>) -> Result<Self, TargetError> {
        let photo = Photo::read(path, layer).map_err(unreadable)?;
        Ok(Self {
            width: photo.width,
            height: photo.height,
            pixels: radiance(&photo, white),
            clipped: photo.clipped,
        })
    }

    /// Checks that the picture has the size of the camera's pictures.
    ///
    /// # Errors
    /// Fails if the size differs.
    #[doc(hidden)]
    pub fn check_size(&self, camera: &Camera) -> Result<(), TargetError> {
        match (self.width, self.height) == (camera.width, camera.height) {
            true => Ok(()),
            false => Err(wrong_size("the picture", [self.width, self.height], camera)),
        }
    }
}

/// Reads a mask of a camera's size, or averages one of a multiple of it: the values of a picture from 0 (black) to 1 (white), not
/// decoded, or the red channel of a float format.
///
/// # Errors
/// Fails if the file cannot be read, is in no known format, or if its size is no multiple of that of the camera's
/// pictures.
pub fn read_mask(path: &Path, camera: &Camera) -> Result<Vec<f64>, TargetError> {
    let mask = open_mask(path)?;
    let fitting = mask.averaged(camera.width, camera.height);
    let fitting = fitting.ok_or_else(|| wrong_size("the mask", [mask.width, mask.height], camera))?;
    Ok(weights(&fitting))
}

/// Reads a mask and checks its values, which means would hide.
pub(super) fn open_mask(path: &Path) -> Result<PhotoMask, TargetError> {
    let mask = PhotoMask::read(path).map_err(unreadable)?;
    if let Some(at) = mask.values.iter().position(|value| !(0.0..=1.0).contains(value)) {
        let width = mask.width as usize;
        return Err(TargetError::Mask { x: at % width, y: at / width, value: mask.values[at].into() });
    }
    Ok(mask)
}

pub(super) fn weights(mask: &PhotoMask) -> Vec<f64> {
    mask.values.iter().map(|&value| value.into()).collect()
}

/// The radiance of a picture, with that of white in an integer format.
pub(super) fn radiance(photo: &Photo, white: f64) -> Vec<DVec3> {
    let factor = if photo.ends_at_white { white } else { 1.0 };
    photo.pixels.iter().map(|pixel| factor * DVec3::from(pixel.map(f64::from))).collect()
}

pub(super) fn unreadable(error: ImageError) -> TargetError {
    match error {
        ImageError::Photo { path, reason } => TargetError::Read { path, reason },
        other => TargetError::Read { path: PathBuf::new(), reason: other.to_string() },
    }
}

pub(super) fn wrong_size(
    what: &'static str,
    [got_width, got_height]: [u32; 2],
    camera: &Camera,
) -> TargetError {
    let &Camera { width, height, .. } = camera;
    TargetError::Size { what, got_width, got_height, camera: camera.name.clone(), width, height }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_render::image::{Exposure, Picture, ToneMap};

    fn camera(width: u32, height: u32) -> Camera {
        Camera { width, height, ..Camera::framing(&[]) }
    }

    /// A picture written as PNG by this crate is read back to within quantisation.
    #[test]
    fn png_is_decoded_to_linear() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("p.PNG");
        let pixels: Vec<[f32; 4]> = (0..256).map(|i| [i as f32 / 300.0, 0.001, 0.5, 1.0]).collect();
        let picture = Picture { width: 16, height: 16, pixels };
        picture.write_png(&path, &ToneMap::default().exposure(Exposure::Stops(0.0))).expect("written");
        let read = TargetPicture::read(&path, 3.0).expect("read");
        assert_eq!((read.width, read.height), (16, 16));
        assert!(read.clipped.iter().all(|clipped| !clipped));
        for (ours, theirs) in read.pixels.iter().zip(&picture.pixels) {
            let truth = 3.0 * DVec3::new(theirs[0].into(), theirs[1].into(), theirs[2].into());
            assert!((*ours - truth).abs().max_element() < 3.0 * 0.005, "{ours} {truth}");
        }
        let mask = read_mask(&path, &camera(16, 16)).expect("a mask");
        assert!(mask.iter().all(|m| (0.0..=1.0).contains(m)) && mask[200] > mask[3]);
    }

    #[test]
    fn means_over_blocks_of_pixels() {
        let grey = |value: f64| DVec3::splat(value);
        let pixels = [1.0, 2.0, 3.0, f64::NAN, 5.0, 6.0, 7.0, 9.0].map(grey).to_vec();
        let mask = vec![1.0, 1.0, 1.0, 0.0, 0.5, 0.5, 1.0, 0.0];
        let target = Target::new(camera(4, 2), pixels, Some(mask), 2.0).expect("a target").clipped_from(6.0);
        let small = target.averaged(2);
        assert_eq!((small.camera.width, small.camera.height, small.weight), (2, 1, 2.0));
        assert_eq!(small.pixels, [grey((1.0 + 2.0 + 2.5 + 3.0) / 3.0), grey(5.0)]);
        assert_eq!((small.mask, small.bounds), (Some(vec![0.75, 0.5]), Some(vec![true, true])));
        let dark = target.clone().clipped_from(6.5).averaged(2);
        assert_eq!(dark.bounds, Some(vec![false, true]));
        assert_eq!(target.averaged(1).camera, target.camera);
    }

    #[test]
    fn what_cannot_be_a_target() {
        let one = |pixel: DVec3, mask: Option<f64>, weight: f64| {
            Target::new(camera(1, 1), vec![pixel], mask.map(|m| vec![m]), weight).map_err(|e| e.to_string())
        };
        assert!(one(DVec3::ONE, None, 1.0).is_ok());
        for (result, part) in [
            (one(DVec3::NAN, None, 1.0), "NaN at column 0, row 0"),
            (one(DVec3::new(0.0, f64::INFINITY, 0.0), Some(1.0), 1.0), "inf at column 0"),
            (one(DVec3::NAN, Some(0.0), 1.0), "no pixel is left"),
            (one(DVec3::ONE, Some(1.5), 1.0), "mask is 1.5 at column 0, row 0"),
            (one(DVec3::ONE, Some(f64::NAN), 1.0), "mask is NaN"),
            (one(DVec3::ONE, None, 0.0), "weight is 0"),
            (Target::new(camera(2, 1), vec![], None, 1.0).map_err(|e| e.to_string()), "takes 2 x 1"),
        ] {
            let message = result.expect_err(part);
            assert!(message.contains(part), "{message}");
        }
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("p.png");
        std::fs::write(&path, "no picture").expect("written");
        for (path, part) in [
            (path.clone(), "none of EXR, PNG"),
            (path.with_extension("exr"), "cannot be read"),
            (folder.path().join("none.jpg"), "No such file"),
        ] {
            let message = TargetPicture::read(&path, 1.0).expect_err(part).to_string();
            assert!(message.contains(part) && message.contains(&path.display().to_string()), "{message}");
            assert!(read_mask(&path, &camera(1, 1)).is_err());
        }
    }
}
