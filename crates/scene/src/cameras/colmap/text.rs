//! `cameras.txt` and `images.txt`.

use std::collections::HashMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::str::FromStr;

use super::super::cannot_be_read;
use super::{Image, Intrinsics, model};
use crate::SceneError;
use crate::error::Place;

/// Lines that are neither empty nor comments, with their numbers from 1; all lines if `all`.
fn lines(path: &Path) -> Result<impl Iterator<Item = Result<(usize, String), SceneError>>, SceneError> {
    let file = antirad_base::input::open(path).map_err(cannot_be_read(path))?;
    let lines = BufReader::new(file).lines().enumerate();
    Ok(lines.map(move |(k, line)| line.map(|line| (k + 1, line)).map_err(cannot_be_read(path))))
}

fn says_nothing(line: &str) -> bool {
    let line = line.trim();
    line.is_empty() || line.starts_with('#')
}

/// The next word of a line as a value.
fn next<'a, T: FromStr>(words: &mut impl Iterator<Item = &'a str>, what: &str) -> Result<T, String> {
    let word = words.next().ok_or_else(|| format!("the line ends before {what}; write the file again"))?;
    word.parse().map_err(|_| format!("{what} is \"{word}\"; correct it"))
}

pub(super) fn cameras(path: &Path) -> Result<HashMap<u32, Intrinsics>, SceneError> {
    let mut cameras = HashMap::new();
    for line in lines(path)? {
        let (line, text) = line?;
        if says_nothing(&text) {
            continue;
        }
        let place = Place { path, line };
        let (id, intrinsics) = camera(&text).map_err(|message| place.error(message))?;
        if cameras.insert(id, intrinsics).is_some() {
            return Err(place.error(format!("camera {id} is there twice; remove one")));
        }
    }
    Ok(cameras)
}

fn camera(line: &str) -> Result<(u32, Intrinsics), String> {
    let mut words = line.split_whitespace();
    let id: u32 = next(&mut words, "the camera's number")?;
    let name: String = next(&mut words, "the name of its model")?;
    let of_camera = |message: String| format!("camera {id}: {message}");
    model::parameters(&name).map_err(of_camera)?;
    let size = [next(&mut words, "its width")?, next(&mut words, "its height")?];
    let mut parameters = Vec::new();
    for word in words {
        parameters.push(next(&mut std::iter::once(word), "a parameter").map_err(of_camera)?);
    }
    let intrinsics = model::intrinsics(&name, size, &parameters).map_err(of_camera)?;
    Ok((id, intrinsics))
}

pub(super) fn images(path: &Path) -> Result<Vec<Image>, SceneError> {
    let mut images = Vec::new();
    let mut lines = lines(path)?;
    while let Some(line) = lines.next() {
        let (line, text) = line?;
        if says_nothing(&text) {
            continue;
        }
        let image = image(&text).map_err(|message| Place { path, line }.error(message))?;
        // The points of an image follow in a line of their own, which may be empty or cut off at the end.
        if let Some(points) = lines.next() {
            let (line, text) = points?;
            check_points(&text, &image.name).map_err(|message| Place { path, line }.error(message))?;
        }
        images.push(image);
    }
    Ok(images)
}

fn image(line: &str) -> Result<Image, String> {
    let mut rest = line.trim_start();
    let mut words = std::iter::from_fn(|| {
        let (word, after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        rest = after.trim_start();
        (!word.is_empty()).then_some(word)
    });
    let _: u32 = next(&mut words, "the image's number")?;
    let mut number = |what: &str| next::<f64>(&mut words, what);
    let rotation = [number("QW")?, number("QX")?, number("QY")?, number("QZ")?];
    let translation = [number("TX")?, number("TY")?, number("TZ")?];
    let camera = next(&mut words, "the number of its camera")?;
    // A name may have spaces.
    let name = rest.trim_end().to_owned();
    if name.is_empty() {
        return Err("the line ends before the name of the image; write the file again".to_owned());
    }
    Ok(Image { rotation, translation, camera, name })
}

/// Fails if a line is none of points: X, Y, and the number of a point, any number of times.
fn check_points(line: &str, name: &str) -> Result<(), String> {
    let words: Vec<&str> = line.split_whitespace().take(12).collect();
    let good = words.chunks_exact(3).all(|point| {
        point[..2].iter().all(|word| word.parse::<f64>().is_ok()) && point[2].parse::<i64>().is_ok()
    });
    // A longer line was cut after four points.
    if good && words.len().is_multiple_of(3) {
        return Ok(());
    }
    Err(format!(
        "here are the points of image \"{name}\" expected, which may be none; leave the line empty, but do not leave it out"
    ))
}
