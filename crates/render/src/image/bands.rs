//! The subdivision of a picture: samples, square tiles of samples, and bands of tile rows that fit in memory.

use std::ops::Range;

use antirad_scene::Camera;

/// Samples along a side of a tile: the kernel's workgroup.
pub(super) const TILE: u32 = 16;

/// Samples in a band, unless one row of tiles already has more: 8 bytes each, and at most 16 per pixel.
const BAND_SAMPLES: u64 = 1 << 20;

/// The samples of a picture, row by row, and its division into bands. Bands begin at whole tiles and whole pixels, so that they
/// do not show.
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

impl Band {
    /// Rows of tiles, counted from the top of the picture.
    pub fn tile_rows(self) -> Range<u32> {
        self.first_row / TILE..(self.first_row + self.rows).div_ceil(TILE)
    }
}
