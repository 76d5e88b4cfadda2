//! Textures of mesh files, in linear light: their mean over a triangle, and their value at a point.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use glam::{DAffine2, DVec2, DVec3};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};

/// Most bytes that a texture may take in memory, and its file on disk.
const MOST_BYTES: u64 = 1 << 29;
/// Most texels along a side.
const MOST_TEXELS: u32 = 1 << 15;
/// Samples along a side of a triangle, at least and at most.
const SAMPLES: [f64; 2] = [4.0, 256.0];

/// A picture in linear RGB; texture coordinates (0, 0) are its upper left corner, and it repeats unless its map says otherwise.
#[derive(Debug)]
pub(super) struct Texture {
    width: u32,
    height: u32,
    texels: Texels,
    /// Light by the number of a texel.
    light: Vec<f32>,
    mean: OnceLock<DVec3>,
}

/// Texels as numbers of the file, so that a texture takes no more memory than its picture.
#[derive(Debug)]
enum Texels {
    Bytes(Vec<[u8; 3]>),
    Words(Vec<[u16; 3]>),
    /// Light itself, of a texture that is fitted.
    Light(Vec<DVec3>),
}

/// The value of a texture at a point, and its derivatives by the two texture coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Texel {
    pub value: DVec3,
    pub slope: [DVec3; 2],
}

/// A texture on the faces of a material, which it multiplies.
#[derive(Clone, Debug)]
pub(super) struct Map {
    pub texture: Arc<Texture>,
    /// Maps the texture coordinates of faces to those of the picture.
    pub place: DAffine2,
    /// How the picture goes on along both axes.
    pub wrap: [Wrap; 2],
}

/// How a picture goes on beyond its edges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// With itself, again and again.
    #[default]
    Repeat,
    /// With its outermost texels.
    Clamp,
    /// With its mirror image.
    Mirror,
}

impl Wrap {
    /// The coordinate within the picture that is looked up for one anywhere, and its derivative. `texels`: along the axis.
    fn within(self, x: f64, texels: f64) -> (f64, f64) {
        // Beyond the centres of the outermost texels a picture that repeats is linear towards those of the other edge.
        let edge = 0.5 / texels.max(1.0);
        let held = |x: f64, slope: f64| match x < edge || x > 1.0 - edge {
            true => (x.clamp(edge, 1.0 - edge), 0.0),
            false => (x, slope),
        };
        match self {
            Self::Repeat => (x, 1.0),
            Self::Clamp => held(x, 1.0),
            Self::Mirror => match x.rem_euclid(2.0) {
                x if x > 1.0 => held(2.0 - x, -1.0),
                x => held(x, 1.0),
            },
        }
    }
}

/// How the numbers of a picture become light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Encoding {
    /// sRGB, for colours.
    Srgb,
    /// Linear, for other quantities.
    Linear,
    /// That of opacity, linear, in place of all colours.
    Alpha,
}

/// The bytes of the file of a picture. Errors of these functions say what is wrong, without the file.
pub(super) fn read_picture(path: &Path) -> Result<Vec<u8>, String> {
    antirad_base::input::read_at_most(path, MOST_BYTES).map_err(|reason| format!("cannot be read: {reason}"))
}

/// A picture of any format.
pub(super) fn decode_picture(bytes: &[u8]) -> Result<DynamicImage, String> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MOST_TEXELS);
    limits.max_image_height = Some(MOST_TEXELS);
    limits.max_alloc = Some(MOST_BYTES);
    let mut reader = ImageReader::new(std::io::Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| error.to_string())?;
    reader.limits(limits);
    reader.decode().map_err(|error| format!("is no readable picture: {error}"))
}

/// Light of an sRGB value, both from 0 to 1 (IEC 61966-2-1).
pub fn linear_from_srgb(x: f64) -> f64 {
    if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// The inverse of [`linear_from_srgb`]: sRGB of light.
pub fn srgb_from_linear(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

impl Texture {
    /// Reads a PNG or JPEG; `None` for files of other kinds.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or is a PNG or JPEG that cannot be decoded. The error says what is
    /// wrong, without the file.
    pub fn read(path: &Path, encoding: Encoding) -> Result<Option<Self>, String> {
        Self::decode(&read_picture(path)?, encoding)
    }

    /// Decodes the bytes of a PNG or JPEG; `None` for other kinds.
    ///
    /// # Errors
    /// Fails if a PNG or JPEG cannot be decoded.
    pub fn decode(bytes: &[u8], encoding: Encoding) -> Result<Option<Self>, String> {
        match image::guess_format(bytes) {
            Ok(ImageFormat::Png | ImageFormat::Jpeg) => Ok(Some(Self::of(decode_picture(bytes)?, encoding))),
            _ => Ok(None),
        }
    }

    fn of(picture: DynamicImage, encoding: Encoding) -> Self {
        let light = |x: f64| match encoding {
            Encoding::Srgb => linear_from_srgb(x),
            Encoding::Linear | Encoding::Alpha => x,
        };
        let picture = if encoding == Encoding::Alpha { alpha(&picture) } else { picture };
        let table = |most: u32| (0..=most).map(|x| light(f64::from(x) / f64::from(most)) as f32).collect();
        let (width, height) = (picture.width(), picture.height());
        let bytes = picture.color().bytes_per_pixel() <= picture.color().channel_count();
        let (texels, light) = match bytes {
            true => (Texels::Bytes(rgb(picture.into_rgb8().into_raw())), table(u32::from(u8::MAX))),
            false => (Texels::Words(rgb(picture.into_rgb16().into_raw())), table(u32::from(u16::MAX))),
        };
        Self { width, height, texels, light, mean: OnceLock::new() }
    }

    /// Whether its texels are light, and not numbers of a file.
    pub fn is_light(&self) -> bool {
        matches!(self.texels, Texels::Light(_))
    }

    /// The texture as a PNG of 16 bits in sRGB; what is brighter than white is white.
    pub fn png(&self) -> Result<Vec<u8>, image::ImageError> {
        let number = |x: f64| (srgb_from_linear(x.clamp(0.0, 1.0)) * f64::from(u16::MAX)).round() as u16;
        let picture = image::ImageBuffer::from_fn(self.width, self.height, |x, y| {
            image::Rgb(self.texel(x, y).to_array().map(number))
        });
        let mut bytes = std::io::Cursor::new(Vec::new());
        DynamicImage::ImageRgb16(picture).write_to(&mut bytes, ImageFormat::Png)?;
        Ok(bytes.into_inner())
    }

    /// Whether both hold the same light, and no numbers of a file.
    pub fn same_light(&self, other: &Self) -> bool {
        match (&self.texels, &other.texels) {
            (Texels::Light(a), Texels::Light(b)) => a == b,
            _ => false,
        }
    }

    fn texel(&self, column: u32, row: u32) -> DVec3 {
        let at = row as usize * self.width as usize + column as usize;
        let numbers = match &self.texels {
            Texels::Bytes(texels) => texels.get(at).map(|rgb| rgb.map(usize::from)),
            Texels::Words(texels) => texels.get(at).map(|rgb| rgb.map(usize::from)),
            Texels::Light(texels) => return texels.get(at).copied().unwrap_or(DVec3::ONE),
        };
        numbers.map_or(DVec3::ONE, |rgb| DVec3::from(rgb.map(|x| f64::from(self.light[x]))))
    }

    /// The texel at texture coordinates.
    fn at(&self, uv: DVec2) -> DVec3 {
        let wrap = |x: f64, count: u32| {
            let along = (x - x.floor()) * f64::from(count);
            // NaN becomes 0.
            (along as u32).min(count.saturating_sub(1))
        };
        self.texel(wrap(uv.x, self.width), wrap(uv.y, self.height))
    }

    /// A texture of light, row by row from the top.
    pub fn of_light([width, height]: [u32; 2], texels: Vec<DVec3>) -> Self {
        Self { width, height, texels: Texels::Light(texels), light: Vec::new(), mean: OnceLock::new() }
    }

    /// The texture at texture coordinates, linear between the centres of texels.
    pub fn between_texels(&self, uv: DVec2) -> Texel {
        let (columns, x) = along(uv.x, self.width);
        let (rows, y) = along(uv.y, self.height);
        let [[a, b], [c, d]] = rows.map(|row| columns.map(|column| self.texel(column, row)));
        let (above, below) = (a.lerp(b, x), c.lerp(d, x));
        Texel {
            value: above.lerp(below, y),
            slope: [(b - a).lerp(d - c, y) * f64::from(self.width), (below - above) * f64::from(self.height)],
        }
    }

    /// Texels along each texture coordinate.
    pub fn size(&self) -> DVec2 {
        DVec2::new(f64::from(self.width), f64::from(self.height))
    }

    /// The mean over all texels.
    pub fn mean(&self) -> DVec3 {
        *self.mean.get_or_init(|| {
            let places = (0..self.height).flat_map(|row| (0..self.width).map(move |column| (column, row)));
            let sum: DVec3 = places.map(|(column, row)| self.texel(column, row)).sum();
            sum / (f64::from(self.width) * f64::from(self.height)).max(1.0)
        })
    }

    /// The mean over a triangle: of the texels at the centroids of equal parts, about as many as it has texels. `within`: the coordinates that
    /// are looked up.
    fn mean_over(&self, corners: [DVec2; 3], within: impl Fn(DVec2) -> DVec2) -> DVec3 {
        if corners.iter().any(|uv| !uv.is_finite()) {
            // The face has no texture coordinates.
            return self.mean();
        }
        let [a, b, c] = corners;
        let size = self.size();
        let texels = ((b - a) * size).perp_dot((c - a) * size).abs() / 2.0;
        let n = (2.0 * texels).sqrt().ceil().clamp(SAMPLES[0], SAMPLES[1]) as u32;
        let mut sum = DVec3::ZERO;
        let step = 1.0 / (3.0 * f64::from(n));
        for i in 0..n {
            for j in 0..n - i {
                let (u, v) = (f64::from(3 * i + 1) * step, f64::from(3 * j + 1) * step);
                sum += self.at(within(a + (b - a) * u + (c - a) * v));
                if i + j + 1 < n {
                    // The part that points the other way.
                    sum += self.at(within(a + (b - a) * (u + step) + (c - a) * (v + step)));
                }
            }
        }
        sum / f64::from(n * n)
    }
}

/// Of texels that repeat along an axis, the one before and the one after a texture coordinate, and how far it is to the latter in
/// texels. What is no number becomes 0.
fn along(x: f64, count: u32) -> ([u32; 2], f64) {
    let x = if x.is_finite() { x } else { 0.0 };
    let texels = (x - x.floor()) * f64::from(count) + f64::from(count) - 0.5;
    let before = texels.floor();
    let before_index = before as u64 % u64::from(count.max(1));
    ([before_index as u32, ((before_index + 1) % u64::from(count.max(1))) as u32], texels - before)
}

/// The weights of four texels in [`Texture::between_texels`], by their index row by row.
pub(super) fn weights([width, height]: [u32; 2], uv: DVec2) -> [(u32, f64); 4] {
    let ((columns, x), (rows, y)) = (along(uv.x, width), along(uv.y, height));
    let weight = |row: usize, column: usize| {
        let (across, down) = ([1.0 - x, x][column], [1.0 - y, y][row]);
        (rows[row] * width + columns[column], across * down)
    };
    [weight(0, 0), weight(0, 1), weight(1, 0), weight(1, 1)]
}

/// The opacity of a picture, in grey.
fn alpha(picture: &DynamicImage) -> DynamicImage {
    let rgba = picture.to_rgba8();
    image::GrayImage::from_fn(rgba.width(), rgba.height(), |x, y| image::Luma([rgba.get_pixel(x, y)[3]]))
        .into()
}

/// Three numbers each.
fn rgb<T: Copy>(numbers: Vec<T>) -> Vec<[T; 3]> {
    numbers.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]]).collect()
}

impl Map {
    /// A map that repeats a texture.
    pub fn repeated(texture: Arc<Texture>, place: DAffine2) -> Self {
        Self { texture, place, wrap: [Wrap::Repeat; 2] }
    }

    /// Coordinates within the picture for those of the picture anywhere, and their derivatives.
    fn within(&self, at: DVec2) -> (DVec2, DVec2) {
        let size = self.texture.size();
        let (x, by_x) = self.wrap[0].within(at.x, size.x);
        let (y, by_y) = self.wrap[1].within(at.y, size.y);
        (DVec2::new(x, y), DVec2::new(by_x, by_y))
    }

    /// The value at texture coordinates of faces, and its derivatives by them.
    pub fn at(&self, uv: DVec2) -> Texel {
        let (within, by) = self.within(self.place.transform_point2(uv));
        let Texel { value, slope: [by_x, by_y] } = self.texture.between_texels(within);
        let (by_x, by_y) = (by_x * by.x, by_y * by.y);
        let DAffine2 { matrix2, .. } = self.place;
        let slope = [matrix2.x_axis, matrix2.y_axis].map(|axis| by_x * axis.x + by_y * axis.y);
        Texel { value, slope }
    }

    /// How many texels a triangle with these texture coordinates is wide.
    pub fn texels_across(&self, corners: [DVec2; 3]) -> f64 {
        let [a, b, c] = corners.map(|uv| self.place.transform_point2(uv) * self.texture.size());
        a.distance(b).max(b.distance(c)).max(c.distance(a))
    }

    /// The mean over a triangle with the given texture coordinates.
    pub fn mean_over(&self, corners: [DVec2; 3]) -> DVec3 {
        self.texture.mean_over(corners.map(|uv| self.place.transform_point2(uv)), |at| self.within(at).0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    /// Columns of black and white.
    fn stripes(width: u32) -> Texture {
        let picture = RgbImage::from_fn(width, width, |x, _| Rgb([if x % 2 == 0 { 255 } else { 0 }; 3]));
        Texture::of(DynamicImage::from(picture), Encoding::Srgb)
    }

    const HALF: [DVec2; 3] = [DVec2::ZERO, DVec2::X, DVec2::ONE];

    impl Texture {
        fn repeated_mean(&self, corners: [DVec2; 3]) -> DVec3 {
            self.mean_over(corners, |at| at)
        }
    }

    /// Pictures of four texels along u that go on to the right and to the left in three ways; the slope is that of differences.
    #[test]
    fn pictures_go_on_beyond_their_edges() {
        let numbers = [10u8, 60, 90, 200];
        let picture = RgbImage::from_fn(4, 1, |x, _| Rgb([numbers[x as usize]; 3]));
        let texture = Arc::new(Texture::of(DynamicImage::from(picture), Encoding::Linear));
        for (wrap, right, left) in [
            (Wrap::Repeat, [10, 60, 90, 200], [10, 60, 90, 200]),
            (Wrap::Clamp, [200; 4], [10; 4]),
            (Wrap::Mirror, [200, 90, 60, 10], [200, 90, 60, 10]),
        ] {
            let map = Map { wrap: [wrap; 2], ..Map::repeated(texture.clone(), DAffine2::IDENTITY) };
            let value = |x: f64| map.at(DVec2::new(x, 0.3)).value.x;
            for k in 0..4 {
                let centre = (k as f64 + 0.5) / 4.0;
                assert!((255.0 * value(1.0 + centre) - f64::from(right[k])).abs() < 1e-4, "{wrap:?}, {k}");
                assert!((255.0 * value(centre - 1.0) - f64::from(left[k])).abs() < 1e-4, "{wrap:?}, {k}");
                let corner = |x: f64, y: f64| DVec2::new(1.0 + centre + 0.1 * x, y);
                let mean = map.mean_over([corner(-1.0, 0.0), corner(1.0, 0.0), corner(0.0, 0.5)]);
                assert!((255.0 * mean.x - f64::from(right[k])).abs() < 1e-3, "{wrap:?}, {k}: {mean}");
            }
            for x in [-1.3, -0.01, 0.4, 0.99, 1.01, 1.45, 2.3] {
                let difference = (value(x + 1e-6) - value(x - 1e-6)) / 2e-6;
                let slope = map.at(DVec2::new(x, 0.3)).slope[0].x;
                assert!((slope - difference).abs() < 1e-6, "{wrap:?}, {x}: {slope} {difference}");
            }
        }
        assert!(Wrap::Mirror.within(f64::NAN, 4.0).0.is_nan());
    }

    #[test]
    fn means_are_of_light() {
        let grey = DynamicImage::from(RgbImage::from_pixel(3, 3, Rgb([188, 128, 0])));
        let mean = Texture::of(grey.clone(), Encoding::Srgb).repeated_mean(HALF);
        assert!(mean.abs_diff_eq(DVec3::new(0.5029, 0.2159, 0.0), 1e-4), "{mean}");
        let mean = Texture::of(grey, Encoding::Linear).mean();
        assert!(mean.abs_diff_eq(DVec3::new(188.0, 128.0, 0.0) / 255.0, 1e-4), "{mean}");
        // The white columns are the left ones of each pair, where the triangle is lower. Not the light of the mean number, 0.21.
        for width in [2, 16, 300] {
            let (mean, white) = (stripes(width).repeated_mean(HALF).x, 0.5 - 0.5 / f64::from(width));
            assert!((mean - white).abs() <= 0.01, "{width}: {mean}, not {white}");
        }
    }

    /// Against the exact integral of a ramp over the triangle.
    #[test]
    fn a_ramp_has_the_value_of_its_centroid() {
        let ramp = RgbImage::from_fn(256, 256, |x, y| Rgb([x as u8, y as u8, 0]));
        let ramp = Texture::of(DynamicImage::from(ramp), Encoding::Linear);
        let corners = [[0.1, 0.2], [0.9, 0.3], [0.4, 0.8]].map(DVec2::from);
        let centroid = (corners[0] + corners[1] + corners[2]) / 3.0;
        let mean = ramp.repeated_mean(corners);
        assert!((mean.truncate() - centroid).abs().max_element() <= 0.003, "{mean} {centroid}");
        // The other way around, and one period further.
        let moved = [corners[2], corners[1], corners[0]].map(|uv| uv + DVec2::new(-3.0, 7.0));
        assert!(ramp.repeated_mean(moved).abs_diff_eq(mean, 0.003));
        // A triangle without area in the picture has the texel there.
        assert!(ramp.repeated_mean([centroid; 3]).truncate().abs_diff_eq(centroid, 0.004));
        assert!(ramp.repeated_mean([DVec2::NAN; 3]).is_finite());
    }

    /// Texels at their centres, and derivatives by central differences, in pictures of 8 and of 16 bits.
    #[test]
    fn values_between_texels_are_linear() {
        let number = |x: u32, y: u32, c: u32| (37 * x + 59 * y + 101 * c) % 256;
        let bytes = RgbImage::from_fn(5, 3, |x, y| Rgb([0, 1, 2].map(|c| number(x, y, c) as u8)));
        let words = DynamicImage::from(bytes.clone()).into_rgb16();
        for picture in [DynamicImage::from(bytes), DynamicImage::from(words)] {
            let texture = Texture::of(picture, Encoding::Linear);
            let place =
                DAffine2::from_scale_angle_translation(DVec2::new(0.7, -1.3), 0.4, DVec2::new(3.0, -2.0));
            let map = Map::repeated(Arc::new(texture), place);
            let centre = map.place.inverse().transform_point2(DVec2::new(3.5 / 5.0, 1.5 / 3.0));
            let expected = DVec3::from([0, 1, 2].map(|c| f64::from(number(3, 1, c)) / 255.0));
            assert!(map.at(centre).value.abs_diff_eq(expected, 1e-6), "{:?}", map.at(centre));
            for k in 0..40 {
                let uv = DVec2::new((1.7 * f64::from(k)).sin(), (2.9 * f64::from(k)).cos()) * 2.0;
                for (axis, slope) in [DVec2::X, DVec2::Y].into_iter().zip(map.at(uv).slope) {
                    let step = 1e-7 * axis;
                    let difference = (map.at(uv + step).value - map.at(uv - step).value) / 2e-7;
                    assert!(slope.abs_diff_eq(difference, 1e-5), "{uv}: {slope} {difference}");
                }
            }
            assert!(map.at(DVec2::NAN).value.is_finite());
        }
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        for bytes in [&b"\x89PNG\r\n\x1a\n"[..], b"\xff\xd8\xff"] {
            Texture::decode(bytes, Encoding::Srgb).expect_err("no picture");
        }
        for bytes in [&b""[..], b"GIF89a"] {
            assert!(Texture::decode(bytes, Encoding::Srgb).is_ok_and(|texture| texture.is_none()));
        }
        // A PNG that claims 2 GB.
        let mut huge = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        huge.extend([0, 0, 0x60, 0, 0, 0, 0x60, 0, 8, 2, 0, 0, 0]);
        let mut crc = 0xffff_ffff_u32;
        for &byte in &huge[12..] {
            crc ^= u32::from(byte);
            for _ in 0..8 {
                crc = if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
            }
        }
        huge.extend((!crc).to_be_bytes());
        huge.extend(b"\0\0\0\0IDAT\x35\xaf\x06\x1e");
        let error = Texture::decode(&huge, Encoding::Srgb).expect_err("2 GB");
        assert!(error.contains("imit"), "{error}");
    }
}
