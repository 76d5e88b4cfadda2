//! Lists of the faces that may touch each tile.

use std::ops::{Range, RangeInclusive};

use glam::DVec3;

use super::bands::{Band, Grid, TILE};
use super::projection::{Projected, ROUNDING};

/// Pairs of tile and face after which a list is closed. A pair costs a CPU core about 2 µs, so that a dispatch stays well below
/// a second there, even if all its pairs are of one tile. Lavapipe leaves a kernel's loops after 65535 iterations, so no tile
/// may have more faces than that.
const PAIRS: usize = 1 << 15;

/// Largest number of pairs in one list for bands of this many tiles: the last face may touch all of them.
pub(super) fn max_pairs(band_tiles: u64, faces: u64) -> u64 {
    (faces * band_tiles).min(PAIRS as u64 + band_tiles)
}

/// The faces that may touch each tile of a band, tile by tile, in ascending order.
#[derive(Debug, Default)]
pub(super) struct TileLists {
    /// Indices of the projected faces that may touch a tile.
    pub faces: Vec<u32>,
    /// Tile t has the entries `tile_start[t]..tile_start[t + 1]` of `tile_faces`.
    pub tile_start: Vec<u32>,
    /// Indices into `faces`.
    pub tile_faces: Vec<u32>,
}

impl TileLists {
    /// Takes faces from `first` on, up to about [`PAIRS`] pairs; also returns the index of the first face not taken. Tiles
    /// that are not `wanted` have none.
    pub fn build(
        grid: &Grid,
        band: Band,
        faces: &[Projected],
        first: usize,
        wanted: &Tiles,
    ) -> (Self, usize) {
        let rows = band.tile_rows();
        let mut lists = Self::default();
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        let mut next = first;
        while next < faces.len() && pairs.len() < PAIRS {
            let before = pairs.len();
            let place = lists.faces.len() as u32;
            touched(grid, &rows, &faces[next], |[column, row]| {
                if wanted.contain(column, row) {
                    pairs.push(((row - rows.start) * grid.tile_columns() + column, place));
                }
            });
            if pairs.len() > before {
                lists.faces.push(next as u32);
            }
            next += 1;
        }

        // A counting sort, which keeps the order of the faces.
        lists.tile_start = vec![0; grid.tile_columns() as usize * rows.len() + 1];
        for &(tile, _) in &pairs {
            lists.tile_start[tile as usize + 1] += 1;
        }
        for tile in 1..lists.tile_start.len() {
            lists.tile_start[tile] += lists.tile_start[tile - 1];
        }
        let mut end = lists.tile_start.clone();
        lists.tile_faces = vec![0; pairs.len()];
        for (tile, place) in pairs {
            let slot = &mut end[tile as usize];
            lists.tile_faces[*slot as usize] = place;
            *slot += 1;
        }
        (lists, next)
    }
}

/// Some tiles of a picture.
#[derive(Debug)]
pub(super) enum Tiles {
    All,
    Some {
        columns: u32,
        /// Row by row.
        member: Vec<bool>,
    },
}

impl Tiles {
    /// Tiles that some faces may touch.
    pub fn of<'a>(grid: &Grid, faces: impl Iterator<Item = &'a Projected>) -> Self {
        let (columns, rows) = (grid.tile_columns(), 0..grid.tile_rows());
        let mut member = vec![false; columns as usize * rows.len()];
        for face in faces {
            touched(grid, &rows, face, |[column, row]| member[(row * columns + column) as usize] = true);
        }
        Self::Some { columns, member }
    }

    /// These tiles and their neighbours.
    pub fn with_neighbours(self, grid: &Grid) -> Self {
        let Self::Some { columns, member } = &self else { return self };
        let (columns, rows) = (*columns, grid.tile_rows());
        let around = |at: u32, end: u32| at.saturating_sub(1)..(at + 2).min(end);
        let any = |column: u32, row: u32| {
            let mut near =
                around(row, rows).flat_map(|row| around(column, columns).map(move |c| row * columns + c));
            near.any(|tile| member[tile as usize])
        };
        let member = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
        Self::Some { columns, member: member.map(|(column, row)| any(column, row)).collect() }
    }

    /// Whether a tile is among them.
    pub fn contain(&self, column: u32, row: u32) -> bool {
        match self {
            Self::All => true,
            Self::Some { columns, member } => member[(row * columns + column) as usize],
        }
    }

    /// The ranges of rows with at least one of the tiles.
    pub fn rows(&self, grid: &Grid) -> Vec<Range<u32>> {
        let any = |row: &u32| (0..grid.tile_columns()).any(|column| self.contain(column, *row));
        let rows: Vec<u32> = (0..grid.tile_rows()).filter(any).collect();
        rows.chunk_by(|a, b| a + 1 == *b).map(|run| run[0]..run[run.len() - 1] + 1).collect()
    }
}

/// Calls `touch` with column and row of the tiles in `rows` that the face may touch.
fn touched(grid: &Grid, rows: &Range<u32>, face: &Projected, mut touch: impl FnMut([u32; 2])) {
    let columns = tiles(face.bounds.x, grid.width);
    let [bottom, top] = face.bounds.y;
    let face_rows = tiles([-top, -bottom], grid.height);
    // Samples are anywhere in their cells.
    let half =
        DVec3::new(f64::from(TILE) / f64::from(grid.width), f64::from(TILE) / f64::from(grid.height), 0.0);
    for row in (*face_rows.start()).max(rows.start)..=(*face_rows.end()).min(rows.end - 1) {
        let y = -centre(row, grid.height);
        for column in columns.clone() {
            let middle = DVec3::new(centre(column, grid.width), y, 1.0);
            // The largest value of the function on the tile's samples, within the kernel's rounding.
            let may_pass = |edge: &DVec3| edge.dot(middle) + edge.abs().dot(half) >= -ROUNDING;
            if face.edges.iter().all(may_pass) {
                touch([column, row]);
            }
        }
    }
}

/// Centre of a tile in the picture, from -1 to 1.
fn centre(tile: u32, samples: u32) -> f64 {
    f64::from((2 * tile + 1) * TILE) / f64::from(samples) - 1.0
}

/// The tiles with samples in a range of the picture, from -1 to 1, or next to it.
fn tiles(range: [f64; 2], samples: u32) -> RangeInclusive<u32> {
    let [first, last] = range.map(|place| (place + 1.0) / 2.0 * f64::from(samples));
    // Conversions saturate: negative numbers give tile 0.
    (first - 1.0) as u32 / TILE..=(last as u32).min(samples - 1) / TILE
}
