//! Error estimates of an answer, from the answer itself and a comparison solve with other settings.

use super::Answer;
use super::mesh::MeshError;
use super::pictures::Visible;
use super::surface::Surface;
use crate::image::ImageError;
use crate::shading::{Light, Shading};
use antirad_core::Energy;
use antirad_scene::{Edges, Scene, Welded};
use glam::DVec3;
use serde::Serialize;
use std::fmt;

/// Estimated errors of an answer on the triangles of the solved scene, as fractions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorEstimate {
    /// The largest of those of irradiance and pictures.
    pub total: f64,
    /// Error of the irradiance.
    pub irradiance: IrradianceEstimate,
    /// Errors of the pictures, one per camera.
    pub pictures: Vec<PictureEstimate>,
}

/// Error of the mean irradiance of triangles: relative L2, area-weighted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct IrradianceEstimate {
    /// Root of the sum of squares of `compared`, `mesh`, `residual` and `sampling`, whose causes are independent; at
    /// least `balance`.
    pub total: f64,
    /// Difference from a solve with fewer bins and half the rays.
    pub compared: f64,
    /// A quarter of the deviation of triangles from the mean of their coplanar neighbours: an estimate of the difference
    /// between the mean over a triangle and the value at its centroid.
    pub mesh: f64,
    /// The residual over 1 - spectral radius.
    pub residual: f64,
    /// Standard error of direct light by rays; zero where its visibility is exact.
    pub sampling: f64,
    /// Share of the emitted power that is not absorbed; zero in an exact solution. Closed scenes only.
    pub balance: Option<f64>,
}

/// Error of a camera's picture, gathered or with one colour per triangle: relative L2 over its pixels. Reflected light only, since
/// a lamp in view is exact and would outshine every error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PictureEstimate {
    /// Name of the camera.
    pub camera: String,
    /// Root of the sum of squares of the parts.
    pub total: f64,
    /// Difference from the comparison solve, as in [`IrradianceEstimate::compared`].
    pub compared: f64,
    /// Variation of light within triangles that the picture does not show. With one colour per triangle, from the differences
    /// between coplanar neighbours of one material: shadow edges, for example. In gathered pictures, of indirect light: from how
    /// much interpolation between triangles blurs it.
    pub within: f64,
    /// The residual over 1 - spectral radius, as in [`IrradianceEstimate::residual`].
    pub residual: f64,
    /// Standard error of rays: of direct light, as in [`IrradianceEstimate::sampling`], and of what glossy
    /// faces mirror.
    pub sampling: f64,
}

impl ErrorEstimate {
    /// `own` is the answer, `other` that of the comparison solve. Returns with it what a finer mesh would mend: [`IrradianceEstimate::mesh`], and of each picture
    /// [`PictureEstimate::within`].
    pub(super) fn new(
        scene: &Scene,
        own: &Answer,
        other: &Answer,
        visible: &[Visible],
        shading: Shading,
    ) -> Result<(Self, Vec<MeshError>), ImageError> {
        let gathered = shading == Shading::Gathered;
        let surface = Surface::new(scene);
        let left = 1.0 - own.info.spectral_radius.unwrap_or(0.0).clamp(0.0, 0.999);
        let residual = own.info.residuals.last().copied().unwrap_or(0.0) / left;
        let known = [residual, own.sampling_error];
        let (irradiance, mesh) = IrradianceEstimate::new(scene, &surface, own, other, known);
        let mut of_mesh = vec![mesh];
        let colours = own.colours.iter().zip(&other.colours);
        let pictures: Vec<PictureEstimate> = visible
            .iter()
            .zip(colours)
            .enumerate()
            .map(|(view, (visible, colours))| {
                let differences = match gathered {
                    true => Differences::of_gathered([&own.light, &other.light], view, visible)?,
                    false => Differences::of_faces(scene, &surface, visible, colours),
                };
                let picture = PictureEstimate::new(visible, &differences, known);
                of_mesh.push(differences.within);
                Ok(picture)
            })
            .collect::<Result<_, ImageError>>()?;
        let total = pictures.iter().map(|picture| picture.total).fold(irradiance.total, f64::max);
        Ok((Self { total, irradiance, pictures }, of_mesh))
    }
}

impl IrradianceEstimate {
    fn new(
        scene: &Scene,
        surface: &Surface,
        own: &Answer,
        other: &Answer,
        [residual, sampling]: [f64; 2],
    ) -> (Self, MeshError) {
        let values = vectors(&own.irradiance);
        let norm = |of: &dyn Fn(usize) -> DVec3| norm(&surface.weights, of);
        let all = norm(&|i| values[i]);
        let compared = relative_to(all)(norm(&|i| values[i] - DVec3::from(other.irradiance[i])));
        let of_mesh = MeshError::new(&surface.weights, &|i| surface.off_neighbours(&values, i), all);
        let mesh = of_mesh.total();
        let parts = root_of_squares([compared, mesh, residual, sampling]);
        let sum = |rgb: [f64; 3]| rgb.iter().sum::<f64>();
        let Energy { emitted, escaped, unaccounted, .. } = own.energy;
        let missing = (sum(escaped) + sum(unaccounted)) / sum(emitted).max(f64::MIN_POSITIVE);
        let balance = is_closed(scene).then_some(missing.abs());
        let total = balance.map_or(parts, |balance| parts.max(balance));
        (Self { total, compared, mesh, residual, sampling, balance }, of_mesh)
    }
}

/// L2 norms over the pixels of a picture, and two differences relative to it.
struct Differences {
    /// Difference from the comparison solve.
    compared: f64,
    /// Variation of light within triangles that the picture does not show, as in [`PictureEstimate::within`].
    within: MeshError,
    /// Standard error of reflections by rays.
    rays: f64,
}

impl Differences {
    /// Differences of pictures with one colour per triangle.
    fn of_faces(
        scene: &Scene,
        surface: &Surface,
        visible: &Visible,
        (own, other): (&Vec<[f64; 3]>, &Vec<[f64; 3]>),
    ) -> Self {
        let reflected = |colours: &[[f64; 3]]| -> Vec<DVec3> {
            let of = |(i, colour): (usize, &[f64; 3])| match visible.fronts[i] {
                true => DVec3::from(*colour) - DVec3::from(scene.material(i).emission),
                false => DVec3::ZERO,
            };
            colours.iter().enumerate().map(of).collect()
        };
        let (own, other) = (reflected(own), reflected(other));
        let norm = |of: &dyn Fn(usize) -> DVec3| norm(&visible.samples, of);
        let all = norm(&|i| own[i]);
        Self {
            compared: relative_to(all)(norm(&|i| own[i] - other[i])),
            within: MeshError::new(&visible.samples, &|i| surface.within(&own, i), all),
            rays: 0.0,
        }
    }

    /// Differences of gathered pictures.
    fn of_gathered([own, other]: [&Light; 2], view: usize, visible: &Visible) -> Result<Self, ImageError> {
        let blur = own.blur();
        let reflected = |light: &Light| light.reflected(view, &visible.coverage);
        let ((own, rays), (other, _)) = (reflected(own)?, reflected(other)?);
        let pixels = vec![1.0; own.len()];
        let all = norm(&pixels, &|i| own[i]);
        Ok(Self {
            compared: relative_to(all)(norm(&pixels, &|i| own[i] - other[i])),
            within: MeshError::new(&visible.samples, &|i| blur[i], all),
            rays,
        })
    }
}

impl PictureEstimate {
    fn new(
        visible: &Visible,
        Differences { compared, within, rays }: &Differences,
        [residual, sampling]: [f64; 2],
    ) -> Self {
        let (compared, within) = (*compared, within.total());
        let sampling = root_of_squares([sampling, *rays]);
        let total = root_of_squares([compared, within, residual, sampling]);
        Self { camera: visible.camera.clone(), total, compared, within, residual, sampling }
    }
}

impl fmt::Display for ErrorEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let IrradianceEstimate { total, compared, mesh, residual, sampling, balance } = self.irradiance;
        let percent = |share: f64| format!("{:.2} %", 100.0 * share);
        write!(
            f,
            "{} of irradiance (comparison {}, mesh {}, residual {}",
            percent(total),
            percent(compared),
            percent(mesh),
            percent(residual)
        )?;
        if sampling > 0.0 {
            write!(f, ", rays {}", percent(sampling))?;
        }
        if let Some(balance) = balance {
            write!(f, ", energy {}", percent(balance))?;
        }
        f.write_str(")")?;
        for PictureEstimate { camera, total, compared, within, .. } in &self.pictures {
            write!(
                f,
                ", {} of picture {camera} (comparison {}, within triangles {})",
                percent(*total),
                percent(*compared),
                percent(*within)
            )?;
        }
        Ok(())
    }
}

fn vectors(rows: &[[f64; 3]]) -> Vec<DVec3> {
    rows.iter().copied().map(DVec3::from).collect()
}

fn root_of_squares<const N: usize>(parts: [f64; N]) -> f64 {
    parts.iter().map(|part| part * part).sum::<f64>().sqrt()
}

fn norm(weights: &[f64], of: &dyn Fn(usize) -> DVec3) -> f64 {
    weights.iter().enumerate().map(|(i, weight)| weight * of(i).length_squared()).sum::<f64>().sqrt()
}

/// Relative to `all`; zero where there is no light.
fn relative_to(all: f64) -> impl Fn(f64) -> f64 {
    move |error| if all > 0.0 { error / all } else { 0.0 }
}

/// Whether no light can escape: the triangles at each edge traverse it equally often in both directions, and the fronts enclose
/// a volume. A box without a bottom on the floor makes a room look open, which only costs the energy check.
fn is_closed(scene: &Scene) -> bool {
    let volume = |triangle: usize| {
        let [a, b, c] = scene.corners(triangle);
        a.dot(b.cross(c)) / 6.0
    };
    let volume: f64 = (0..scene.triangles.len()).map(volume).sum();
    let welded = Welded::exactly(scene.vertices.iter().copied());
    let edges = Edges::of(scene.triangles.iter().map(|t| welded.positions(t.vertices)));
    volume < 0.0 && edges.iter().all(|edge| edge.balance() == 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::{Material, SceneBuilder, Shape};
    use glam::DAffine3;

    fn scene(shape: Shape) -> Scene {
        let mut builder = SceneBuilder::new();
        builder.shape("shape", shape, &Material::named("grey"), DAffine3::IDENTITY);
        builder.finish("scene").expect("a scene")
    }

    #[test]
    fn rooms_are_closed_and_boxes_and_sheets_are_not() {
        assert!(is_closed(&scene(Shape::Room { cells: 3 })));
        assert!(!is_closed(&scene(Shape::Box { cells: 3 })));
        assert!(!is_closed(&scene(Shape::Quad { cells: 3 })));
    }
}
