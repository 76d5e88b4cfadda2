//! The nearest face at every sample, band by band, by a kernel.

use crate::image::bands::{Band, Grid};
use crate::image::faces::{Face, NONE};
use crate::image::projection::Projected;
use crate::image::tiles::{TileLists, Tiles, max_pairs};
use antirad_core::shaders;
use antirad_gpu::{Buffer, BufferKind, Device, GpuError, Pipeline, rounded};
use bytemuck::{Pod, Zeroable};

/// Bytes of both staging buffers of a picture together. They are separate from those of engines, so that the memory of a picture
/// does not depend on theirs.
const STAGING: u64 = 1 << 20;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Push {
    width: u32,
    height: u32,
    first_row: u32,
    rows: u32,
    side: u32,
}

pub fn pipeline(device: &Device) -> Result<Pipeline, GpuError> {
    Pipeline::new(device, &shaders::VISIBILITY, 6, size_of::<Push>() as u32, &[])
}

/// The samples of one band at a time.
pub struct Visibility {
    device: Device,
    pipeline: Pipeline,
    grid: Grid,
    tile_start: Buffer,
    tile_faces: Buffer,
    faces: Buffer,
    numbers: Buffer,
    depths: Buffer,
    samples: Buffer,
}

impl Visibility {
    /// Allocates the buffers for scenes of at most this many triangles, with staging buffers of its own.
    ///
    /// # Errors
    /// Fails if the device cannot allocate a buffer.
    pub fn new(device: &Device, pipeline: &Pipeline, grid: Grid, triangles: u64) -> Result<Self, GpuError> {
        let device = device.scope(STAGING);
        let buffer = |label, bytes| Buffer::new(&device, label, bytes, BufferKind::Storage);
        let [start, lists, faces, numbers, depths, samples] = sizes(&grid, triangles);
        Ok(Self {
            pipeline: pipeline.clone(),
            grid,
            tile_start: buffer("picture tiles", start)?,
            tile_faces: buffer("picture tiles", lists)?,
            faces: buffer("picture faces", faces)?,
            numbers: buffer("picture faces", numbers)?,
            depths: buffer("picture depths", depths)?,
            samples: buffer("picture samples", samples)?,
            device,
        })
    }

    /// The face of each sample of a band of the picture of `faces`, row by row; `NONE` outside the `wanted` tiles.
    ///
    /// # Errors
    /// Fails if the device fails.
    pub fn samples(&self, band: Band, faces: &[Projected], wanted: &Tiles) -> Result<Vec<u32>, GpuError> {
        let Grid { width, height, side, .. } = self.grid;
        let bytes = u64::from(width) * u64::from(band.rows) * 4;
        let mut batch = self.device.batch()?;
        // Infinitely far.
        batch.fill(&self.depths, 0, bytes, 0)?;
        batch.fill(&self.samples, 0, bytes, NONE)?;
        batch.submit()?;

        let push = Push { width, height, first_row: band.first_row, rows: band.rows, side };
        let groups = [self.grid.tile_columns(), band.tile_rows().len() as u32, 1];
        let shape = format!("{width}x{}", band.rows);
        let mut first = 0;
        while first < faces.len() {
            let (lists, next) = TileLists::build(&self.grid, band, faces, first, wanted);
            first = next;
            if lists.faces.is_empty() {
                continue;
            }
            let listed = || lists.faces.iter().map(|&face| &faces[face as usize]);
            self.device.upload_slice(&self.tile_start, 0, &lists.tile_start)?;
            self.device.upload_slice(&self.tile_faces, 0, &lists.tile_faces)?;
            self.device.upload_slice(&self.faces, 0, &listed().map(Face::from).collect::<Vec<_>>())?;
            self.device.upload_slice(
                &self.numbers,
                0,
                &listed().map(|face| face.number).collect::<Vec<_>>(),
            )?;
            let buffers =
                [&self.tile_start, &self.tile_faces, &self.faces, &self.numbers, &self.depths, &self.samples];
            let mut batch = self.device.batch()?;
            let push = bytemuck::bytes_of(&push);
            batch.dispatch(&self.pipeline, &shape, &buffers.map(Buffer::whole), push, groups)?;
            batch.submit()?;
        }
        self.device.download_slice(&self.samples, 0, u64::from(width) * u64::from(band.rows))
    }
}

/// Exact bytes of device memory that the picture of a scene of this many triangles takes, staging buffers included.
pub fn bytes(grid: &Grid, triangles: u64) -> u64 {
    STAGING + sizes(grid, triangles).into_iter().map(rounded).sum::<u64>()
}

/// Bytes of each buffer, in the order of the kernel's bindings.
fn sizes(grid: &Grid, triangles: u64) -> [u64; 6] {
    let pairs = max_pairs(grid.band_tiles(), triangles);
    let faces = triangles.min(pairs);
    let samples = grid.band_samples() * 4;
    [(grid.band_tiles() + 1) * 4, pairs * 4, faces * size_of::<Face>() as u64, faces * 4, samples, samples]
}
