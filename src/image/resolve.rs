//! Pixels from samples and colours, band by band, on the device.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::ImageError;
use super::bands::{Band, Grid};
use super::projection::{Projected, View};
use super::smooth::corner_colours;
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::scene::{Camera, Scene};
use crate::shaders;

/// Faces whose colours are on the device at a time: 12 MiB where corners have their own.
const PAGE: usize = 1 << 17;

/// Pixels a side of the kernel's workgroup.
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

pub(super) fn pipeline(device: &Device, smooth: bool) -> Result<Pipeline, GpuError> {
    let smooth = [(0, u32::from(smooth))];
    Pipeline::new(device, &shaders::RESOLVE, 4, size_of::<Push>() as u32, &smooth, None)
}

/// What a picture shows on each face of the scene, backs black.
pub(super) enum Shading {
    Flat(Vec<[f32; 4]>),
    /// Colours of corners, and the functions of the picture that weigh them.
    Smooth(Vec<[[f32; 4]; 3]>, Vec<[[f32; 4]; 3]>),
}

impl Shading {
    pub fn new(
        scene: &Scene,
        camera: &Camera,
        faces: &[Projected],
        colours: &[[f32; 3]],
        smooth: bool,
    ) -> Result<Self, ImageError> {
        let opaque = |[r, g, b]: [f32; 3]| [r, g, b, 1.0];
        let fronts = || faces.iter().filter(|face| face.front).map(|face| face.number as usize);
        if !smooth {
            let mut shown = vec![[0.0; 4]; colours.len()];
            for number in fronts() {
                shown[number] = opaque(colours[number]);
            }
            return Ok(Self::Flat(shown));
        }
        let corners = corner_colours(scene, colours)?;
        let mut shown = vec![[[0.0; 4]; 3]; colours.len()];
        for number in fronts() {
            shown[number] = corners[number].map(opaque);
        }
        let view = View::new(camera);
        let weights = (0..colours.len())
            .into_par_iter()
            .map(|number| {
                let weights = view.corner_weights(scene.corners(number));
                weights.map(|weight| weight.extend(0.0).as_vec4().to_array())
            })
            .collect();
        Ok(Self::Smooth(shown, weights))
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
    /// For scenes of so many triangles.
    pub fn new(
        device: &'a Device,
        pipeline: &'a Pipeline,
        grid: Grid,
        triangles: u64,
        smooth: bool,
    ) -> Result<Self, GpuError> {
        let buffer = |label, bytes| Buffer::new(device, label, bytes, BufferKind::Storage);
        let [colours, corners, pixels] = sizes(&grid, triangles, smooth);
        Ok(Self {
            device,
            pipeline,
            grid,
            colours: buffer("picture colours", colours)?,
            corners: buffer("picture corners", corners)?,
            pixels: buffer("picture pixels", pixels)?,
        })
    }

    /// The pixels of a band whose samples are in `samples`.
    pub fn run(&self, band: Band, samples: &Buffer, shading: &Shading) -> Result<Vec<[f32; 4]>, GpuError> {
        let Grid { side, width, height, .. } = self.grid;
        let (columns, rows) = (width / side, band.rows / side);
        let count = u64::from(columns) * u64::from(rows);
        let mut batch = self.device.batch()?;
        batch.fill(&self.pixels, 0, count * size_of::<[f32; 4]>() as u64, 0)?;
        batch.submit()?;

        let triangles = match shading {
            Shading::Flat(colours) => colours.len(),
            Shading::Smooth(colours, _) => colours.len(),
        };
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
            match shading {
                Shading::Flat(colours) => self.device.upload_slice(&self.colours, 0, &colours[page])?,
                Shading::Smooth(colours, weights) => {
                    self.device.upload_slice(&self.colours, 0, &colours[page.clone()])?;
                    self.device.upload_slice(&self.corners, 0, &weights[page])?;
                }
            }
            let buffers = [samples, &self.colours, &self.corners, &self.pixels].map(Buffer::whole);
            let mut batch = self.device.batch()?;
            batch.dispatch(self.pipeline, &shape, &buffers, bytemuck::bytes_of(&push), groups)?;
            batch.submit()?;
        }
        self.device.download_slice(&self.pixels, 0, count)
    }
}

/// Bytes of the buffers of colours, corners and pixels.
pub(super) fn sizes(grid: &Grid, triangles: u64, smooth: bool) -> [u64; 3] {
    let vec4 = size_of::<[f32; 4]>() as u64;
    let corners = 3 * vec4 * triangles.min(PAGE as u64);
    let pixels = vec4 * grid.band_pixels();
    if smooth { [corners, corners, pixels] } else { [corners / 3, 0, pixels] }
}
