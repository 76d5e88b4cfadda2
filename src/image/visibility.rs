//! The nearest face at every sample, band by band, on the device.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::bands::{Band, Grid};
use super::projection::{Projected, View};
use super::tiles::{TileLists, Tiles, max_pairs};
use super::visibility_on_host;
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::scene::{Camera, Scene, SceneError};
use crate::shaders;

/// Stands for a face in the background.
pub(super) const NONE: u32 = u32::MAX;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Push {
    width: u32,
    height: u32,
    first_row: u32,
    rows: u32,
}

/// A face as the kernel reads it: the coefficients of its three edge functions, each with one coefficient of the inverse depth.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct Face {
    pub edges: [[f32; 4]; 3],
}

impl From<&Projected> for Face {
    fn from(face: &Projected) -> Self {
        let depth = face.inverse_depth.to_array();
        Self { edges: [0, 1, 2].map(|i| face.edges[i].extend(depth[i]).as_vec4().to_array()) }
    }
}

pub(super) fn pipeline(device: &Device) -> Result<Pipeline, GpuError> {
    Pipeline::beside_host(device, &shaders::VISIBILITY, 6, size_of::<Push>() as u32, &[])
}

/// The faces that a camera may see, in the scene's order, unrounded. Fails if the scene or the camera is invalid.
pub(super) fn project(scene: &Scene, camera: &Camera) -> Result<Vec<Projected>, SceneError> {
    scene.check_geometry()?;
    camera.check()?;
    let view = View::new(camera);
    let mut skip = vec![false; scene.triangles.len()];
    for &number in &scene.degenerate {
        skip[number as usize] = true;
    }
    Ok((0..scene.triangles.len())
        .into_par_iter()
        .filter(|&number| !skip[number])
        .filter_map(|number| view.project(number as u32, scene.corners(number)))
        .collect())
}

/// The same faces prepared for the kernel.
pub(super) fn rounded(faces: Vec<Projected>) -> Vec<Projected> {
    faces.into_par_iter().map(Projected::rounded).collect()
}

/// The samples of one band at a time.
pub(super) struct Visibility<'a> {
    device: &'a Device,
    pipeline: &'a Pipeline,
    grid: Grid,
    tile_start: Buffer,
    tile_faces: Buffer,
    faces: Buffer,
    numbers: Buffer,
    depths: Buffer,
    samples: Buffer,
}

/// The face of each sample of a band, row by row.
pub(super) enum Samples {
    /// In the buffer of [`Visibility`].
    OnDevice,
    OnHost(Vec<u32>),
}

impl<'a> Visibility<'a> {
    /// For scenes of at most this many triangles.
    pub fn new(
        device: &'a Device,
        pipeline: &'a Pipeline,
        grid: Grid,
        triangles: u64,
    ) -> Result<Self, GpuError> {
        let buffer = |label, bytes| Buffer::new(device, label, bytes, BufferKind::Storage);
        let [start, lists, faces, numbers, depths, samples] = sizes(&grid, triangles);
        Ok(Self {
            device,
            pipeline,
            grid,
            tile_start: buffer("picture tiles", start)?,
            tile_faces: buffer("picture tiles", lists)?,
            faces: buffer("picture faces", faces)?,
            numbers: buffer("picture faces", numbers)?,
            depths: buffer("picture depths", depths)?,
            samples: buffer("picture samples", samples)?,
        })
    }

    /// The samples of a band of the picture of `faces`; outside the `wanted` tiles they are empty.
    pub fn run(&self, band: Band, faces: &[Projected], wanted: &Tiles) -> Result<Samples, GpuError> {
        if self.device.host_works() {
            return Ok(Samples::OnHost(visibility_on_host::samples(&self.grid, band, faces, wanted)));
        }
        let Grid { width, height, .. } = self.grid;
        let bytes = u64::from(width) * u64::from(band.rows) * 4;
        let mut batch = self.device.batch()?;
        // Infinitely far.
        batch.fill(&self.depths, 0, bytes, 0)?;
        batch.fill(&self.samples, 0, bytes, NONE)?;
        batch.submit()?;

        let push = Push { width, height, first_row: band.first_row, rows: band.rows };
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
            batch.dispatch(self.pipeline, &shape, &buffers.map(Buffer::whole), push, groups)?;
            batch.submit()?;
        }
        Ok(Samples::OnDevice)
    }

    /// The samples of the latest band, on the host.
    pub fn on_host(&self, band: Band, samples: Samples) -> Result<Vec<u32>, GpuError> {
        match samples {
            Samples::OnHost(samples) => Ok(samples),
            Samples::OnDevice => {
                let count = u64::from(self.grid.width) * u64::from(band.rows);
                self.device.download_slice(&self.samples, 0, count)
            }
        }
    }
}

/// Bytes of each buffer, in the order of the kernel's bindings.
pub(super) fn sizes(grid: &Grid, triangles: u64) -> [u64; 6] {
    let pairs = max_pairs(grid.band_tiles(), triangles);
    let faces = triangles.min(pairs);
    let samples = grid.band_samples() * 4;
    [(grid.band_tiles() + 1) * 4, pairs * 4, faces * size_of::<Face>() as u64, faces * 4, samples, samples]
}
