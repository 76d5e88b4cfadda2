//! EXR and PNG files.

use std::fs;
use std::path::Path;

use antirad::image::{Exposure, ImageError, Picture, PictureOptions, Rasterizer, ToneMap};
use tempfile::tempdir;

use crate::scenes::{Random, above, finish, grid};
use crate::support::backend;

fn picture(width: u32, pixels: &[[f32; 3]]) -> Picture {
    let pixels: Vec<_> = pixels.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
    Picture { width, height: pixels.len() as u32 / width, pixels }
}

fn png(picture: &Picture, tone: &ToneMap) -> Vec<u8> {
    let directory = tempdir().unwrap();
    let path = directory.path().join("picture.png");
    picture.write_png(&path, tone).unwrap();
    let read = image::open(path).unwrap();
    assert_eq!((read.width(), read.height()), (picture.width, picture.height));
    read.as_rgb8().unwrap().as_raw().clone()
}

#[test]
fn exr_keeps_every_bit() {
    let directory = tempdir().unwrap();
    let path = directory.path().join("picture.exr");
    let mut random = Random::new(5);
    let mut pixels: Vec<[f32; 3]> =
        (0..37 * 23).map(|_| [0; 3].map(|_| (random.next() * 60.0 - 30.0).exp2() as f32)).collect();
    pixels[3] = [-1.5, f32::INFINITY, f32::MIN_POSITIVE];
    let written = picture(37, &pixels);
    written.write_exr(&path).unwrap();
    assert_eq!(Picture::read_exr(&path).unwrap(), written);
    // Overwriting leaves no other file behind.
    written.write_exr(&path).unwrap();
    assert_eq!(fs::read_dir(&directory).unwrap().count(), 1);
}

#[test]
fn png_is_srgb() {
    let shown = picture(2, &[[0.0, 0.5, 1.0], [0.002, -1.0, 2.0], [f32::NAN, f32::INFINITY, 0.25], [0.1; 3]]);
    let stops = |stops, srgb| ToneMap::default().exposure(Exposure::Stops(stops)).srgb(srgb);
    let bytes = png(&shown, &stops(0.0, true));
    assert_eq!(bytes, [0, 188, 255, 7, 0, 255, 0, 255, 137, 89, 89, 89]);
    let bytes = png(&shown, &stops(-1.0, false));
    assert_eq!(bytes, [0, 64, 128, 0, 0, 255, 0, 255, 32, 13, 13, 13]);
}

#[test]
fn automatic_exposure_puts_the_brightest_hundredth_at_white() {
    // 200 pixels from 0.05 to 10 and a lamp, among black and NaN pixels.
    let mut pixels: Vec<[f32; 3]> = (1..=200).map(|i| [0.0, i as f32 / 20.0, 0.0]).collect();
    pixels[199] = [1e6, 0.0, 0.0];
    pixels.extend([[0.0; 3]; 2000]);
    pixels.extend([[f32::NAN; 3]; 200]);
    let tone = ToneMap::default().exposure(Exposure::Auto).srgb(false);
    let bytes = png(&picture(100, &pixels), &tone);
    // Pixel 197 of 0..200 is the 99th percentile.
    assert_eq!(bytes[3 * 197 + 1], (0.99f64 * 255.0).round() as u8);
    assert_eq!(bytes[3 * 98 + 1], (0.99f64 * 255.0 * 99.0 / 198.0).round() as u8);
    assert_eq!(bytes[3 * 199], 255);
    let black = picture(2, &[[0.0; 3]; 4]);
    assert!(png(&black, &tone).iter().all(|&byte| byte == 0));
}

#[test]
fn errors_name_the_file() {
    let directory = tempdir().unwrap();
    let missing = directory.path().join("missing").join("picture");
    let shown = picture(1, &[[1.0; 3]]);
    let check = |result: Result<(), ImageError>, path: &Path| {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(&path.display().to_string()), "{error}");
        error
    };
    for path in [&missing, directory.path()] {
        check(shown.write_exr(path), path);
        check(shown.write_png(path, &ToneMap::default()), path);
        check(Picture::read_exr(path).map(drop), path);
    }
    assert!(check(shown.write_exr(&missing), &missing).contains("No such file or directory"));
    let broken = directory.path().join("broken.exr");
    fs::write(&broken, "no picture").unwrap();
    check(Picture::read_exr(&broken).map(drop), &broken);
    let wrong = Picture { width: 7, ..shown };
    assert!(matches!(wrong.write_exr(&broken), Err(ImageError::Size { .. })));
    assert_eq!(fs::read(&broken).unwrap(), b"no picture");
}

#[test]
fn the_same_picture_is_the_same_file() {
    let backend = backend();
    let directory = tempdir().unwrap();
    let surface = grid(9, 9, |x, y| glam::DVec3::new(x / 4.5 - 1.0, y / 4.5 - 1.0, (x * y).sin() / 9.0));
    let colours = Random::new(1).colours(&surface);
    let files = |name: &str| {
        let rasterizer = Rasterizer::new(&backend).unwrap();
        let options = PictureOptions::default().supersample(4);
        let picture = rasterizer.render(&surface, &above(200, 100), &colours, &options).unwrap();
        let [exr, png] = ["exr", "png"].map(|end| directory.path().join(name).with_extension(end));
        picture.write_exr(&exr).unwrap();
        picture.write_png(&png, &ToneMap::default()).unwrap();
        (fs::read(exr).unwrap(), fs::read(png).unwrap())
    };
    assert!(files("one") == files("two"));
    finish(backend);
}
