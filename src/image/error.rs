//! What can go wrong between a scene and a picture's file.

use std::path::PathBuf;

use super::MAX_SUPERSAMPLE;
use crate::gpu::GpuError;
use crate::output::OutputError;
use crate::scene::SceneError;

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    #[error(transparent)]
    Gpu(#[from] GpuError),

    /// The camera cannot take pictures, or the scene cannot be shown.
    #[error(transparent)]
    Scene(#[from] SceneError),

    #[error("supersample = {0} must be a power of two, at most {MAX_SUPERSAMPLE}")]
    Supersample(u32),

    #[error("{given} colours for {wanted} triangles; give one per triangle, in the scene's order")]
    Colours { given: usize, wanted: usize },

    #[error("a cotangent of {given} pixels for a picture of {wanted}; give one per pixel")]
    CotangentLength { given: usize, wanted: usize },

    #[error("the cotangent of pixel {pixel} is not finite")]
    CotangentNotFinite { pixel: usize },

    #[error(
        "a picture of {width} x {height} with {pixels} pixels cannot be written; give it width x height of them"
    )]
    Size { width: u32, height: u32, pixels: usize },

    #[error(transparent)]
    Write(#[from] OutputError),

    #[error("{}: cannot be read as an EXR picture: {reason}", path.display())]
    Read { path: PathBuf, reason: String },
}
