//! Light from all around, from beyond the scene.
//!
//! A sky is a cube around everything that emits inwards: its faces are few polygons, so that their light has exact visibility like that
//! of other lamps. The light of a uniform sky is exact wherever its cube stands. That of a picture is uniform over each of the
//! squares of the cube's faces, and comes from a finite distance: directions are off by up to 1/[`FAR`].

use std::f64::consts::{FRAC_PI_4, PI, TAU};
use std::path::Path;

use glam::{DMat3, DVec3};
use image::ImageFormat;

use super::check::check_light;
use super::texture::{decode_picture, linear_from_srgb, read_picture};
use super::{Material, Mesh, Origin, Scene, Triangle, bounds};
use antirad_base::output::free_name;

/// Name of the mesh of a sky; further ones have numbers.
pub(super) const NAME: &str = "sky";

/// Squares along an edge of the cube for a picture: 96 in all, fewer than the lamps whose light is exact unless stated. Even, so that
/// none reaches over the horizon, where pictures of skies have an edge.
const SQUARES: usize = 4;

/// Half an edge of the cube, in distances from the middle of the scene to its farthest vertex or camera: uniform, and of a picture.
const AROUND: f64 = 1.25;
const FAR: f64 = 8.0;

/// The outward normals of the faces, and two directions along each, so that their cross product points inwards.
const FACES: [[DVec3; 3]; 6] = [
    [DVec3::X, DVec3::Z, DVec3::Y],
    [DVec3::NEG_X, DVec3::Y, DVec3::Z],
    [DVec3::Y, DVec3::X, DVec3::Z],
    [DVec3::NEG_Y, DVec3::Z, DVec3::X],
    [DVec3::Z, DVec3::Y, DVec3::X],
    [DVec3::NEG_Z, DVec3::X, DVec3::Y],
];

/// Radiance that comes from all around.
#[derive(Clone, Debug, PartialEq)]
pub struct Sky {
    /// Squares along an edge of each face.
    squares: usize,
    /// W/(m² sr), by face, then row, then column.
    radiance: Vec<[f64; 3]>,
}

impl Sky {
    /// A sky of equal radiance from all directions, W/(m² sr).
    pub fn uniform(radiance: [f64; 3]) -> Self {
        Self { squares: 1, radiance: vec![radiance; 6] }
    }

    /// Reads an equirectangular picture, PNG or JPEG in sRGB, Radiance HDR or OpenEXR: its upper edge is +y,
    /// its middle −z, and +x is to the right of that. Its light is that of the file, in W/(m² sr), times
    /// `scale`; over each square, the mean over its directions.
    ///
    /// # Errors
    /// Fails if the picture cannot be read or decoded, or if its radiance is negative or not finite. The
    /// error says what is wrong, without the file.
    pub fn read(path: &Path, scale: [f64; 3]) -> Result<Self, String> {
        Self::read_turned(path, scale, DMat3::IDENTITY)
    }

    /// Reads a picture as [`Self::read`] does, with its directions turned.
    pub(super) fn read_turned(path: &Path, scale: [f64; 3], turn: DMat3) -> Result<Self, String> {
        let bytes = read_picture(path)?;
        let linear = matches!(image::guess_format(&bytes), Ok(ImageFormat::OpenExr | ImageFormat::Hdr));
        let picture = decode_picture(&bytes)?.into_rgb32f();
        let (width, height) = picture.dimensions();
        let light = |x: f32| if linear { f64::from(x) } else { linear_from_srgb(x.into()) };
        let texel = |column: u32, row: u32| DVec3::from(picture.get_pixel(column, row).0.map(light));
        let sky = Self::of_texels([width, height], texel, DVec3::from(scale), turn);
        sky.check().map(|()| sky)
    }

    /// Checks the radiance of all squares.
    ///
    /// # Errors
    /// Fails unless all radiance is finite, not negative, and at most 1e100 W/(m² sr).
    pub fn check(&self) -> Result<(), String> {
        check_light(self.radiance.as_flattened().iter().copied())
            .map_err(|wrong| format!("has a radiance of {wrong}"))
    }

    /// The mean over the directions of each square. Light adds up, so that the smallest sun is not lost.
    fn of_texels(
        [width, height]: [u32; 2],
        texel: impl Fn(u32, u32) -> DVec3,
        scale: DVec3,
        turn: DMat3,
    ) -> Self {
        let mut sums = vec![(DVec3::ZERO, 0.0); 6 * SQUARES * SQUARES];
        let mut add = |direction: DVec3, light: DVec3, solid_angle: f64| {
            let (sum, all) = &mut sums[square_of(direction)];
            *sum += solid_angle * light;
            *all += solid_angle;
        };
        // A texel of a small picture may reach over several squares.
        let parts = |count: u32, least: u32| least.div_ceil(count.max(1));
        let (across, down) = (parts(width, 256), parts(height, 128));
        let (columns, rows) = (width * across, height * down);
        for row in 0..rows {
            let [above, below] = [row, row + 1].map(|r| (PI * f64::from(r) / f64::from(rows)).cos());
            let solid_angle = (above - below) * TAU / f64::from(columns);
            let cosine = 0.5 * (above + below);
            let sine = (1.0 - cosine * cosine).sqrt();
            for column in 0..columns {
                let angle = TAU * ((f64::from(column) + 0.5) / f64::from(columns) - 0.5);
                let direction = DVec3::new(sine * angle.sin(), cosine, -sine * angle.cos());
                add(turn * direction, texel(column / across, row / down), solid_angle);
            }
        }
        let mean = |(sum, all): (DVec3, f64)| (scale * sum / all).to_array();
        Self { squares: SQUARES, radiance: sums.into_iter().map(mean).collect() }
    }
}

/// The square of a picture's cube that a direction meets.
fn square_of(direction: DVec3) -> usize {
    let along = |face: &[DVec3; 3]| direction.dot(face[0]);
    let faces = FACES.iter().enumerate();
    let (number, face) =
        faces.max_by(|(_, a), (_, b)| along(a).total_cmp(&along(b))).unwrap_or((0, &FACES[0]));
    // Of equal angles, so that squares have nearly the same solid angle.
    let place = |axis: DVec3| {
        let angle = (direction.dot(axis) / along(face)).atan() / FRAC_PI_4;
        ((0.5 * (angle + 1.0) * SQUARES as f64) as usize).min(SQUARES - 1)
    };
    (number * SQUARES + place(face[2])) * SQUARES + place(face[1])
}

impl Scene {
    /// Adds the mesh "sky": a cube around everything, cameras included, that emits inwards and reflects nothing.
    pub fn add_sky(&mut self, sky: &Sky) {
        let used = self.triangles.iter().flat_map(|t| t.vertices).map(|v| self.vertices[v as usize]);
        let (low, high) = bounds(used);
        let middle = low.midpoint(high);
        let farthest =
            |places: &mut dyn Iterator<Item = DVec3>| places.map(|x| x.distance(middle)).fold(0.0, f64::max);
        let reach = farthest(&mut self.vertices.iter().copied())
            .max(farthest(&mut self.cameras.iter().map(|camera| camera.position)));
        let half = reach * if sky.squares == 1 { AROUND } else { FAR };

        let (first_vertex, first) = (self.vertices.len() as u32, self.triangles.len() as u32);
        let corners = sky.squares as u32 + 1;
        // Faces share no vertices: they meet at edges all the same.
        for [out, right, up] in FACES {
            let along = |k: u32| (FRAC_PI_4 * (2.0 * f64::from(k) / f64::from(corners - 1) - 1.0)).tan();
            let rows = (0..corners).flat_map(|row| (0..corners).map(move |column| (row, column)));
            let corner = |(row, column)| middle + half * (out + along(column) * right + along(row) * up);
            self.vertices.extend(rows.map(corner));
        }
        let mut names: Vec<String> = Vec::new();
        for (number, radiance) in sky.radiance.iter().enumerate() {
            let known =
                self.materials.iter().rposition(|m| names.contains(&m.name) && m.emission == *radiance);
            let material = known.unwrap_or_else(|| {
                let name = self.free_material_name(NAME);
                names.push(name.clone());
                self.materials.push(Material { emission: *radiance, ..Material::named(name) });
                self.materials.len() - 1
            }) as u32;
            let (face, row, column) = (
                (number / (sky.squares * sky.squares)) as u32,
                (number / sky.squares % sky.squares) as u32,
                (number % sky.squares) as u32,
            );
            let at = |row: u32, column: u32| first_vertex + (face * corners + row) * corners + column;
            let [a, b, c, d] =
                [at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)];
            self.triangles.extend([[a, b, c], [a, c, d]].map(|vertices| Triangle { vertices, material }));
        }
        let name = free_name(NAME, |name| self.meshes.iter().all(|mesh| mesh.name != name));
        self.meshes.push(Mesh { name, range: first..self.triangles.len() as u32 });
        if !self.origins.is_empty() {
            self.origins.push(Origin::default());
        }
        self.update_degenerate();
    }

    fn free_material_name(&self, name: &str) -> String {
        free_name(name, |name| self.materials.iter().all(|m| m.name != name))
    }
}
