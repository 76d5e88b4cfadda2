//! The share of each face in each pixel: the picture as a linear map of face colours, and its transpose.

use antirad_base::parallel;
use antirad_scene::Scene;
use glam::DVec3;

use super::bands::{Band, Grid, TILE, rotated};
use super::faces::NONE;
use super::projection::Projected;
use super::tiles::Tiles;
use super::{ImageError, Picture};

/// Stands for the back of any face, which is black but not background.
const BACK: u32 = NONE - 1;

/// What a camera sees of a scene, independent of colours: the faces in each pixel, with their number of samples. Valid until a
/// vertex or the camera moves.
///
/// Takes 5 bytes per pixel and 12 per face in each pixel, on the host.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub struct Coverage {
    width: u32,
    height: u32,
    /// Samples along a side of a pixel, but for pixels with more.
    supersample: u32,
    triangles: usize,
    /// What `supersample` x `supersample` samples of each pixel show, [`LAMP`] and [`DARK`], row by row from the top.
    shown: Vec<u8>,
    /// Number of `shares` of each pixel.
    counts: Vec<u32>,
    /// Within a pixel in ascending order of faces.
    shares: Vec<Share>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
struct Share {
    /// Index in the scene, or [`BACK`].
    face: u32,
    samples: u16,
    /// Sums of the columns and rows of the cells of the samples within the pixel.
    sums: [u16; 2],
    /// Samples along a side of the pixel.
    side: u8,
}

impl Share {
    /// Share of the pixel's samples.
    fn of_pixel(&self) -> f64 {
        f64::from(self.samples) / f64::from(self.side).powi(2)
    }
}

/// Some sample of a pixel shows a face that emits.
const LAMP: u8 = 1;
/// Some sample of a pixel shows anything else.
const DARK: u8 = 2;

/// A face in a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaceInPixel {
    /// Index of the triangle in the scene.
    pub face: usize,
    /// Index of the pixel, row by row from the top.
    pub pixel: usize,
    /// Share of the pixel's samples that show the face's front.
    pub share: f64,
    /// Column and row of the mean of these samples, in pixels from the upper left corner of the picture: [`View::ray`](super::View::ray) gives
    /// its direction.
    pub place: [f64; 2],
}

impl Coverage {
    /// Coverage of no rows.
    pub(super) fn empty(grid: &Grid, triangles: usize) -> Self {
        let (shown, counts, shares) = (Vec::new(), Vec::new(), Vec::new());
        let width = grid.width / grid.side;
        Self { width, height: 0, supersample: grid.side, triangles, shown, counts, shares }
    }

    /// Coverage of a band, from the visible face of each of its samples; none of pixels outside the `wanted` tiles.
    pub(super) fn of_band(grid: &Grid, band: Band, samples: &[u32], sides: &Sides, wanted: &Tiles) -> Self {
        let side = grid.side as usize;
        let (width, columns) = (grid.width as usize, (grid.width / grid.side) as usize);
        let pixel_row = |(row, rows): (usize, &[u32])| {
            let (mut shown, mut counts) = (Vec::with_capacity(columns), Vec::with_capacity(columns));
            let mut shares = Vec::with_capacity(columns);
            // The faces of one pixel, few.
            let mut seen: Vec<Share> = Vec::new();
            let tile_row = (band.first_row + row as u32 * grid.side) / TILE;
            for column in 0..columns {
                seen.clear();
                if !wanted.contain(column as u32 * grid.side / TILE, tile_row) {
                    shown.push(0);
                    counts.push(0);
                    continue;
                }
                for (v, row) in (0u16..).zip(rows.chunks(width)) {
                    let cells = row[column * side..(column + 1) * side].iter();
                    for (u, &face) in (0u16..).zip(cells) {
                        let face = sides.shown(face);
                        // Often that of the sample before.
                        let at = seen.iter().rposition(|share| share.face == face).unwrap_or_else(|| {
                            seen.push(Share { face, samples: 0, sums: [0; 2], side: grid.side as u8 });
                            seen.len() - 1
                        });
                        let Share { samples, sums, .. } = &mut seen[at];
                        *samples += 1;
                        *sums = [sums[0] + u, sums[1] + v];
                    }
                }
                shown.push(seen.iter().fold(0, |shown, share| shown | sides.kind(share.face)));
                seen.retain(|share| share.face != NONE);
                seen.sort_unstable_by_key(|share| share.face);
                shares.extend_from_slice(&seen);
                counts.push(seen.len() as u32);
            }
            (shown, counts, shares)
        };
        let rows = parallel::map(samples.chunks(width * side).enumerate(), pixel_row);
        let mut coverage = Self::empty(grid, sides.front.len());
        coverage.height = band.rows / grid.side;
        for (shown, counts, shares) in rows {
            coverage.shown.extend(shown);
            coverage.counts.extend(counts);
            coverage.shares.extend(shares);
        }
        coverage
    }

    /// Appends the rows below.
    pub(super) fn append(&mut self, below: Self) {
        self.height += below.height;
        self.shown.extend(below.shown);
        self.counts.extend(below.counts);
        self.shares.extend(below.shares);
    }

    /// Whether it is of as many pixels, samples and triangles.
    pub(super) fn fits(&self, grid: &Grid, triangles: usize) -> bool {
        let size = [self.width, self.height].map(|pixels| pixels * self.supersample);
        size == [grid.width, grid.height] && self.supersample == grid.side && self.triangles == triangles
    }

    /// The number of samples along a side of pixels, but for those with more.
    pub(super) fn supersample(&self) -> u32 {
        self.supersample
    }

    /// Per pixel, whether it or one of its neighbours shows a lamp, and one of these something else.
    pub(super) fn lamp_edges(&self) -> Vec<bool> {
        let (width, height) = (self.width as usize, self.height as usize);
        let around = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let row_of = |row: usize| &self.shown[row * width..(row + 1) * width];
        let is_edge = |row: usize, column: usize| {
            let shown = around(row, height).flat_map(|row| &row_of(row)[around(column, width)]);
            shown.fold(0, |all, shown| all | shown) == LAMP | DARK
        };
        (0..height)
            .flat_map(|row| (0..width).map(move |column| (row, column)))
            .map(|(r, c)| is_edge(r, c))
            .collect()
    }

    /// This coverage with the pixels of some tiles taken from `bands`, which have all of those, from the top.
    pub(super) fn with(&self, grid: &Grid, bands: &[(Band, Self)], tiles: &Tiles) -> Self {
        let mut result = Self { shown: self.shown.clone(), counts: Vec::new(), shares: Vec::new(), ..*self };
        let is_as_fine = grid.side == self.supersample;
        let mut before = self.by_pixel();
        let mut bands = bands
            .iter()
            .map(|(band, coverage)| (band, coverage.shown.iter(), coverage.by_pixel()))
            .peekable();
        for row in 0..self.height {
            let sample = row * grid.side;
            while bands.next_if(|(band, ..)| band.first_row + band.rows <= sample).is_some() {}
            let mut after = bands.peek_mut().filter(|(band, ..)| band.first_row <= sample);
            for column in 0..self.width {
                let old = before.next().unwrap_or_default();
                let new = after.as_mut().and_then(|(_, shown, pixels)| shown.next().zip(pixels.next()));
                let changed = tiles.contain(column * grid.side / TILE, sample / TILE);
                let new = new.filter(|_| changed);
                if let Some((&shown, _)) = new.filter(|_| is_as_fine) {
                    result.shown[result.counts.len()] = shown;
                }
                let shares = new.map_or(old, |(_, shares)| shares);
                result.counts.push(shares.len() as u32);
                result.shares.extend_from_slice(shares);
            }
        }
        result
    }

    /// The shares of each pixel.
    fn by_pixel(&self) -> impl Iterator<Item = &[Share]> {
        let mut left = &self.shares[..];
        self.counts.iter().map(move |&count| {
            let (own, rest) = left.split_at(count as usize);
            left = rest;
            own
        })
    }

    /// Width in pixels.
    #[doc(hidden)]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    #[doc(hidden)]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The faces whose fronts are visible, pixel by pixel: each face once per pixel that shows it.
    #[doc(hidden)]
    pub fn faces(&self) -> impl Iterator<Item = usize> + '_ {
        self.shares.iter().filter(|share| share.face != BACK).map(|share| share.face as usize)
    }

    /// The faces of [`Self::faces`] in the same order, each with its share of the pixel and its place.
    #[doc(hidden)]
    pub fn faces_in_pixels(&self) -> impl Iterator<Item = FaceInPixel> + '_ {
        let width = self.width as usize;
        let mut shares = self.shares.iter();
        self.counts.iter().enumerate().flat_map(move |(pixel, &count)| {
            let of_pixel = shares.by_ref().take(count as usize).collect::<Vec<_>>();
            of_pixel.into_iter().filter(|share| share.face != BACK).map(move |share| {
                let (samples, side) = (f64::from(share.samples), f64::from(share.side));
                let cells = share.sums.map(|sum| f64::from(sum) / samples);
                let within = rotated(share.side.into(), cells).map(|at| (at + 0.5) / (side * side));
                FaceInPixel {
                    face: share.face as usize,
                    pixel,
                    share: share.of_pixel(),
                    place: [(pixel % width) as f64 + within[0], (pixel / width) as f64 + within[1]],
                }
            })
        })
    }

    /// Per triangle, whether its front is visible in at least one sample of at least one of these views of the scene.
    #[doc(hidden)]
    pub fn seen<'a>(views: impl IntoIterator<Item = &'a Self>, triangles: usize) -> Vec<bool> {
        let mut seen = vec![false; triangles];
        views.into_iter().flat_map(Self::faces).for_each(|face| seen[face] = true);
        seen
    }

    /// The pixels, row by row from the top: linear RGB, and the share of samples that show a face. `colours`:
    /// radiance of the front of each triangle, in the scene's order; backs are black.
    ///
    /// # Errors
    /// Fails if the number of colours is not that of triangles.
    #[doc(hidden)]
    pub fn pixels<C>(&self, colours: &[[C; 3]]) -> Result<Vec<[f64; 4]>, ImageError>
    where
        C: Copy + Into<f64>,
    {
        check_colours(colours.len(), self.triangles)?;
        let mut shares = self.shares.iter();
        let pixel = |&count: &u32| {
            let mut sum = [0.0; 4];
            for share in shares.by_ref().take(count as usize) {
                let of_pixel = share.of_pixel();
                if share.face != BACK {
                    let colour = colours[share.face as usize];
                    for channel in 0..3 {
                        sum[channel] += of_pixel * colour[channel].into();
                    }
                }
                sum[3] += of_pixel;
            }
            sum
        };
        Ok(self.counts.iter().map(pixel).collect())
    }

    /// [`pixels`](Self::pixels) as a picture, rounded to f32.
    ///
    /// # Errors
    /// Fails as [`pixels`](Self::pixels) does.
    #[doc(hidden)]
    pub fn picture<C>(&self, colours: &[[C; 3]]) -> Result<Picture, ImageError>
    where
        C: Copy + Into<f64>,
    {
        let round = |pixel: [f64; 4]| pixel.map(|value| value as f32);
        let pixels = self.pixels(colours)?.into_iter().map(round).collect();
        Ok(Picture { width: self.width, height: self.height, pixels })
    }

    /// The derivatives of a loss with respect to the colour of each triangle, in the scene's order: the
    /// transpose of [`pixels`](Self::pixels), exact up to f64 rounding. `cotangent`: the derivative of the
    /// loss with respect to each pixel's RGB and alpha, row by row from the top; alpha does not depend on
    /// colours.
    ///
    /// # Errors
    /// Fails unless there is one cotangent per pixel, and all are finite.
    #[doc(hidden)]
    pub fn colour_gradient(&self, cotangent: &[[f64; 4]]) -> Result<Vec<DVec3>, ImageError> {
        check_cotangent(cotangent, self.counts.len())?;
        let mut gradient = vec![DVec3::ZERO; self.triangles];
        let mut shares = self.shares.iter();
        // Sequential, so that sums are reproducible; a pixel costs a few nanoseconds.
        for (&count, &[r, g, b, _]) in self.counts.iter().zip(cotangent) {
            let adjoint = DVec3::new(r, g, b);
            for share in shares.by_ref().take(count as usize).filter(|share| share.face != BACK) {
                gradient[share.face as usize] += share.of_pixel() * adjoint;
            }
        }
        Ok(gradient)
    }
}

/// The side of each face that a camera sees, and which emit.
pub(super) struct Sides {
    /// Per triangle of the scene, whether it is the front.
    front: Vec<bool>,
    emits: Vec<bool>,
}

impl Sides {
    pub fn new(scene: &Scene, faces: &[Projected]) -> Self {
        let mut front = vec![false; scene.triangles.len()];
        for face in faces {
            front[face.number as usize] = face.front;
        }
        let emits = (0..scene.triangles.len()).map(|face| scene.material(face).emits()).collect();
        Self { front, emits }
    }

    /// Whether a face that a sample shows emits: [`LAMP`] or [`DARK`].
    fn kind(&self, face: u32) -> u8 {
        if self.emits.get(face as usize) == Some(&true) { LAMP } else { DARK }
    }

    fn shown(&self, face: u32) -> u32 {
        match self.front.get(face as usize) {
            Some(true) => face,
            Some(false) => BACK,
            None => NONE,
        }
    }
}

/// Fails unless there is one colour per triangle.
pub(super) fn check_colours(given: usize, wanted: usize) -> Result<(), ImageError> {
    if given == wanted { Ok(()) } else { Err(ImageError::Colours { given, wanted }) }
}

/// Fails unless the cotangent has one entry per pixel, all finite.
pub(super) fn check_cotangent(cotangent: &[[f64; 4]], pixels: usize) -> Result<(), ImageError> {
    if cotangent.len() != pixels {
        return Err(ImageError::CotangentLength { given: cotangent.len(), wanted: pixels });
    }
    match cotangent.iter().position(|pixel| pixel.iter().any(|value| !value.is_finite())) {
        Some(pixel) => Err(ImageError::CotangentNotFinite { pixel }),
        None => Ok(()),
    }
}
