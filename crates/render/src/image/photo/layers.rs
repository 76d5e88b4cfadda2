//! Layers of OpenEXR files.

use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};

use exr::block::UncompressedBlock;
use exr::block::chunk::TileCoordinates;
use exr::error::{Error as ExrError, Result as ExrResult, UnitResult};
use exr::image::read::image::ReadLayers;
use exr::image::read::layers::{ChannelsReader, ReadChannels};
use exr::meta::MetaData;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::{Text, f16};

use super::{Photo, check_size};

/// The channels that make a colour: R, G, B, or Y alone three times.
#[derive(Clone, Debug)]
struct Layer {
    /// Empty for the channels without a prefix of a file with one part.
    name: String,
    /// Index of the part of the file.
    part: usize,
    channels: [Text; 3],
}

/// Layers with a colour.
fn layers(meta: &MetaData) -> Vec<Layer> {
    let mut layers: Vec<Layer> = Vec::new();
    for (part, header) in meta.headers.iter().enumerate() {
        if header.deep {
            continue;
        }
        let part_name =
            header.own_attributes.layer_name.as_ref().map(|name| name.to_string()).unwrap_or_default();
        let split: Vec<(String, String, &Text)> = header
            .channels
            .list
            .iter()
            .filter(|channel| channel.sample_type != SampleType::U32)
            .map(|channel| {
                let name = channel.name.to_string();
                let (prefix, last) = name.rsplit_once('.').unwrap_or(("", &name));
                (prefix.to_owned(), last.to_ascii_uppercase(), &channel.name)
            })
            .collect();
        let mut prefixes: Vec<&String> = split.iter().map(|(prefix, ..)| prefix).collect();
        prefixes.dedup();
        for prefix in prefixes {
            let find = |wanted: &str| {
                let found = split.iter().find(|(p, last, _)| p == prefix && last == wanted);
                found.map(|(_, _, name)| (*name).clone())
            };
            let channels = match (find("R"), find("G"), find("B"), find("Y")) {
                (Some(r), Some(g), Some(b), _) => [r, g, b],
                // With RY and BY beside it, Y is the luminance of a colour.
                (None, None, None, Some(y)) if find("RY").is_none() && find("BY").is_none() => {
                    [y.clone(), y.clone(), y]
                }
                _ => continue,
            };
            let name = match (meta.headers.len() > 1, part_name.as_str(), prefix.as_str()) {
                (false, _, prefix) => prefix.to_owned(),
                (true, part, "") => part.to_owned(),
                (true, part, prefix) if part.is_empty() || prefix.starts_with(part) => prefix.to_owned(),
                (true, part, prefix) => format!("{part}.{prefix}"),
            };
            if !layers.iter().any(|layer| layer.part == part && layer.name == name) {
                layers.push(Layer { name, part, channels });
            }
        }
    }
    layers
}

fn listed(layers: &[Layer]) -> String {
    let name = |layer: &Layer| format!("\"{}\"", layer.name);
    layers.iter().map(name).collect::<Vec<_>>().join(", ")
}

/// The layer with a name, the one without, or the only one.
fn choose(meta: &MetaData, wanted: Option<&str>) -> Result<Layer, String> {
    let layers = layers(meta);
    let mut names: Vec<String> = meta
        .headers
        .iter()
        .flat_map(|header| header.channels.list.iter().map(|channel| channel.name.to_string()))
        .collect();
    names.truncate(16);
    if layers.is_empty() {
        return Err(format!(
            "it has no layer with channels R, G, B, or Y alone, as half or float; its channels are {}",
            names.join(", ")
        ));
    }
    let found = match (wanted, layers.as_slice()) {
        (Some(wanted), layers) => layers.iter().find(|layer| layer.name == wanted),
        (None, [only]) => Some(only),
        (None, layers) => {
            let unnamed: Vec<&Layer> = layers.iter().filter(|layer| layer.name.is_empty()).collect();
            if let [only] = unnamed[..] { Some(only) } else { None }
        }
    };
    found.cloned().ok_or_else(|| match wanted {
        Some(wanted) => format!("it has no layer \"{wanted}\" with a colour; it has {}", listed(&layers)),
        None => format!("it has several layers: choose one with `layer`, from {}", listed(&layers)),
    })
}

fn meta_data(file: &mut BufReader<File>) -> Result<MetaData, String> {
    let meta = MetaData::read_from_buffered(&mut *file, false).map_err(|error| error.to_string())?;
    file.seek(SeekFrom::Start(0)).map_err(|error| error.to_string())?;
    for header in &meta.headers {
        check_size(header.layer_size.0, header.layer_size.1)?;
    }
    Ok(meta)
}

/// The size of the display window, which is that of all parts.
pub(super) fn size(mut file: BufReader<File>) -> Result<[u32; 2], String> {
    let meta = meta_data(&mut file)?;
    let header = meta.headers.first().ok_or("it has no parts")?;
    let size = header.shared_attributes.display_window.size;
    check_size(size.0, size.1)
}

pub(super) fn read(mut file: BufReader<File>, wanted: Option<&str>) -> Result<Photo, String> {
    let meta = meta_data(&mut file)?;
    let layer = choose(&meta, wanted)?;
    let header = meta.headers.get(layer.part).ok_or("it has no parts")?;
    let columns = layer.channels.each_ref().map(|name| {
        header.channels.list.iter().position(|channel| channel.name == *name).unwrap_or(usize::MAX)
    });
    let types = columns.map(|column| header.channels.list.get(column).map(|channel| channel.sample_type));
    let sampled = |&column: &usize| {
        header
            .channels
            .list
            .get(column)
            .is_some_and(|channel| channel.sampling.0 == 1 && channel.sampling.1 == 1)
    };
    if !columns.iter().all(sampled) {
        return Err(
            "its channels have fewer samples than pixels; write it again without subsampling".to_owned()
        );
    }
    let display = header.shared_attributes.display_window;
    let [width, height] = check_size(display.size.0, display.size.1)?;
    // Where the picture begins in the data.
    let data = header.own_attributes.layer_position;
    let offset = [(display.position.0, data.0), (display.position.1, data.1)]
        .map(|(shown, held)| i64::from(shown) - i64::from(held));
    let held = [header.layer_size.0 as i64, header.layer_size.1 as i64];
    let shown = [i64::from(width), i64::from(height)];
    if (0..2).any(|k| offset[k] < 0 || offset[k] + shown[k] > held[k]) {
        return Err(format!(
            "its data window of {} x {} does not cover its display window of {width} x {height}; write whole pictures",
            held[0], held[1]
        ));
    }
    let chosen = ChosenLayer { header: header.clone(), columns, types };
    let image =
        chosen.first_valid_layer().all_attributes().from_buffered(file).map_err(|error| error.to_string())?;
    let rows = image.layer_data.channel_data;
    let first = offset[1] as usize * rows.width + offset[0] as usize;
    let pixels: Vec<[f32; 3]> = (0..height as usize)
        .flat_map(|row| &rows.pixels[first + row * rows.width..][..width as usize])
        .copied()
        .collect();
    let clipped = vec![false; pixels.len()];
    Ok(Photo { width, height, pixels, clipped, ends_at_white: false, exposure: None })
}

/// Reads three channels of one part, and nothing else.
struct ChosenLayer {
    header: Header,
    /// Indices of the channels of red, green and blue.
    columns: [usize; 3],
    types: [Option<SampleType>; 3],
}

impl ReadChannels<'_> for ChosenLayer {
    type Reader = Rows;

    fn create_channels_reader(&self, header: &Header) -> ExrResult<Rows> {
        if *header != self.header {
            return Err(ExrError::Invalid("another part of the file".into()));
        }
        let width = header.layer_size.0;
        let pixels = vec![[0.0; 3]; width * header.layer_size.1];
        Ok(Rows { width, columns: self.columns, types: self.types, pixels })
    }
}

/// Pixels of the data window.
struct Rows {
    width: usize,
    columns: [usize; 3],
    types: [Option<SampleType>; 3],
    pixels: Vec<[f32; 3]>,
}

impl ChannelsReader for Rows {
    type Channels = Self;

    fn filter_block(&self, tile: TileCoordinates) -> bool {
        tile.is_largest_resolution_level()
    }

    fn read_block(&mut self, header: &Header, block: UncompressedBlock) -> UnitResult {
        for line in block.lines(&header.channels) {
            let start = line.location.position.1 * self.width + line.location.position.0;
            for colour in (0..3).filter(|&colour| self.columns[colour] == line.location.channel) {
                let pixels = self.pixels.iter_mut().skip(start).map(|pixel| &mut pixel[colour]);
                if self.types[colour] == Some(SampleType::F16) {
                    for (value, read) in pixels.zip(line.read_samples::<f16>()) {
                        *value = read?.to_f32();
                    }
                } else {
                    for (value, read) in pixels.zip(line.read_samples::<f32>()) {
                        *value = read?;
                    }
                }
            }
        }
        Ok(())
    }

    fn into_channels(self) -> Self {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer as ExrLayer};
    use exr::math::Vec2;
    use exr::meta::attribute::IntegerBounds;
    use exr::meta::header::{ImageAttributes, LayerAttributes};
    use exr::prelude::{Compression, WritableImage};
    use std::path::PathBuf;

    const SIZE: Vec2<usize> = Vec2(5, 3);

    /// A channel whose pixels count from a number, in half or float.
    fn channel(name: &str, from: f32, half: bool) -> AnyChannel<FlatSamples> {
        let values = (0..SIZE.area()).map(|k| from + k as f32);
        let samples = match half {
            true => FlatSamples::F16(values.map(f16::from_f32).collect()),
            false => FlatSamples::F32(values.collect()),
        };
        AnyChannel::new(name, samples)
    }

    fn part(name: Option<&str>, channels: &[(&str, f32)]) -> ExrLayer<AnyChannels<FlatSamples>> {
        let channels = channels.iter().map(|&(name, from)| channel(name, from, from > 100.0));
        let attributes = LayerAttributes { layer_name: name.map(Text::from), ..LayerAttributes::default() };
        ExrLayer::new(SIZE, attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels.collect()))
    }

    struct Written(PathBuf);

    impl Written {
        fn new(name: &str, image: &Image<exr::image::Layers<AnyChannels<FlatSamples>>>) -> Self {
            let path = std::env::temp_dir().join(format!("antirad_{}_{name}.exr", std::process::id()));
            image.write().to_file(&path).expect("written");
            Self(path)
        }

        fn read(&self, layer: Option<&str>) -> Result<Photo, String> {
            Photo::read(&self.0, layer).map_err(|error| error.to_string())
        }
    }

    impl Drop for Written {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    fn image(
        parts: &[ExrLayer<AnyChannels<FlatSamples>>],
    ) -> Image<exr::image::Layers<AnyChannels<FlatSamples>>> {
        let attributes = ImageAttributes::new(IntegerBounds::from_dimensions(SIZE));
        Image::from_layers(attributes, parts.iter().cloned().collect::<exr::image::Layers<_>>())
    }

    #[test]
    fn layers_are_found_by_their_channels() {
        let blender = part(
            None,
            &[
                ("ViewLayer.Combined.R", 0.0),
                ("ViewLayer.Combined.G", 20.0),
                ("ViewLayer.Combined.B", 200.0),
                ("ViewLayer.Combined.A", 1.0),
                ("ViewLayer.Depth.Z", 7.0),
                ("ViewLayer.Normal.X", 7.0),
            ],
        );
        let file = Written::new("one", &image(&[blender]));
        let photo = file.read(None).expect("its only colour");
        assert_eq!((photo.width, photo.height, photo.ends_at_white), (5, 3, false));
        assert_eq!(photo.pixels[7], [7.0, 27.0, 207.0]);
        assert_eq!(file.read(Some("ViewLayer.Combined")).expect("by name"), photo);
        assert_eq!(Photo::size(&file.0).expect("a size"), [5, 3]);
        let error = file.read(Some("ViewLayer.Depth")).expect_err("no colour");
        assert!(error.contains("\"ViewLayer.Combined\"") && error.contains("no layer"), "{error}");

        let grey = Written::new("grey", &image(&[part(None, &[("Y", 3.0)])]));
        assert_eq!(grey.read(None).expect("grey").pixels[1], [4.0; 3]);
        let depth = Written::new("depth", &image(&[part(None, &[("Z", 3.0), ("RY", 3.0)])]));
        assert!(depth.read(None).expect_err("no colour").contains("channels are RY, Z"));
    }

    #[test]
    fn several_layers_need_a_name() {
        let rgb = |prefix: &str, from: f32| {
            ["R", "G", "B"].map(|last| {
                (if prefix.is_empty() { last.to_owned() } else { format!("{prefix}.{last}") }, from)
            })
        };
        let channels: Vec<(String, f32)> = [rgb("direct", 1.0), rgb("bounced", 2.0)].concat();
        let named: Vec<(&str, f32)> = channels.iter().map(|(name, from)| (name.as_str(), *from)).collect();
        let file = Written::new("two", &image(&[part(None, &named)]));
        let error = file.read(None).expect_err("two");
        assert!(error.contains("several layers") && error.contains("\"bounced\", \"direct\""), "{error}");
        assert_eq!(file.read(Some("direct")).expect("one").pixels[0], [1.0; 3]);
        // The layer without a name is that of the picture.
        let mut with_plain = named.clone();
        with_plain.extend([("R", 5.0), ("G", 5.0), ("B", 5.0)]);
        let file = Written::new("plain", &image(&[part(None, &with_plain)]));
        assert_eq!(file.read(None).expect("the unnamed").pixels[0], [5.0; 3]);
        assert_eq!(file.read(Some("bounced")).expect("one").pixels[0], [2.0; 3]);

        let plain = [("R", 1.0), ("G", 1.0), ("B", 1.0)];
        let other = [("R", 300.0), ("G", 300.0), ("B", 300.0)];
        let parts = Written::new("parts", &image(&[part(Some("left"), &plain), part(Some("right"), &other)]));
        assert_eq!(parts.read(Some("right")).expect("one").pixels[2], [302.0; 3]);
        assert_eq!(parts.read(Some("left")).expect("one").pixels[2], [3.0; 3]);
        assert!(parts.read(None).expect_err("two").contains("\"left\", \"right\""));
    }

    /// What lies around the display window is left out; data that do not fill it are refused.
    #[test]
    fn windows_differ() {
        let mut data = part(None, &[("R", 0.0), ("G", 0.0), ("B", 0.0)]);
        data.attributes.layer_position = Vec2(-1, -1);
        let mut large = image(&[data]);
        large.attributes.display_window = IntegerBounds::new((0, 0), (3, 2));
        let photo = Written::new("large", &large).read(None).expect("a part of the data");
        assert_eq!((photo.width, photo.height), (3, 2));
        assert_eq!((photo.pixels[0][0], photo.pixels[5][0]), (6.0, 13.0));
        large.attributes.display_window = IntegerBounds::new((0, 0), (5, 3));
        let error = Written::new("small", &large).read(None).expect_err("too small");
        assert!(error.contains("does not cover its display window of 5 x 3"), "{error}");
    }

    #[test]
    fn every_compression_is_read() {
        for (index, compression) in [
            Compression::Uncompressed,
            Compression::RLE,
            Compression::ZIP1,
            Compression::ZIP16,
            Compression::PIZ,
            Compression::PXR24,
            Compression::B44,
            Compression::DWAA(None),
            Compression::DWAB(None),
        ]
        .into_iter()
        .enumerate()
        {
            let mut layer = part(None, &[("R", 300.0), ("G", 320.0), ("B", 340.0)]);
            layer.encoding.compression = compression;
            let photo = Written::new(&format!("c{index}"), &image(&[layer])).read(None);
            let photo = photo.unwrap_or_else(|error| panic!("{compression:?}: {error}"));
            for (k, pixel) in photo.pixels.iter().enumerate() {
                for (value, from) in pixel.iter().zip([300.0, 320.0, 340.0]) {
                    assert!((value - from - k as f32).abs() < 6.0, "{compression:?}: {pixel:?} at {k}");
                }
            }
        }
    }
}
