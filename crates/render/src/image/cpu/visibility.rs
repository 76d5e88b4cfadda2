//! The nearest face at every sample, band by band, on all cores. Twin of crates/core/glsl/visibility.comp.

use crate::image::bands::{Band, Grid, TILE};
use crate::image::faces::{Face, NONE};
use crate::image::projection::Projected;
use crate::image::tiles::{TileLists, Tiles};
use antirad_base::parallel;
use antirad_gpu::vectorised;

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
        parallel::each(tiles.iter_mut().enumerate(), |(t, tile)| {
            if lists.tile_start[t] == lists.tile_start[t + 1] {
                return;
            }
            let tile = tile.get_or_insert_with(Tile::empty);
            let corner = [t % columns * SIDE, band.first_row as usize + t / columns * SIDE];
            let places = Places::new(grid, corner.map(|at| at as u32));
            let [begin, end] = [t, t + 1].map(|t| lists.tile_start[t] as usize);
            for &face in &lists.tile_faces[begin..end] {
                let (face, number) = (&listed[face as usize], numbers[face as usize]);
                vectorised(
                    #[inline(always)]
                    || tile.add(face, number, &places),
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

/// The places of the samples of a tile, row by row, -1 to 1; y upwards.
struct Places {
    x: [[f32; SIDE]; SIDE],
    y: [[f32; SIDE]; SIDE],
}

impl Places {
    /// `corner`: column and row of the first.
    fn new(grid: &Grid, [column, row]: [u32; 2]) -> Self {
        let mut places = Self { x: [[0.0; SIDE]; SIDE], y: [[0.0; SIDE]; SIDE] };
        for (r, (x, y)) in (row..).zip(places.x.iter_mut().zip(&mut places.y)) {
            for (c, (x, y)) in (column..).zip(x.iter_mut().zip(y)) {
                let [right, down] = grid.place(c, r);
                (*x, *y) = (right, -down);
            }
        }
        places
    }
}

impl Tile {
    /// A tile that shows no face: its depths are infinitely far.
    fn empty() -> Box<Self> {
        Box::new(Self { depths: [[0.0; SIDE]; SIDE], samples: [[NONE; SIDE]; SIDE] })
    }

    /// Adds a face. Lists are in the scene's order: of faces at equal depth the first one wins.
    #[inline(always)]
    fn add(&mut self, face: &Face, number: u32, places: &Places) {
        let [e0, e1, e2] = face.edges;
        let rows = self.depths.iter_mut().zip(&mut self.samples).zip(places.x.iter().zip(&places.y));
        for ((depths, samples), (x, y)) in rows {
            for k in 0..SIDE {
                let edge = |e: [f32; 4]| e[0] * x[k] + e[1] * y[k] + e[2];
                let (a, b, c) = (edge(e0), edge(e1), edge(e2));
                let near = e0[3] * x[k] + e1[3] * y[k] + e2[3];
                let seen = (a >= 0.0) & (b >= 0.0) & (c >= 0.0) & (near > depths[k]);
                depths[k] = if seen { near } else { depths[k] };
                samples[k] = if seen { number } else { samples[k] };
            }
        }
    }
}
