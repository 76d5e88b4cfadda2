//! Photographs of a set of cameras as targets.

use super::noise::Noise;
use super::response::Response;
use super::segments::check_number;
use super::target::{Target, open_mask, unreadable, weights};
use super::target_table::{Treatment, averaged};
use antirad_base::parallel;
use antirad_base::setters;
use antirad_render::image::{Photo, PhotoLabels, PhotoMask};
use antirad_scene::{Camera, CameraSet, Frame, Lens, SceneError};
use std::path::{Path, PathBuf};

/// Photographs in memory at once: each takes up to some hundred megabytes until it is averaged.
const AT_ONCE: usize = 8;

/// The largest number by which pictures are averaged down.
const MOST_SHRUNK: f64 = 1024.0;

/// Pixels of all pictures of a set to which they are averaged down unless another number is stated.
pub const USUAL_PIXELS: usize = 2_000_000;

/// The pictures of a set, and how to read them.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Photographs {
    /// With the frames that are wanted, in the world of the scene.
    pub set: CameraSet,
    /// Where the pictures are, if not where the set has them.
    pub images: Option<PathBuf>,
    /// Their suffix, if not that in the set.
    pub suffix: Option<String>,
    /// Path of a mask, in which `{name}` stands for the name of the frame.
    pub mask: Option<PathBuf>,
    /// Path of a segmentation picture, in which `{name}` stands for the name of the frame: one colour for each material.
    pub segments: Option<PathBuf>,
    /// Layer of EXR files.
    pub layer: Option<String>,
    /// By how much pictures are averaged down along both sides.
    pub shrink: u32,
    pub(super) treatment: Treatment,
}

setters!(Photographs {
    images: Option<PathBuf>,
    suffix: Option<String>,
    mask: Option<PathBuf>,
    segments: Option<PathBuf>,
    layer: Option<String>,
    shrink: u32,
});

impl Photographs {
    /// All pictures of a set as they are, with exposures and white balances to be fitted where they are integers.
    pub fn new(set: CameraSet) -> Self {
        let treatment = Treatment::of_photographs();
        Self {
            set,
            images: None,
            suffix: None,
            mask: None,
            segments: None,
            layer: None,
            shrink: 1,
            treatment,
        }
    }

    /// Sets the response of the camera, which all pictures share; `None`: that of sRGB in integer formats, and linear in others.
    #[must_use]
    pub fn response(mut self, response: Option<Response>) -> Self {
        self.treatment.response = response;
        self
    }

    /// Sets the noise of a pixel of the files, in units of white.
    #[must_use]
    pub fn noise(mut self, noise: Option<Noise>) -> Self {
        self.treatment.noise = noise;
        self
    }

    /// A target for each frame.
    ///
    /// # Errors
    /// Says which frame cannot be read, or does not fit its camera.
    pub fn targets(&self) -> Result<Vec<Target>, String> {
        Ok(self.read()?.into_iter().map(|(target, _)| target).collect())
    }

    /// The camera of a frame: a centred pinhole with the horizontal field of view and the size of its lens, or the size of its picture where
    /// the set states none.
    ///
    /// # Errors
    /// Fails if no size is stated and the picture cannot be read, or if the lens is invalid.
    #[doc(hidden)]
    pub fn camera_of(&self, frame: &Frame) -> Result<Camera, SceneError> {
        let refuse = |message: String| self.set.error(frame, message);
        let size = match frame.intrinsics.size() {
            Some(size) => size,
            None => Photo::size(&self.path(frame)?).map_err(|error| {
                refuse(format!("the set has no w and h, so they are those of its picture: {error}"))
            })?,
        };
        let lens = frame.intrinsics.lens(size).map_err(refuse)?;
        let camera = frame.camera(&lens, lens.width, lens.height);
        camera.check().map_err(|error| refuse(error.to_string()))?;
        Ok(camera)
    }

    /// The picture of a frame.
    fn path(&self, frame: &Frame) -> Result<PathBuf, SceneError> {
        self.set.picture(frame, self.images.as_deref(), self.suffix.as_deref())
    }

    /// A target for each frame, with the number of clipped pixels that are ignored. The error names the frame.
    pub(super) fn read(&self) -> Result<Vec<(Target, usize)>, String> {
        let mut targets = Vec::with_capacity(self.set.frames.len());
        for frames in self.set.frames.chunks(rayon::current_num_threads().min(AT_ONCE)) {
            let read = parallel::map(frames, |frame| self.target(frame));
            // The first error in the order of the frames, whichever was first.
            for target in read {
                targets.push(target?);
            }
        }
        Ok(targets)
    }

    /// The smallest whole number by which pictures are averaged down to have at most so many pixels together. Pictures that cannot be read
    /// do not count.
    #[doc(hidden)]
    pub fn shrink_to(&self, pixels: usize) -> u32 {
        let size = |frame: &Frame| {
            let of_picture = || Photo::size(&self.path(frame).ok()?).ok();
            frame.intrinsics.size().or_else(of_picture).unwrap_or_default()
        };
        let pixels_of = |frame: &Frame| size(frame).map(f64::from).iter().product::<f64>();
        let all: f64 = parallel::map(&self.set.frames, pixels_of).into_iter().sum();
        (all / pixels.max(1) as f64).sqrt().ceil().clamp(1.0, MOST_SHRUNK) as u32
    }

    fn target(&self, frame: &Frame) -> Result<(Target, usize), String> {
        let path = self.path(frame).map_err(|error| error.to_string())?;
        let named = |message: String| format!("frame \"{}\": {message}", frame.name);
        let of_file = |message: String| named(format!("{}: {message}", path.display()));
        let stated = frame.intrinsics.size();
        let photo = Photo::read_of_size(&path, self.layer.as_deref(), |size| {
            stated.is_none_or(|stated| same_shape(stated, size))
        })
        .map_err(|error| named(unreadable(error).to_string()))?;
        let photo = self.treatment.linear(photo).map_err(|error| of_file(error.to_string()))?;
        let size = [photo.width, photo.height];
        let lens = frame.intrinsics.lens(size).map_err(of_file)?;
        let camera = self.camera(frame, &lens, size).map_err(of_file)?;
        let mask = self.mask_of(frame, size).map_err(named)?;
        let labels = self.labels_of(frame, size).map_err(named)?;
        let labels = labels.map(|labels| labels.through_pinhole(&lens, camera.width, camera.height));
        let (photo, mask) = self.seen(photo, mask.as_ref(), &lens, &camera);
        let target = self.treatment.target(&photo, mask, camera, size[0]);
        let (target, ignored) = target.map_err(|error| of_file(error.to_string()))?;
        let set = Some(self.set.path.display().to_string());
        Ok((Target { labels, set, ..target }, ignored))
    }

    /// The camera of a frame, unless its picture has another shape or is too small.
    fn camera(&self, frame: &Frame, lens: &Lens, size: [u32; 2]) -> Result<Camera, String> {
        let [width, height] = size;
        let of_lens = [lens.width, lens.height];
        if !same_shape(of_lens, size) {
            return Err(format!(
                "the picture is {width} x {height} pixels, but the lens of its frame is for {} x {}; correct w and h in the set, or \
                 give its own pictures",
                of_lens[0], of_lens[1]
            ));
        }
        let shrunk = of_lens.map(|side| ((f64::from(side) / f64::from(self.shrink)).round() as u32).max(1));
        if (0..2).any(|k| size[k] + 1 < shrunk[k]) {
            let factor = (f64::from(of_lens[0]) / f64::from(width)).round();
            return Err(format!(
                "the picture is {width} x {height} pixels, smaller than the {} x {} of its target; add scale = {}",
                shrunk[0],
                shrunk[1],
                1.0 / factor.max(f64::from(self.shrink) + 1.0)
            ));
        }
        let camera = frame.camera(lens, shrunk[0], shrunk[1]);
        camera.check().map_err(|error| error.to_string())?;
        Ok(camera)
    }

    /// The mask of a frame, of the size of its picture.
    fn mask_of(&self, frame: &Frame, [width, height]: [u32; 2]) -> Result<Option<PhotoMask>, String> {
        let Some(pattern) = &self.mask else { return Ok(None) };
        let path = of_frame(pattern, frame);
        let mask = open_mask(&path).map_err(|error| error.of(&path))?;
        if (mask.width, mask.height) == (width, height) {
            return Ok(Some(mask));
        }
        Err(format!(
            "{}: the mask is {} x {} pixels, but its picture is {width} x {height}; give it that size",
            path.display(),
            mask.width,
            mask.height
        ))
    }

    /// The labels of a frame, of the size of its picture.
    fn labels_of(&self, frame: &Frame, [width, height]: [u32; 2]) -> Result<Option<PhotoLabels>, String> {
        let Some(pattern) = &self.segments else { return Ok(None) };
        let path = of_frame(pattern, frame);
        let labels = PhotoLabels::read(&path).map_err(|error| unreadable(error).to_string())?;
        if (labels.width, labels.height) != (width, height) {
            return Err(format!(
                "{}: the segmentation is {} x {} pixels, but its picture is {width} x {height}; give it that size",
                path.display(),
                labels.width,
                labels.height
            ));
        }
        check_number(labels.values.iter()).map_err(|message| format!("{}: {message}", path.display()))?;
        Ok(Some(labels))
    }

    /// What the camera sees of a photograph, and the weights of its pixels.
    fn seen(
        &self,
        photo: Photo,
        mask: Option<&PhotoMask>,
        lens: &Lens,
        camera: &Camera,
    ) -> (Photo, Option<Vec<f64>>) {
        let (width, height) = (camera.width, camera.height);
        let whole = lens.width.is_multiple_of(self.shrink) && lens.height.is_multiple_of(self.shrink);
        if whole && lens.is_centred_pinhole() {
            if (photo.width, photo.height) == (width, height) {
                return (photo, mask.map(weights));
            }
            if let Some(seen) = averaged(&photo, mask, camera) {
                return seen;
            }
        }
        let (photo, mask) = photo.through_pinhole(lens, mask, width, height);
        (photo, Some(weights(&mask)))
    }
}

/// The path that a pattern has for a frame.
fn of_frame(pattern: &Path, frame: &Frame) -> PathBuf {
    PathBuf::from(pattern.to_string_lossy().replace("{name}", &frame.name))
}

/// Whether a picture may be one of a lens: of its size, or of another that differs from its shape by less than a pixel.
fn same_shape(lens: [u32; 2], picture: [u32; 2]) -> bool {
    let [x, y] = [0, 1].map(|k| f64::from(picture[k]) / f64::from(lens[k]));
    (x - y).abs() * f64::from(lens[0].max(lens[1])) <= 1.0
}
