//! The subdivision of a picture: samples, square tiles of samples, and bands of tile rows that fit in memory.

use std::ops::Range;

use antirad_scene::Camera;

/// Samples along a side of a tile: the kernel's workgroup.
pub(super) const TILE: u32 = 16;

/// Samples in a band, unless one row of tiles already has more: 8 bytes each, and at most 16 per pixel.
const BAND_SAMPLES: u64 = 1 << 20;

/// The samples of a picture, row by row of a grid with one in each cell, and its division into bands. Bands begin at whole tiles and whole
/// pixels, so that they do not show.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    /// Samples along a side of a pixel, a power of two.
    pub side: u32,
    /// Width in samples.
    pub width: u32,
    /// Height in samples.
    pub height: u32,
    /// Tile rows in all bands but the last.
    band_tile_rows: u32,
}

/// A range of rows of samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Band {
    pub first_row: u32,
    pub rows: u32,
}

impl Grid {
    pub fn new(camera: &Camera, side: u32) -> Self {
        let (width, height) = (camera.width * side, camera.height * side);
        let tile_row = u64::from(width) * u64::from(TILE);
        let band_tile_rows = (BAND_SAMPLES / tile_row).clamp(1, u64::from(height.div_ceil(TILE))) as u32;
        Self { side, width, height, band_tile_rows }
    }

    /// This grid in bands of at most so many rows of tiles.
    pub fn bands_up_to(self, tile_rows: u32) -> Self {
        Self { band_tile_rows: self.band_tile_rows.min(tile_rows.max(1)), ..self }
    }

    /// The place of a sample by its column and row, -1 to 1 from the left and from the top. Each pixel has its samples on a rotated grid,
    /// [`Self::within`].
    pub fn place(&self, column: u32, row: u32) -> [f32; 2] {
        let steps = self.side * self.side;
        let (pixel, [x, y]) = ([column, row].map(|at| at / self.side), self.within(column, row));
        [(pixel[0] * steps + x, self.width), (pixel[1] * steps + y, self.height)]
            .map(|(at, samples)| (2 * at + 1) as f32 / (samples * self.side) as f32 - 1.0)
    }

    /// The place of a sample within its pixel, in steps of one over the number of samples: no two samples of a pixel share a column or a row of
    /// these, so that edges along either cover each pixel in as many steps.
    fn within(&self, column: u32, row: u32) -> [u32; 2] {
        let cell = [column, row].map(|at| f64::from(at % self.side));
        rotated(self.side, cell).map(|at| at as u32)
    }

    pub fn tile_columns(&self) -> u32 {
        self.width.div_ceil(TILE)
    }

    pub fn tile_rows(&self) -> u32 {
        self.height.div_ceil(TILE)
    }

    /// Samples of the largest band.
    pub fn band_samples(&self) -> u64 {
        u64::from(self.width) * u64::from((self.band_tile_rows * TILE).min(self.height))
    }

    /// Tiles of the largest band.
    pub fn band_tiles(&self) -> u64 {
        u64::from(self.tile_columns()) * u64::from(self.band_tile_rows)
    }

    /// Bands of some rows of tiles.
    pub fn bands(self, tile_rows: Range<u32>) -> impl Iterator<Item = Band> {
        let step = self.band_tile_rows * TILE;
        let end = (tile_rows.end * TILE).min(self.height);
        (tile_rows.start * TILE..end)
            .step_by(step as usize)
            .map(move |first_row| Band { first_row, rows: step.min(end - first_row) })
    }
}

/// The place of a sample within its pixel, in steps of one over the number of samples, by its column and row there; that of means of samples, too.
pub(super) fn rotated(side: u32, [column, row]: [f64; 2]) -> [f64; 2] {
    let side = f64::from(side);
    [side * column + side - 1.0 - row, side * row + column]
}

impl Band {
    /// Rows of tiles, counted from the top of the picture.
    pub fn tile_rows(self) -> Range<u32> {
        self.first_row / TILE..(self.first_row + self.rows).div_ceil(TILE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_of_a_pixel_share_no_column_and_no_row() {
        for side in [1, 2, 4, 8, 16] {
            let grid = Grid { side, width: 3 * side, height: 2 * side, band_tile_rows: 1 };
            let all = (0..side).flat_map(|v| (0..side).map(move |u| [u, v]));
            let within: Vec<[u32; 2]> = all.map(|[u, v]| grid.within(2 * side + u, side + v)).collect();
            for axis in [0, 1] {
                let mut places: Vec<u32> = within.iter().map(|place| place[axis]).collect();
                places.sort_unstable();
                assert_eq!(places, (0..side * side).collect::<Vec<_>>());
            }
            // In the last pixel of the first row, in its own cell.
            let [x, y] = grid.place(3 * side - 1, 0);
            let cell = 2.0 / (side as f32);
            assert!(x > 1.0 - cell / 3.0 && x < 1.0 && y > -1.0 && y < cell / 2.0 - 1.0, "{side}: {x} {y}");
        }
    }
}
