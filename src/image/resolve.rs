//! Pixels from samples and corner colours, band by band, on the device.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::ImageError;
use super::bands::{Band, Grid};
use super::projection::{Projected, View};
use super::smooth::corner_colours;
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::scene::{Camera, Scene};
use crate::shaders;

/// Faces whose colours are on the device at a time: 12 MiB with the interpolation weights.
const PAGE: usize = 1 << 17;

/// Pixels along a side of the kernel's workgroup.
const GROUP: u32 = 8;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Push {
    width: u32,
    height: u32,
    first_row: u32,
    rows: u32,
    side: u32,
    first_face: u32,
    face_count: u32,
}

pub(super) fn pipeline(device: &Device) -> Result<Pipeline, GpuError> {
    Pipeline::new(device, &shaders::RESOLVE, 4, size_of::<Push>() as u32, &[])
}

/// Interpolated colours of each face of the scene; backs are black.
pub(super) struct Shading {
    /// Colours of the corners.
    colours: Vec<[[f32; 4]; 3]>,
    /// The functions of the picture that give their interpolation weights.
    weights: Vec<[[f32; 4]; 3]>,
}

impl Shading {
    pub fn new(
        scene: &Scene,
        camera: &Camera,
        faces: &[Projected],
        face_colours: &[[f32; 3]],
    ) -> Result<Self, ImageError> {
        let corners = corner_colours(scene, face_colours)?;
        let mut colours = vec![[[0.0; 4]; 3]; corners.len()];
        for face in faces.iter().filter(|face| face.front) {
            let number = face.number as usize;
            colours[number] = corners[number].map(|[r, g, b]| [r, g, b, 1.0]);
        }
        let view = View::new(camera);
        let weights = (0..colours.len())
            .into_par_iter()
            .map(|number| {
                let weights = view.corner_weights(scene.corners(number));
                weights.map(|weight| weight.extend(0.0).as_vec4().to_array())
            })
            .collect();
        Ok(Self { colours, weights })
    }
}

/// The pixels of one band at a time.
pub(super) struct Resolve<'a> {
    device: &'a Device,
    pipeline: &'a Pipeline,
    grid: Grid,
    colours: Buffer,
    corners: Buffer,
    pixels: Buffer,
}

impl<'a> Resolve<'a> {
    /// For scenes of at most this many triangles.
    pub fn new(
        device: &'a Device,
        pipeline: &'a Pipeline,
        grid: Grid,
        triangles: u64,
    ) -> Result<Self, GpuError> {
        let buffer = |label, bytes| Buffer::new(device, label, bytes, BufferKind::Storage);
        let [colours, corners, pixels] = sizes(&grid, triangles);
        Ok(Self {
            device,
            pipeline,
            grid,
            colours: buffer("picture colours", colours)?,
            corners: buffer("picture corners", corners)?,
            pixels: buffer("picture pixels", pixels)?,
        })
    }

    /// The pixels of a band, from its samples.
    pub fn run(&self, band: Band, samples: &Buffer, shading: &Shading) -> Result<Vec<[f32; 4]>, GpuError> {
        let Grid { side, width, height, .. } = self.grid;
        let (columns, rows) = (width / side, band.rows / side);
        let count = u64::from(columns) * u64::from(rows);
        let mut batch = self.device.batch()?;
        batch.fill(&self.pixels, 0, count * size_of::<[f32; 4]>() as u64, 0)?;
        batch.submit()?;

        let triangles = shading.colours.len();
        let groups = [columns.div_ceil(GROUP), rows.div_ceil(GROUP), 1];
        let shape = format!("{columns}x{rows}");
        for first in (0..triangles).step_by(PAGE) {
            let page = first..triangles.min(first + PAGE);
            let push = Push {
                width,
                height,
                first_row: band.first_row,
                rows: band.rows,
                side,
                first_face: first as u32,
                face_count: page.len() as u32,
            };
            self.device.upload_slice(&self.colours, 0, &shading.colours[page.clone()])?;
            self.device.upload_slice(&self.corners, 0, &shading.weights[page])?;
            let buffers = [samples, &self.colours, &self.corners, &self.pixels].map(Buffer::whole);
            let mut batch = self.device.batch()?;
            batch.dispatch(self.pipeline, &shape, &buffers, bytemuck::bytes_of(&push), groups)?;
            batch.submit()?;
        }
        self.device.download_slice(&self.pixels, 0, count)
    }
}

/// Bytes of the buffers of colours, corners and pixels.
pub(super) fn sizes(grid: &Grid, triangles: u64) -> [u64; 3] {
    let vec4 = size_of::<[f32; 4]>() as u64;
    let corners = 3 * vec4 * triangles.min(PAGE as u64);
    let pixels = vec4 * grid.band_pixels();
    [corners, corners, pixels]
}
