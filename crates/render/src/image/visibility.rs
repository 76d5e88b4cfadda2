//! The nearest face at every sample, by the backend.

use super::bands::{Band, Grid};
use super::projection::Projected;
use super::tiles::Tiles;
use super::{cpu, vulkan};
use antirad_core::backend::{Backend, BackendKind};
use antirad_gpu::{Device, GpuError, Pipeline};

/// Finds what is visible, on one of the backends.
#[derive(Clone, Debug)]
pub(super) enum Finder {
    Vulkan(Device, Pipeline),
    Cpu,
}

/// Finds what is visible in pictures of one grid, with the memory that this takes.
#[expect(clippy::large_enum_variant, reason = "there is one of them at a time")]
pub(super) enum Visibility {
    Vulkan(vulkan::visibility::Visibility),
    Cpu(Grid),
}

impl Finder {
    pub fn new(backend: &Backend) -> Result<Self, GpuError> {
        Ok(match backend {
            Backend::Vulkan(device) => Self::Vulkan(device.clone(), vulkan::visibility::pipeline(device)?),
            Backend::Cpu(_) => Self::Cpu,
        })
    }

    /// Prepares pictures of a grid, for scenes of at most this many triangles.
    ///
    /// # Errors
    /// Fails if the device cannot allocate the buffers.
    pub fn on(&self, grid: Grid, triangles: u64) -> Result<Visibility, GpuError> {
        Ok(match self {
            Self::Vulkan(device, pipeline) => {
                let of_grid = vulkan::visibility::Visibility::new(device, pipeline, grid, triangles)?;
                Visibility::Vulkan(of_grid)
            }
            Self::Cpu => Visibility::Cpu(grid),
        })
    }
}

/// Bytes of a backend's budget that the pictures of a grid take. On the CPU bands are not counted.
pub(super) fn bytes(backend: BackendKind, grid: &Grid, triangles: u64) -> u64 {
    match backend {
        BackendKind::Vulkan => vulkan::visibility::bytes(grid, triangles),
        BackendKind::Cpu => 0,
    }
}

impl Visibility {
    /// The face of each sample of a band of the picture of `faces`, row by row; `NONE` outside the `wanted` tiles.
    ///
    /// # Errors
    /// Fails if the device fails.
    pub fn samples(&self, band: Band, faces: &[Projected], wanted: &Tiles) -> Result<Vec<u32>, GpuError> {
        match self {
            Self::Vulkan(of_grid) => of_grid.samples(band, faces, wanted),
            Self::Cpu(grid) => Ok(cpu::visibility::samples(grid, band, faces, wanted)),
        }
    }
}
