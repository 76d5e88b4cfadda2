//! Pictures side by side under captions, and false colours for differences.

use crate::image::{Exposure, ImageError, Picture, ToneMap};
use antirad_scene::linear_from_srgb;
use font8x8::legacy::{BASIC_LEGACY, LATIN_LEGACY};
use glam::DVec3;
use image::codecs::png::FilterType;
use std::path::Path;

/// Height of the line of text above each panel, and space between panels, pixels.
pub(super) const CAPTION: u32 = 22;
pub(super) const GAP: u32 = 6;
/// Pictures that are smaller are shown larger, so that captions fit.
const LEAST_WIDTH: u32 = 256;
/// The colour bar, pixels: its height, its height with numbers, its margins at the sides.
const BAR: u32 = 12;
const LEGEND: u32 = 40;
const MARGIN: u32 = 24;

/// One picture.
pub struct Panel {
    /// Text above the picture.
    pub caption: String,
    /// Linear, 0 for black and 1 for white, row by row from the top.
    pub pixels: Vec<DVec3>,
}

/// Panels of one size in rows, on black.
pub struct Sheet {
    /// Width of a panel, pixels.
    pub width: u32,
    /// Height of a panel, pixels.
    pub height: u32,
    /// Rows of equally many panels.
    pub rows: Vec<Vec<Panel>>,
    /// The value of ±1 of [`signed_heat`] in the last column, which a colour bar below it explains.
    pub limit: Option<f64>,
}

/// Rows and columns of a letter in the font. Its rows are drawn twice.
const FONT: u32 = 8;
/// Columns of a letter without a lit pixel, and those that are free behind a letter.
const BLANK: u32 = 4;
const FREE: u32 = 1;

/// A text and its upper left corner.
struct Text {
    text: String,
    at: (u32, u32),
}

impl Sheet {
    /// Writes a PNG. Panels are shown larger by a whole number where captions would not fit.
    pub fn write(&self, path: &Path) -> Result<(), ImageError> {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0) as u32;
        let zoom = LEAST_WIDTH.div_ceil(self.width.max(1));
        let (wide, high) = (self.width * zoom, self.height * zoom);
        let legend = if self.limit.is_some() { LEGEND } else { 0 };
        let whole = (
            (columns * (wide + GAP)).saturating_sub(GAP),
            self.rows.len() as u32 * (CAPTION + high) + legend,
        );
        let corner = |row: usize, column: usize| {
            (column as u32 * (wide + GAP), row as u32 * (CAPTION + high) + CAPTION)
        };

        let mut texts = Vec::new();
        let mut pixels = vec![DVec3::ZERO; (whole.0 * whole.1) as usize];
        for (row, panels) in self.rows.iter().enumerate() {
            for (column, panel) in panels.iter().enumerate() {
                let (left, top) = corner(row, column);
                let at = (left + 4, top - CAPTION + 4);
                texts.push(Text { text: panel.caption.clone(), at });
                for (y, x) in (0..high).flat_map(|y| (0..wide).map(move |x| (y, x))) {
                    let from = (y / zoom * self.width + x / zoom) as usize;
                    pixels[((top + y) * whole.0 + left + x) as usize] = panel.pixels[from];
                }
            }
        }
        if let (Some(limit), true) = (self.limit, columns > 0 && wide > 2 * MARGIN) {
            let (left, top) = (whole.0 - wide + MARGIN, whole.1 - LEGEND + 6);
            let length = wide - 2 * MARGIN;
            for (y, x) in (0..BAR).flat_map(|y| (0..length).map(move |x| (y, x))) {
                let share = 2.0 * (f64::from(x) + 0.5) / f64::from(length) - 1.0;
                pixels[((top + y) * whole.0 + left + x) as usize] = signed_heat(share);
            }
            for k in 0..=4 {
                let share = f64::from(k) / 2.0 - 1.0;
                let text = if k == 2 { "0".to_owned() } else { format!("{:+}", share * limit) };
                let middle = left + k * length / 4;
                let width: u32 = text.chars().map(|of| Letter::new(of).width).sum();
                let at = (middle.saturating_sub(width / 2), top + BAR + 3);
                texts.push(Text { text, at });
            }
        }
        for Text { text, at } in &texts {
            let mut left = at.0;
            for Letter { lit, width } in text.chars().map(Letter::new) {
                for (x, y) in lit.into_iter().map(|(x, y)| (left + x, at.1 + y)) {
                    if x < whole.0 && y < whole.1 {
                        pixels[(y * whole.0 + x) as usize] = DVec3::ONE;
                    }
                }
                left += width;
            }
        }
        let pixels = pixels.into_iter().map(|p| p.as_vec3().extend(1.0).to_array()).collect();
        let picture = Picture { width: whole.0, height: whole.1, pixels };
        let tone = ToneMap::default().exposure(Exposure::Stops(0.0));
        picture.write_png_filtered(path, &tone, FilterType::NoFilter)
    }
}

/// A letter as wide as what is lit of it.
struct Letter {
    /// The pixels that are lit, column and row.
    lit: Vec<(u32, u32)>,
    /// Columns to the next letter.
    width: u32,
}

impl Letter {
    /// What the font does not have is a question mark.
    fn new(of: char) -> Self {
        let latin = (of as usize).checked_sub(0xa0).and_then(|k| LATIN_LEGACY.get(k));
        let rows = BASIC_LEGACY.get(of as usize).or(latin).unwrap_or(&BASIC_LEGACY['?' as usize]);
        let places = (0..2 * FONT).flat_map(|y| (0..FONT).map(move |x| (x, y)));
        let mut lit: Vec<(u32, u32)> =
            places.filter(|&(x, y)| rows[(y / 2) as usize] >> x & 1 == 1).collect();
        let columns = || lit.iter().map(|&(x, _)| x);
        let (Some(first), Some(last)) = (columns().min(), columns().max()) else {
            return Self { lit, width: BLANK };
        };
        lit.iter_mut().for_each(|(x, _)| *x -= first);
        Self { lit, width: last - first + 1 + FREE }
    }
}

/// The radiance to show as white: the 95th percentile of the pixels that are not black, so that a lamp that fills a few
/// per cent of the picture becomes white. 1 if all are black.
pub fn white_point(pixels: impl Iterator<Item = DVec3>) -> f64 {
    percentile(pixels.map(DVec3::max_element), 95).unwrap_or(1.0)
}

/// A percentile of the values above 0; `None` if there are none.
pub fn percentile(values: impl Iterator<Item = f64>, percent: usize) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| *value > 0.0).collect();
    let rank = values.len().checked_sub(1)? * percent / 100;
    Some(*values.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// Black, violet, red, yellow for 0 to 1 (Matplotlib's "inferno").
pub fn heat(share: f64) -> DVec3 {
    linear(colorous::INFERNO.eval_continuous(share.clamp(0.0, 1.0)))
}

/// White for 0; to dark red for 1, to dark blue for -1 (ColorBrewer's "RdBu").
pub fn signed_heat(share: f64) -> DVec3 {
    linear(colorous::RED_BLUE.eval_continuous((0.5 - 0.5 * share).clamp(0.0, 1.0)))
}

/// Linear values of a colour.
fn linear(colour: colorous::Color) -> DVec3 {
    let channel = |byte: u8| linear_from_srgb(f64::from(byte) / 255.0);
    DVec3::new(channel(colour.r), channel(colour.g), channel(colour.b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_and_a_bar() {
        let panel = |caption: &str, value: f64| Panel {
            caption: caption.to_owned(),
            pixels: vec![DVec3::splat(value); 300 * 10],
        };
        let rows = vec![vec![panel("a", 1.0), panel("", 0.0)], vec![panel("b", 0.0), panel("", 1.0)]];
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("sheet.png");
        Sheet { width: 300, height: 10, rows, limit: Some(0.5) }.write(&path).expect("written");
        let picture = image::open(&path).expect("a picture").to_rgb8();
        let (width, height) = picture.dimensions();
        assert_eq!((width, height), (2 * 300 + GAP, 2 * (CAPTION + 10) + LEGEND));
        assert_eq!(picture.get_pixel(5, CAPTION + 5).0, [255; 3]);
        assert_eq!(picture.get_pixel(5, 2 * CAPTION + 15).0, [0; 3]);
        assert_eq!(picture.get_pixel(width - 5, 2 * CAPTION + 15).0, [255; 3]);
        // Blue to red, brightest in the middle.
        let bar = |x: u32| picture.get_pixel(300 + GAP + x, height - LEGEND + 10).0;
        let (blue, red) = (bar(MARGIN), bar(300 - MARGIN - 1));
        assert!(blue[2] > 2 * blue[0] && red[0] > 2 * red[2], "{blue:?} {red:?}");
        assert!(bar(150).iter().all(|value| *value > 220));
    }

    /// The units of pictures have their squares, and the widest caption of a comparison fits its panel.
    #[test]
    fn captions_are_whole() {
        let lit = |of: char| Letter::new(of).lit;
        assert!(['²', '|', 'W', 'é'].into_iter().all(|of| !lit(of).is_empty() && lit(of) != lit('?')));
        assert_eq!((lit('漢'), lit(' ')), (lit('?'), Vec::new()));
        let width = |text: &str| text.chars().map(|of| Letter::new(of).width).sum::<u32>();
        for caption in ["target, white = 0.261 W/(m² sr)", "|difference|, to 1.2e-10 W/(m² sr)"] {
            assert!(width(caption) <= LEAST_WIDTH - 8, "{}", width(caption));
        }
    }

    #[test]
    fn false_colours() {
        // Shown on a screen, they are the colours of the maps.
        let folder = tempfile::tempdir().expect("a folder");
        let shown = |colour: DVec3| {
            let path = folder.path().join("colour.png");
            let picture =
                Picture { width: 1, height: 1, pixels: vec![colour.as_vec3().extend(1.0).to_array()] };
            picture.write_png(&path, &ToneMap::default().exposure(Exposure::Stops(0.0))).expect("written");
            image::open(&path).expect("a picture").to_rgb8().get_pixel(0, 0).0
        };
        for share in [0.0, 0.013, 0.3, 0.5, 1.0] {
            assert_eq!(shown(heat(share)), colorous::INFERNO.eval_continuous(share).as_array());
        }
        assert_eq!(shown(signed_heat(0.0)), colorous::RED_BLUE.eval_continuous(0.5).as_array());
        assert_eq!(shown(signed_heat(7.0)), colorous::RED_BLUE.eval_continuous(0.0).as_array());
        assert_eq!(shown(signed_heat(-1.0)), colorous::RED_BLUE.eval_continuous(1.0).as_array());
        assert_eq!(percentile((0..=100).map(f64::from), 95), Some(95.0));
        assert_eq!(percentile([0.0, -1.0].into_iter(), 50), None);
    }
}
