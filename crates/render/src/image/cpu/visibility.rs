//! The nearest face at every sample, band by band, on all cores. Twin of crates/core/glsl/visibility.comp.

use crate::image::bands::{Band, Grid, TILE};
use crate::image::faces::{Face, NONE};
use crate::image::projection::Projected;
use crate::image::tiles::{TileLists, Tiles};
use antirad_gpu::vectorised;
use rayon::prelude::*;

const SIDE: usize = TILE as usize;

/// The samples of a tile, row by row: inverse depth and face.
#[derive(Clone)]
struct Tile {
    depths: [[f32; SIDE]; SIDE],
    samples: [[u32; SIDE]; SIDE],
}

/// The face of each sample of a band, row by row; `NONE` outside the `wanted` tiles.
pub fn samples(grid: &Grid, band: Band, faces: &[Projected], wanted: &Tiles) -> Vec<u32> {
    let columns = grid.tile_columns() as usize;
    // Those that any face may touch.
    let mut tiles: Vec<Option<Box<Tile>>> = vec![None; columns * band.tile_rows().len()];
    let mut first = 0;
    while first < faces.len() {
        let (lists, next) = TileLists::build(grid, band, faces, first, wanted);
        first = next;
        let listed = lists.faces.iter().map(|&face| &faces[face as usize]);
        let (listed, numbers): (Vec<Face>, Vec<u32>) =
            listed.map(|face| (Face::from(face), face.number)).unzip();
        let touched =
            tiles.par_iter_mut().enumerate().filter(|(t, _)| lists.tile_start[*t] < lists.tile_start[t + 1]);
        touched.for_each(|(t, tile)| {
            let tile = tile.get_or_insert_with(Tile::empty);
            let corner = [t % columns * SIDE, band.first_row as usize + t / columns * SIDE];
            let place = |at: usize, of: u32| (2 * at + 1) as f32 / of as f32 - 1.0;
            let x: [f32; SIDE] = std::array::from_fn(|k| place(corner[0] + k, grid.width));
            let y: [f32; SIDE] = std::array::from_fn(|k| -place(corner[1] + k, grid.height));
            let [begin, end] = [t, t + 1].map(|t| lists.tile_start[t] as usize);
            for &face in &lists.tile_faces[begin..end] {
                let (face, number) = (&listed[face as usize], numbers[face as usize]);
                vectorised(
                    #[inline(always)]
                    || tile.add(face, number, &x, &y),
                );
            }
        });
    }
    let width = grid.width as usize;
    let mut samples = vec![NONE; width * band.rows as usize];
    for (row, samples) in samples.chunks_exact_mut(width).enumerate() {
        let tiles = &tiles[row / SIDE * columns..][..columns];
        for (samples, tile) in samples.chunks_mut(SIDE).zip(tiles) {
            if let Some(tile) = tile {
                samples.copy_from_slice(&tile.samples[row % SIDE][..samples.len()]);
            }
        }
    }
    samples
}

impl Tile {
    /// A tile that shows no face: its depths are infinitely far.
    fn empty() -> Box<Self> {
        Box::new(Self { depths: [[0.0; SIDE]; SIDE], samples: [[NONE; SIDE]; SIDE] })
    }

    /// Adds a face. Lists are in the scene's order: of faces at equal depth the first one wins.
    #[inline(always)]
    fn add(&mut self, face: &Face, number: u32, x: &[f32; SIDE], y: &[f32; SIDE]) {
        let [e0, e1, e2] = face.edges;
        for ((depths, samples), &y) in self.depths.iter_mut().zip(&mut self.samples).zip(y) {
            for k in 0..SIDE {
                let edge = |e: [f32; 4]| e[0] * x[k] + e[1] * y + e[2];
                let (a, b, c) = (edge(e0), edge(e1), edge(e2));
                let near = e0[3] * x[k] + e1[3] * y + e2[3];
                let seen = (a >= 0.0) & (b >= 0.0) & (c >= 0.0) & (near > depths[k]);
                depths[k] = if seen { near } else { depths[k] };
                samples[k] = if seen { number } else { samples[k] };
            }
        }
    }
}
