//! Photographs: pictures of any program or camera, as linear RGB.

mod average;
mod codecs;
mod exif;
mod labels;
mod layers;
mod mask;
mod resample;

pub use labels::{Label, PhotoLabels};
pub use mask::PhotoMask;

use antirad_base::parallel;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use ::image::ImageFormat;
use ::image::metadata::Orientation;

use super::ImageError;
use super::picture::MAX_PIXELS;

/// A picture in linear RGB. Values of integer formats are decoded from sRGB, with 1 for white; those of float formats are taken as they are.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row from the top.
    pub pixels: Vec<[f32; 3]>,
    /// Per pixel, whether a channel is at the end of the file's scale, so that its value is only a lower bound.
    pub clipped: Vec<bool>,
    /// Whether the format ends at white: integers do, floats do not.
    pub ends_at_white: bool,
    /// Exposure time in seconds times ISO over the square of the f-number, where the file has all three: how bright it makes a scene, up to
    /// a factor of the camera.
    pub exposure: Option<f64>,
}

/// What a file holds, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Exr,
    Other(ImageFormat),
}

impl Photo {
    /// Reads an EXR, PNG, JPEG, TIFF or Radiance HDR, whatever its suffix, turned upright as its EXIF data say. `layer` is that of an
    /// EXR, such as `ViewLayer.Combined`; without, it is the one without a name, or the only one.
    ///
    /// # Errors
    /// Fails if the file cannot be read, is in no known format, or if it has several layers and none is chosen.
    pub fn read(path: &Path, layer: Option<&str>) -> Result<Self, ImageError> {
        let (mut photo, turned) = Self::read_as_stored(path, layer)?;
        if let Some(turned) = turned {
            photo.turn(turned);
        }
        Ok(photo)
    }

    /// Reads a picture that should have one of some sizes: upright, unless it only has such a size as it is stored. Programs that
    /// find the poses of cameras do not all turn pictures.
    ///
    /// # Errors
    /// As [`Photo::read`].
    pub fn read_of_size(
        path: &Path,
        layer: Option<&str>,
        suits: impl Fn([u32; 2]) -> bool,
    ) -> Result<Self, ImageError> {
        let (mut photo, turned) = Self::read_as_stored(path, layer)?;
        if let Some(turned) = turned {
            let stored = [photo.width, photo.height];
            if suits(upright(stored, turned)) || !suits(stored) {
                photo.turn(turned);
            }
        }
        Ok(photo)
    }

    /// Columns and rows of a file, upright, without reading its pixels.
    ///
    /// # Errors
    /// Fails if the file cannot be read or is in no known format.
    pub fn size(path: &Path) -> Result<[u32; 2], ImageError> {
        let measure = || match open(path)? {
            (Kind::Exr, file) => layers::size(file),
            (Kind::Other(format), file) => codecs::size(file, format),
        };
        measure().map_err(|reason| ImageError::Photo { path: path.to_path_buf(), reason })
    }

    fn read_as_stored(path: &Path, layer: Option<&str>) -> Result<(Self, Option<Orientation>), ImageError> {
        let read = || match (open(path)?, layer) {
            ((Kind::Exr, file), layer) => Ok((layers::read(file, layer)?, None)),
            ((Kind::Other(_), _), Some(layer)) => {
                Err(format!("it is no EXR and has no layer \"{layer}\"; leave `layer` out"))
            }
            ((Kind::Other(format), file), None) => codecs::read(file, format),
        };
        read().map_err(|reason| ImageError::Photo { path: path.to_path_buf(), reason })
    }

    /// The picture with another value for each one that sRGB gave, where its format ends at white: that of another response.
    #[must_use]
    pub fn decoded_again(mut self, decode: impl Fn(f64) -> f64 + Sync) -> Self {
        if self.ends_at_white {
            let decoded = |value: f32| decode(f64::from(value)) as f32;
            parallel::each(&mut self.pixels, |pixel| *pixel = pixel.map(decoded));
        }
        self
    }

    fn turn(&mut self, turned: Orientation) {
        let [width, height] = [self.width as usize, self.height as usize];
        let [new_width, new_height] = upright([self.width, self.height], turned);
        let from = |x: usize, y: usize| match turned {
            Orientation::NoTransforms => (x, y),
            Orientation::Rotate90 => (y, height - 1 - x),
            Orientation::Rotate180 => (width - 1 - x, height - 1 - y),
            Orientation::Rotate270 => (width - 1 - y, x),
            Orientation::FlipHorizontal => (width - 1 - x, y),
            Orientation::FlipVertical => (x, height - 1 - y),
            Orientation::Rotate90FlipH => (y, x),
            Orientation::Rotate270FlipH => (width - 1 - y, height - 1 - x),
        };
        let places: Vec<usize> = (0..new_height as usize)
            .flat_map(|y| (0..new_width as usize).map(move |x| (x, y)))
            .map(|(x, y)| {
                let (x, y) = from(x, y);
                y * width + x
            })
            .collect();
        self.pixels = places.iter().map(|&at| self.pixels[at]).collect();
        self.clipped = places.iter().map(|&at| self.clipped[at]).collect();
        [self.width, self.height] = [new_width, new_height];
    }
}

/// The size of a picture that is turned.
fn upright([width, height]: [u32; 2], turned: Orientation) -> [u32; 2] {
    match turned {
        Orientation::Rotate90
        | Orientation::Rotate270
        | Orientation::Rotate90FlipH
        | Orientation::Rotate270FlipH => [height, width],
        _ => [width, height],
    }
}

fn open(path: &Path) -> Result<(Kind, BufReader<std::fs::File>), String> {
    let mut file = antirad_base::input::open(path).map_err(|error| error.to_string())?;
    let mut start = Vec::new();
    (&mut file).take(16).read_to_end(&mut start).map_err(|error| error.to_string())?;
    file.seek(SeekFrom::Start(0)).map_err(|error| error.to_string())?;
    let kind = match ::image::guess_format(&start) {
        Ok(ImageFormat::OpenExr) => Kind::Exr,
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Tiff | ImageFormat::Hdr)) => {
            Kind::Other(format)
        }
        _ => return Err("it is none of EXR, PNG, JPEG, TIFF and Radiance HDR; convert it".to_owned()),
    };
    Ok((kind, BufReader::new(file)))
}

/// Fails if a header claims more pixels than are read.
fn check_size(width: usize, height: usize) -> Result<[u32; 2], String> {
    match width.checked_mul(height) {
        Some(0) => Err("it has no pixels".to_owned()),
        Some(pixels) if pixels <= MAX_PIXELS => Ok([width as u32, height as u32]),
        _ => Err(format!("it has {width} x {height} pixels, more than the {MAX_PIXELS} that are read")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::image::codecs::jpeg::JpegEncoder;
    use ::image::{DynamicImage, ImageEncoder, Luma, Rgb};
    use antirad_scene::linear_from_srgb;
    use std::path::PathBuf;

    /// A file for a test, which is removed at its end.
    pub(super) struct Written(pub PathBuf);

    impl Written {
        fn new(name: &str) -> Self {
            Self(std::env::temp_dir().join(format!("antirad_{}_{name}", std::process::id())))
        }

        pub fn save(name: &str, picture: &DynamicImage, format: ImageFormat) -> Self {
            let file = Self::new(name);
            match (picture, format) {
                (DynamicImage::ImageRgb32F(floats), ImageFormat::Tiff) => {
                    let numbers = floats.as_raw();
                    std::fs::write(&file.0, tiff([floats.width(), floats.height()], numbers))
                        .expect("written");
                }
                _ => picture.save_with_format(&file.0, format).expect("written"),
            }
            file
        }

        fn read(&self) -> Photo {
            Photo::read(&self.0, None).unwrap_or_else(|error| panic!("{error}"))
        }
    }

    impl Drop for Written {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    /// RGB floats in one strip, little-endian, not compressed.
    fn tiff([width, height]: [u32; 2], numbers: &[f32]) -> Vec<u8> {
        let (short, long) = (3u16, 4u16);
        let (bits, formats, strip) = (134, 140, 146);
        let entries = [
            (256u16, long, 1u32, width),
            (257, long, 1, height),
            (258, short, 3, bits),
            (259, short, 1, 1),
            (262, short, 1, 2),
            (273, long, 1, strip),
            (277, short, 1, 3),
            (278, long, 1, height),
            (279, long, 1, 4 * numbers.len() as u32),
            (339, short, 3, formats),
        ];
        let mut data = b"II\x2a\0\x08\0\0\0\x0a\0".to_vec();
        for (tag, kind, count, value) in entries {
            data.extend([tag, kind].into_iter().flat_map(u16::to_le_bytes));
            data.extend([count, value].into_iter().flat_map(u32::to_le_bytes));
        }
        data.extend([0; 4]);
        data.extend([32u16, 32, 32, 3, 3, 3].into_iter().flat_map(u16::to_le_bytes));
        data.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        data
    }

    /// EXIF data, little-endian: an orientation, and 1/50 s at f/4 and ISO 800.
    fn exif_data(orientation: u16) -> Vec<u8> {
        let entry = |tag: u16, kind: u16, value: u32| {
            [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat()
        };
        let (short, long, rational) = (3, 4, 5);
        let mut data = b"II\x2a\0\x08\0\0\0".to_vec();
        data.extend([2, 0]);
        data.extend(entry(0x0112, short, orientation.into()));
        data.extend(entry(0x8769, long, 38));
        data.extend([0; 4]);
        assert_eq!(data.len(), 38);
        data.extend([3, 0]);
        data.extend(entry(0x829a, rational, 80));
        data.extend(entry(0x829d, rational, 88));
        data.extend(entry(0x8827, short, 800));
        data.extend([0; 4]);
        assert_eq!(data.len(), 80);
        data.extend([1u32, 50, 4, 1].iter().flat_map(|number| number.to_le_bytes()));
        data
    }

    /// A picture of 16 x 8 pixels, white at the left of the first row of blocks.
    fn jpeg(orientation: u16) -> Written {
        let picture =
            ::image::RgbImage::from_fn(32, 16, |x, y| Rgb([if x < 8 && y < 8 { 255 } else { 0 }; 3]));
        let mut bytes = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut bytes, 100);
        encoder.write_image(&picture, 32, 16, ::image::ExtendedColorType::Rgb8).expect("encoded");
        // EXIF data are a segment APP1 behind the marker of the start.
        let data = [b"Exif\0\0", &exif_data(orientation)[..]].concat();
        let length = (data.len() + 2) as u16;
        bytes.splice(2..2, [&[0xff, 0xe1], &length.to_be_bytes()[..], &data].concat());
        let file = Written::new(&format!("turned{orientation}.jpg"));
        std::fs::write(&file.0, bytes).expect("written");
        file
    }

    #[test]
    fn jpeg_is_turned_upright_and_has_an_exposure() {
        // Where the corner of the file is in the picture, by the orientation of EXIF.
        for (orientation, size, corner) in [
            (1, [32, 16], [0, 0]),
            (2, [32, 16], [31, 0]),
            (3, [32, 16], [31, 15]),
            (4, [32, 16], [0, 15]),
            (5, [16, 32], [0, 0]),
            (6, [16, 32], [15, 0]),
            (7, [16, 32], [15, 31]),
            (8, [16, 32], [0, 31]),
        ] {
            let file = jpeg(orientation);
            let photo = file.read();
            assert_eq!([photo.width, photo.height], size, "{orientation}");
            assert_eq!(Photo::size(&file.0).expect("a size"), size);
            let at = |[x, y]: [u32; 2]| (y * size[0] + x) as usize;
            assert!(photo.pixels[at(corner)][0] > 0.9 && photo.clipped[at(corner)], "{orientation}");
            assert!(photo.pixels[at([size[0] - 1 - corner[0], size[1] - 1 - corner[1]])][0] < 0.1);
            // The same as `image` has it.
            let mut theirs = ::image::open(&file.0).expect("opened");
            theirs.apply_orientation(Orientation::from_exif(orientation as u8).expect("a number"));
            for (pixel, their) in photo.pixels.iter().zip(theirs.to_rgb8().pixels()) {
                assert!((f64::from(pixel[0]) - linear_from_srgb(f64::from(their.0[0]) / 255.0)).abs() < 1e-6);
            }
            let exposure = photo.exposure.expect("an exposure");
            assert!((exposure - 800.0 / 50.0 / 16.0).abs() < 1e-12, "{exposure}");
        }
        // As it is stored, where only that has the size.
        let of_size = |wanted: [u32; 2]| {
            let photo = Photo::read_of_size(&jpeg(6).0, None, |size| size == wanted).expect("read");
            [photo.width, photo.height]
        };
        assert_eq!((of_size([32, 16]), of_size([16, 32]), of_size([1, 1])), ([32, 16], [16, 32], [16, 32]));
    }

    #[test]
    fn formats_are_told_by_their_content() {
        let bytes = DynamicImage::from(::image::RgbImage::from_fn(4, 2, |x, _| Rgb([255, 128, x as u8])));
        let words = DynamicImage::from(::image::ImageBuffer::<Rgb<u16>, _>::from_fn(4, 2, |x, _| {
            Rgb([if x == 1 { 65535 } else { 65534 }, 32896, x as u16])
        }));
        let floats =
            DynamicImage::from(::image::Rgb32FImage::from_fn(4, 2, |x, _| Rgb([x as f32, 0.5, 300.0])));
        let grey = DynamicImage::from(::image::ImageBuffer::<Luma<u8>, _>::from_pixel(4, 2, Luma([128u8])));
        let middle = linear_from_srgb(128.0 / 255.0) as f32;
        for format in [ImageFormat::Png, ImageFormat::Tiff] {
            let name = |what: &str| format!("{what}_{format:?}.png");
            let photo = Written::save(&name("bytes"), &bytes, format).read();
            assert_eq!(photo.pixels[0][..2], [1.0, middle]);
            assert!(photo.ends_at_white && photo.clipped == [true; 8] && photo.exposure.is_none());
            let photo = Written::save(&name("words"), &words, format).read();
            assert!((photo.pixels[0][1] - middle).abs() < 1e-6);
            assert_eq!(photo.clipped, [false, true, false, false, false, true, false, false]);
            let photo = Written::save(&name("grey"), &grey, format).read();
            assert!((photo.pixels[5][2] - middle).abs() < 1e-6 && !photo.clipped[0]);
        }
        for format in [ImageFormat::Tiff, ImageFormat::Hdr] {
            let photo = Written::save(&format!("floats_{format:?}"), &floats, format).read();
            assert!((photo.pixels[2][0] - 2.0).abs() < 0.01 && (photo.pixels[2][2] - 300.0).abs() < 2.0);
            assert!(!photo.ends_at_white && photo.clipped == [false; 8]);
        }
        let file = Written::new("no_picture.jpg");
        std::fs::write(&file.0, "text").expect("written");
        let error = Photo::read(&file.0, None).expect_err("text").to_string();
        assert!(error.contains("no_picture.jpg") && error.contains("none of EXR, PNG, JPEG"), "{error}");
        std::fs::write(&file.0, b"\xff\xd8\xff\xe0 cut off here").expect("written");
        let error = Photo::read(&file.0, None).expect_err("cut off").to_string();
        assert!(error.contains("cannot be read as a picture"), "{error}");
        let error = Photo::read(Path::new("/nowhere/a.png"), None).expect_err("none").to_string();
        assert!(error.contains("/nowhere/a.png"), "{error}");
        let mask = Written::save("mask", &grey, ImageFormat::Png);
        let mask = PhotoMask::read(&mask.0).expect("a mask");
        assert!((mask.values[0] - 128.0 / 255.0).abs() < 1e-6 && mask.values.len() == 8);
    }
}
