//! What can go wrong between a scene and a picture's file.

use std::path::PathBuf;

use super::MAX_SUPERSAMPLE;
use crate::gpu::GpuError;
use crate::output::OutputError;
use crate::scene::SceneError;

/// Why there is no picture, or no derivative of one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The device, or a call into it, failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),

    /// The camera cannot take pictures, or the scene cannot be shown.
    #[error(transparent)]
    Scene(#[from] SceneError),

    /// The number of samples is not allowed; it holds the number.
    #[error("supersample = {0} must be a power of two, at most {MAX_SUPERSAMPLE}")]
    Supersample(u32),

    /// Colours do not fit the triangles of the scene.
    #[error("{given} colours for {wanted} triangles; give one per triangle, in the scene's order")]
    Colours {
        /// How many there are.
        given: usize,
        /// How many there should be.
        wanted: usize,
    },

    /// A cotangent does not fit the picture.
    #[error("a cotangent of {given} pixels for a picture of {wanted}; give one per pixel")]
    CotangentLength {
        /// How many there are.
        given: usize,
        /// How many there should be.
        wanted: usize,
    },

    /// A cotangent is infinite or not a number.
    #[error("the cotangent of pixel {pixel} is not finite")]
    CotangentNotFinite {
        /// Row by row from the top.
        pixel: usize,
    },

    /// The pixels of a picture do not fit its size.
    #[error(
        "a picture of {width} x {height} with {pixels} pixels cannot be written; give it width x height of them"
    )]
    Size {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// How many pixels there are.
        pixels: usize,
    },

    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] OutputError),

    /// A file is no picture that can be read.
    #[error("{}: cannot be read as an EXR picture: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What its reader says.
        reason: String,
    },
}
