//! Photographs of a set of cameras as targets.

use super::target::{Target, open_mask, unreadable, weights};
use super::target_table::{Treatment, averaged};
use antirad_render::image::{Photo, PhotoMask};
use antirad_scene::{Camera, CameraSet, Frame, Lens};
use rayon::prelude::*;
use std::path::PathBuf;

/// Photographs in memory at once: each takes up to some hundred megabytes until it is averaged.
const AT_ONCE: usize = 8;

/// The pictures of a set, and how to read them.
pub(super) struct Photographs<'a> {
    /// With the frames that are wanted, in the world of the scene.
    pub set: &'a CameraSet,
    /// Where the pictures are, if not where the set has them.
    pub folder: Option<PathBuf>,
    /// Their suffix, if not that in the set.
    pub suffix: Option<&'a str>,
    /// Path of a mask, in which `{name}` stands for the name of the frame.
    pub mask: Option<PathBuf>,
    pub layer: Option<&'a str>,
    /// By how much pictures are averaged down.
    pub shrink: u32,
    pub treatment: Treatment,
}

impl Photographs<'_> {
    /// A target for each frame, with the number of clipped pixels that are ignored. The error names the frame.
    pub fn read(&self) -> Result<Vec<(Target, usize)>, String> {
        let mut targets = Vec::with_capacity(self.set.frames.len());
        for frames in self.set.frames.chunks(rayon::current_num_threads().min(AT_ONCE)) {
            let read: Vec<_> = frames.par_iter().map(|frame| self.target(frame)).collect();
            // The first error in the order of the frames, whichever was first.
            for target in read {
                targets.push(target?);
            }
        }
        Ok(targets)
    }

    fn target(&self, frame: &Frame) -> Result<(Target, usize), String> {
        let path = self
            .set
            .picture(frame, self.folder.as_deref(), self.suffix)
            .map_err(|error| error.to_string())?;
        let named = |message: String| format!("frame \"{}\": {message}", frame.name);
        let of_file = |message: String| named(format!("{}: {message}", path.display()));
        let stated = frame.intrinsics.size();
        let photo = Photo::read_of_size(&path, self.layer, |size| {
            stated.is_none_or(|stated| same_shape(stated, size))
        })
        .map_err(|error| named(unreadable(error).to_string()))?;
        let size = [photo.width, photo.height];
        let lens = frame.intrinsics.lens(size).map_err(of_file)?;
        let camera = self.camera(frame, &lens, size).map_err(of_file)?;
        let mask = self.mask(frame, size).map_err(named)?;
        let (photo, mask) = self.seen(photo, mask.as_ref(), &lens, &camera);
        self.treatment.target(&photo, mask, camera).map_err(|error| of_file(error.to_string()))
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
    fn mask(&self, frame: &Frame, [width, height]: [u32; 2]) -> Result<Option<PhotoMask>, String> {
        let Some(pattern) = &self.mask else { return Ok(None) };
        let path = PathBuf::from(pattern.to_string_lossy().replace("{name}", &frame.name));
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

/// Whether a picture may be one of a lens: of its size, or of another that differs from its shape by less than a pixel.
fn same_shape(lens: [u32; 2], picture: [u32; 2]) -> bool {
    let [x, y] = [0, 1].map(|k| f64::from(picture[k]) / f64::from(lens[k]));
    (x - y).abs() * f64::from(lens[0].max(lens[1])) <= 1.0
}
