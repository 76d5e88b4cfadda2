//! Target, fitted picture and error side by side.

use super::sheet::{Panel, Sheet, heat, white_point};
use crate::fit::Target;
use crate::image::ImageError;
use glam::DVec3;
use std::path::Path;

/// Writes a PNG: the target, the fitted picture in the same exposure, and their absolute difference, from black for
/// none over violet and red to yellow for the largest. Masked pixels are grey in the third.
pub(super) fn write(path: &Path, target: &Target, fitted: &[DVec3]) -> Result<(), ImageError> {
    let counts = |at: usize| target.mask_at(at) > 0.0;
    let counted = (0..target.pixels.len()).filter(|at| counts(*at));
    let white = white_point(counted.clone().map(|at| target.pixels[at]));
    let differences: Vec<f64> =
        target.pixels.iter().zip(fitted).map(|(t, f)| (*t - *f).abs().element_sum() / 3.0).collect();
    let most = counted.map(|at| differences[at]).fold(0.0, f64::max);
    let error = |at: usize| match counts(at) {
        false => DVec3::splat(0.2),
        _ if most > 0.0 => heat(differences[at] / most),
        _ => heat(0.0),
    };
    let shown = |pixels: &[DVec3]| pixels.iter().map(|p| *p / white).collect();
    let row = vec![
        Panel { caption: format!("target, white = {white:.3} W/(m² sr)"), pixels: shown(&target.pixels) },
        Panel { caption: String::from("fitted"), pixels: shown(fitted) },
        Panel {
            caption: format!("|difference|, to {most:.1e} W/(m² sr)"),
            pixels: (0..differences.len()).map(error).collect(),
        },
    ];
    let (width, height) = (target.camera.width, target.camera.height);
    Sheet { width, height, rows: vec![row], limit: None }.write(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::sheet::{CAPTION, GAP};
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
        assert_eq!(picture.get_pixel(third + 3, CAPTION + 3).0, [252, 255, 164], "the one difference");
        assert_eq!(picture.get_pixel(third + 40, CAPTION + 3).0, [0, 0, 4]);
        assert_eq!(picture.get_pixel(third + 255, CAPTION + 127).0, [124; 3], "a masked pixel");
        let text = (0..256).flat_map(|x| (0..CAPTION).map(move |y| (x, y)));
        assert!(text.filter(|&(x, y)| picture.get_pixel(x, y).0[0] > 128).count() > 50);
    }
}
