//! Target, fitted picture and error side by side.

use super::target::Target;
use crate::cli::register_font;
use crate::image::{Exposure, ImageError, Picture, ToneMap};
use glam::DVec3;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::Path;

/// Height of the line of text above each picture, and space between pictures, pixels.
const CAPTION: u32 = 22;
const GAP: u32 = 6;
/// Pictures that are smaller are shown larger, so that captions fit.
const LEAST_WIDTH: u32 = 256;

/// Writes a PNG: the target, the fitted picture in the same exposure, and how far they are apart, black for not at all
/// over red and yellow to white for the most. Pixels that did not count are blue in the third.
pub(super) fn write(path: &Path, target: &Target, fitted: &[DVec3]) -> Result<(), ImageError> {
    let (width, height) = (target.camera.width, target.camera.height);
    let zoom = LEAST_WIDTH.div_ceil(width);
    let white = white_point(target.pixels.iter().enumerate().filter_map(|(at, p)| {
        let value = p.max_element();
        (target.mask_at(at) > 0.0 && value > 0.0).then_some(value)
    }));
    let differences: Vec<f64> =
        target.pixels.iter().zip(fitted).map(|(t, f)| (*t - *f).abs().element_sum() / 3.0).collect();
    let counted = differences.iter().enumerate().filter(|(at, _)| target.mask_at(*at) > 0.0);
    let most = counted.map(|(_, d)| *d).fold(0.0, f64::max);
    let error = |at: usize| match target.mask_at(at) {
        0.0 => DVec3::new(0.0, 0.0, 0.3),
        _ if most > 0.0 => heat(differences[at] / most),
        _ => DVec3::ZERO,
    };

    let panel = width * zoom;
    let whole = (3 * panel + 2 * GAP, CAPTION + height * zoom);
    let captions = captions(
        whole,
        panel,
        [
            format!("target, white = {white:.3} W/(m² sr)"),
            String::from("fitted"),
            format!("|difference|, 0 to {most:.2e}"),
        ],
    );
    let pixels = (0..whole.0 * whole.1).map(|at| {
        let (x, y) = (at % whole.0, at / whole.0);
        let (column, view) = (x % (panel + GAP), x / (panel + GAP));
        if y < CAPTION || column >= panel {
            return [f32::from(captions[at as usize]) / 255.0; 4];
        }
        let at = ((y - CAPTION) / zoom * width + column / zoom) as usize;
        let shown = match view {
            0 => target.pixels[at] / white,
            1 => fitted[at] / white,
            _ => error(at),
        };
        shown.as_vec3().extend(1.0).to_array()
    });
    let picture = Picture { width: whole.0, height: whole.1, pixels: pixels.collect() };
    picture.write_png(path, &ToneMap { exposure: Exposure::Stops(0.0), srgb: true })
}

/// The radiance that is shown as white: 95 of a hundred pixels that show something are darker. A lamp in the picture may
/// well fill some hundredths of it, and is to be white. 1 if nothing shines.
fn white_point(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 1.0;
    }
    let rank = (values.len() - 1) * 95 / 100;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

/// Black, red, yellow, white for 0 to 1.
fn heat(share: f64) -> DVec3 {
    DVec3::new(3.0 * share, 3.0 * share - 1.0, 3.0 * share - 2.0).clamp(DVec3::ZERO, DVec3::ONE)
}

/// Brightness of the texts above the pictures, for the whole picture.
fn captions((width, height): (u32, u32), panel: u32, texts: [String; 3]) -> Vec<u8> {
    register_font();
    let mut pixels = vec![0; (3 * width * height) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        let style = ("sans-serif", 15).into_font().color(&WHITE).pos(Pos::new(HPos::Left, VPos::Top));
        for (k, text) in texts.iter().enumerate() {
            let at = (k as i32 * (panel + GAP) as i32 + 4, 4);
            // A picture without its text is better than none.
            if let Err(error) = area.draw_text(text, &style, at) {
                tracing::debug!("no caption: {error}");
            }
        }
    }
    pixels.chunks_exact(3).map(|rgb| rgb[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;

    #[test]
    fn three_pictures_with_captions() {
        let camera = Camera { width: 8, height: 4, ..Camera::framing(&[]) };
        let pixels: Vec<DVec3> = (0..32).map(|i| DVec3::splat(f64::from(i) / 10.0)).collect();
        let mut mask = vec![1.0; 32];
        mask[31] = 0.0;
        let target = Target::new(camera, pixels.clone(), Some(mask), 1.0).expect("a target");
        let mut fitted = pixels;
        fitted[0] += 1.0;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("c.png");
        write(&path, &target, &fitted).expect("written");
        let picture = image::open(&path).expect("a picture").to_rgb8();
        assert_eq!(picture.dimensions(), (3 * 256 + 2 * GAP, CAPTION + 128));
        let third = 2 * (256 + GAP);
        assert_eq!(picture.get_pixel(third + 3, CAPTION + 3).0, [255; 3], "the one difference");
        assert_eq!(picture.get_pixel(third + 40, CAPTION + 3).0, [0; 3]);
        assert!(picture.get_pixel(third + 255, CAPTION + 127).0[2] > 100, "what does not count");
        let text = (0..256).flat_map(|x| (0..CAPTION).map(move |y| (x, y)));
        assert!(text.filter(|&(x, y)| picture.get_pixel(x, y).0[0] > 128).count() > 50);
    }
}
