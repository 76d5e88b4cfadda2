//! The rasterizer: from a scene, a camera and colours to a picture.

use super::bands::{Band, Grid, TILE};
use super::coverage::{Coverage, Sides, check_colours};
use super::faces::{project, rounded};
use super::projection::{Projected, View};
use super::tiles::Tiles;
use super::visibility::{self, Finder};
use super::{ImageError, Picture};
use antirad_base::setters;
use antirad_core::backend::Backend;
use antirad_scene::{BackendKind, Camera, Scene};
use glam::DVec3;

/// Largest number of samples along a side of a pixel.
pub const MAX_SUPERSAMPLE: u32 = 16;

/// Lamps of fewer pixels in width and height may lie between samples.
const SMALL: f64 = 2.0;

/// How a picture is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct PictureOptions {
    /// Each pixel is the mean of `supersample` x `supersample` samples on a rotated grid; a power of two.
    pub supersample: u32,
}

setters!(PictureOptions { supersample: u32 });

impl Default for PictureOptions {
    fn default() -> Self {
        Self { supersample: 8 }
    }
}

/// Makes pictures on a backend. The same input gives the same picture, to the last bit.
#[derive(Debug)]
pub struct Rasterizer {
    backend: Backend,
    finder: Finder,
}

impl Rasterizer {
    /// Compiles the kernel, if it takes one. Memory is allocated only while a picture is made.
    ///
    /// # Errors
    /// Fails if the kernel cannot be compiled.
    pub fn new(backend: impl Into<Backend>) -> Result<Self, ImageError> {
        let backend = backend.into();
        Ok(Self { finder: Finder::new(&backend)?, backend })
    }

    /// The picture of a scene. `colours`: radiance of the front of each triangle, in the scene's
    /// order.
    ///
    /// # Errors
    /// Fails if the scene, the camera or the options are invalid, if the number of colours is not that of
    /// triangles, or if the device fails.
    pub fn render(
        &self,
        scene: &Scene,
        camera: &Camera,
        colours: &[[f32; 3]],
        options: &PictureOptions,
    ) -> Result<Picture, ImageError> {
        let triangles = scene.triangles.len();
        check_colours(colours.len(), triangles)?;
        let grid = grid(camera, options.supersample)?;
        let faces = rounded(project(scene, camera)?);
        let mut pixels = Vec::with_capacity(camera.width as usize * camera.height as usize);
        self.coverage_of_bands(grid, scene, &faces, &Tiles::All, |_, band| {
            pixels.extend(band.picture(colours)?.pixels);
            Ok(())
        })?;
        Ok(Picture { width: camera.width, height: camera.height, pixels })
    }

    /// What a camera sees of a scene, at `supersample` x `supersample` samples per pixel: for pictures in any colours, and for
    /// their derivatives. Lamps are far brighter than all else, and the shares that edges of theirs leave to a pixel must be as much more
    /// accurate: unless `supersample` is 1, pixels at their edges have [`MAX_SUPERSAMPLE`] x [`MAX_SUPERSAMPLE`] samples. Of several ranks, which
    /// must all ask at once, the first looks, and all get what it sees: devices that differ may round differently.
    ///
    /// # Errors
    /// Fails if the scene, the camera or `supersample` is invalid, if the device fails, or if ranks can no
    /// longer work together.
    #[doc(hidden)]
    pub fn coverage(&self, scene: &Scene, camera: &Camera, supersample: u32) -> Result<Coverage, ImageError> {
        self.backend.ranks().by_first(|| self.own_coverage(scene, camera, supersample))
    }

    /// What this rank alone finds a camera to see.
    fn own_coverage(&self, scene: &Scene, camera: &Camera, supersample: u32) -> Result<Coverage, ImageError> {
        let grid = grid(camera, supersample)?;
        let faces = rounded(project(scene, camera)?);
        let mut whole = Coverage::empty(&grid, scene.triangles.len());
        self.coverage_of_bands(grid, scene, &faces, &Tiles::All, |_, band| {
            whole.append(band);
            Ok(())
        })?;
        self.with_lamp_edges(scene, camera, &faces, whole, |_| true)
    }

    /// A coverage with more samples in those pixels `among` all that lie at edges of lamps or may show lamps of less than two pixels.
    fn with_lamp_edges(
        &self,
        scene: &Scene,
        camera: &Camera,
        faces: &[Projected],
        coverage: Coverage,
        among: impl Fn([u32; 2]) -> bool,
    ) -> Result<Coverage, ImageError> {
        if [1, MAX_SUPERSAMPLE].contains(&coverage.supersample()) {
            return Ok(coverage);
        }
        // A tile is a pixel.
        let grid = Grid::new(camera, MAX_SUPERSAMPLE);
        let size = [camera.width, camera.height].map(f64::from);
        let is_small_lamp = |face: &&Projected| {
            let [x, y] = [face.bounds.x, face.bounds.y].map(|[low, high]| 0.5 * (high - low));
            x * size[0] < SMALL && y * size[1] < SMALL && scene.material(face.number as usize).emits()
        };
        let small = Tiles::of(&grid, faces.iter().filter(is_small_lamp));
        let is_wanted = |(pixel, is_edge): (u32, bool)| {
            let place = [pixel % camera.width, pixel / camera.width];
            (is_edge || small.contain(place[0], place[1])) && among(place)
        };
        let member: Vec<bool> = (0..).zip(coverage.lamp_edges()).map(is_wanted).collect();
        if !member.contains(&true) {
            return Ok(coverage);
        }
        let tiles = Tiles::Some { columns: camera.width, member };
        let mut bands = Vec::new();
        self.coverage_of_bands(grid, scene, faces, &tiles, |band, coverage| {
            bands.push((band, coverage));
            Ok(())
        })?;
        Ok(coverage.with(&grid, &bands, &tiles))
    }

    /// What a camera sees of a scene whose vertices have moved. `before`: the vertices and the coverage
    /// before they moved. Only what moved faces may touch is computed anew. `before` must otherwise be of
    /// this scene, from the same camera.
    ///
    /// # Errors
    /// Fails as [`Self::coverage`] does.
    #[doc(hidden)]
    pub fn coverage_of_moved(
        &self,
        scene: &Scene,
        camera: &Camera,
        supersample: u32,
        before: (&[DVec3], &Coverage),
    ) -> Result<Coverage, ImageError> {
        self.backend.ranks().by_first(|| self.own_coverage_of_moved(scene, camera, supersample, before))
    }

    fn own_coverage_of_moved(
        &self,
        scene: &Scene,
        camera: &Camera,
        supersample: u32,
        (vertices, before): (&[DVec3], &Coverage),
    ) -> Result<Coverage, ImageError> {
        let grid = grid(camera, supersample)?;
        if vertices.len() != scene.vertices.len() || !before.fits(&grid, scene.triangles.len()) {
            return self.own_coverage(scene, camera, supersample);
        }
        let faces = rounded(project(scene, camera)?);
        let moved = |number: &u32| {
            let corners = scene.triangles[*number as usize].vertices;
            corners.iter().any(|&v| scene.vertices[v as usize] != vertices[v as usize])
        };
        let view = View::new(camera);
        let past = (0..scene.triangles.len() as u32).filter(moved).filter_map(|number| {
            let corners = scene.triangles[number as usize].vertices.map(|v| vertices[v as usize]);
            view.project(number, corners)
        });
        let past = rounded(past.collect());
        let present = faces.iter().filter(|face| moved(&face.number));
        // Whether a pixel has more samples depends on its neighbours.
        let tiles = Tiles::of(&grid, past.iter().chain(present)).with_neighbours(&grid);
        let longest = tiles.rows(&grid).into_iter().map(|rows| rows.len() as u32).max();
        let grid = grid.bands_up_to(longest.unwrap_or(0));
        let mut bands = Vec::new();
        self.coverage_of_bands(grid, scene, &faces, &tiles, |band, coverage| {
            bands.push((band, coverage));
            Ok(())
        })?;
        let coverage = before.with(&grid, &bands, &tiles);
        let is_new = |pixel: [u32; 2]| {
            let [column, row] = pixel.map(|at| at * grid.side / TILE);
            tiles.contain(column, row)
        };
        self.with_lamp_edges(scene, camera, &faces, coverage, is_new)
    }

    /// The visible face of every sample of a picture, `u32::MAX` where there is none: row by row from the top, each of
    /// `supersample` times the width of the camera. With s = `supersample`, sample (u, v) of a pixel is at (s u + s - 1/2 - v, s v + u + 1/2) / s²
    /// in it, see [`View::ray`](super::View::ray): a rotated grid.
    ///
    /// # Errors
    /// Fails if the scene, the camera or `supersample` is invalid, or if the device fails.
    #[doc(hidden)]
    pub fn visible_samples(
        &self,
        scene: &Scene,
        camera: &Camera,
        supersample: u32,
    ) -> Result<Vec<u32>, ImageError> {
        let grid = grid(camera, supersample)?;
        let faces = rounded(project(scene, camera)?);
        let mut samples = Vec::with_capacity(grid.width as usize * grid.height as usize);
        self.bands(grid, scene.triangles.len(), &faces, &Tiles::All, |_, of_band| {
            samples.extend(of_band);
            Ok(())
        })?;
        Ok(samples)
    }

    /// Calls `each` with the samples of each band that has `wanted` tiles, from the top.
    fn bands(
        &self,
        grid: Grid,
        triangles: usize,
        faces: &[Projected],
        wanted: &Tiles,
        mut each: impl FnMut(Band, &[u32]) -> Result<(), ImageError>,
    ) -> Result<(), ImageError> {
        let visibility = self.finder.on(grid, triangles as u64)?;
        for band in wanted.rows(&grid).into_iter().flat_map(|rows| grid.bands(rows)) {
            each(band, &visibility.samples(band, faces, wanted)?)?;
        }
        Ok(())
    }

    fn coverage_of_bands(
        &self,
        grid: Grid,
        scene: &Scene,
        faces: &[Projected],
        wanted: &Tiles,
        mut each: impl FnMut(Band, Coverage) -> Result<(), ImageError>,
    ) -> Result<(), ImageError> {
        let sides = Sides::new(scene, faces);
        self.bands(grid, scene.triangles.len(), faces, wanted, |band, samples| {
            each(band, Coverage::of_band(&grid, band, samples, &sides, wanted))
        })
    }

    /// Bytes of the backend's memory budget that [`coverage`](Self::coverage) takes for a scene of this many triangles: on a Vulkan device
    /// exactly, staging buffers included; on the CPU none.
    ///
    /// # Errors
    /// Fails if the camera or the options are invalid.
    #[doc(hidden)]
    pub fn bytes(
        backend: BackendKind,
        triangles: usize,
        camera: &Camera,
        options: &PictureOptions,
    ) -> Result<u64, ImageError> {
        let bytes = |grid: &Grid| visibility::bytes(backend, grid, triangles as u64);
        let coarse = bytes(&grid(camera, options.supersample)?);
        let fine = if options.supersample == 1 { 0 } else { bytes(&Grid::new(camera, MAX_SUPERSAMPLE)) };
        Ok(coarse.max(fine))
    }
}

/// The samples of a camera's picture.
pub(super) fn grid(camera: &Camera, supersample: u32) -> Result<Grid, ImageError> {
    camera.check()?;
    if !supersample.is_power_of_two() || supersample > MAX_SUPERSAMPLE {
        return Err(ImageError::Supersample(supersample));
    }
    Ok(Grid::new(camera, supersample))
}
