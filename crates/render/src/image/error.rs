//! Errors of pictures and their files.

use std::path::PathBuf;

use super::MAX_SUPERSAMPLE;
use antirad_base::output::OutputError;
use antirad_base::ranks::RankError;
use antirad_gpu::GpuError;
use antirad_scene::SceneError;

/// Why a picture, its derivative or its file could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The device, or a call into it, failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),

    /// Ranks can no longer make pictures together.
    #[error(transparent)]
    Ranks(#[from] RankError),

    /// The camera or the scene is invalid.
    #[error(transparent)]
    Scene(#[from] SceneError),

    /// The number of samples along a side of a pixel is not allowed.
    #[error("supersample = {0} must be a power of two, at most {MAX_SUPERSAMPLE}")]
    Supersample(u32),

    /// The number of colours is not that of triangles.
    #[error("{given} colours for {wanted} triangles; give one per triangle, in the scene's order")]
    Colours {
        /// Number of colours.
        given: usize,
        /// Number of triangles.
        wanted: usize,
    },

    /// The length of a cotangent is not the number of pixels.
    #[error("a cotangent of {given} pixels for a picture of {wanted}; give one entry per pixel")]
    CotangentLength {
        /// Length of the cotangent.
        given: usize,
        /// Number of pixels.
        wanted: usize,
    },

    /// A cotangent is infinite or not a number.
    #[error("the cotangent of pixel {pixel} is not finite")]
    CotangentNotFinite {
        /// Index of the pixel, row by row from the top.
        pixel: usize,
    },

    /// The number of pixels of a picture is not width times height, or zero.
    #[error(
        "a picture of {width} x {height} with {pixels} pixels cannot be written; give width x height pixels, at least one"
    )]
    Size {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Number of pixels.
        pixels: usize,
    },

    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] OutputError),

    /// A file cannot be read as a picture.
    #[error("{}: cannot be read as an EXR picture: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason, from the reader of the file.
        reason: String,
    },

    /// A file cannot be read as a picture of any format.
    #[error("{}: cannot be read as a picture: {reason}", path.display())]
    Photo {
        /// The file.
        path: PathBuf,
        /// The reason, and the remedy.
        reason: String,
    },
}

impl ImageError {
    /// Whether the same may succeed at another time, on another device, with room on the disk, or where all ranks are started again.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Gpu(error) => error.may_pass(),
            Self::Ranks(error) => error.may_pass(),
            Self::Write(_) => true,
            _ => false,
        }
    }
}
