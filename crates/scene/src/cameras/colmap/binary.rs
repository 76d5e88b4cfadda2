//! `cameras.bin` and `images.bin`, little-endian.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use super::super::{cannot_be_read, refuse};
use super::{Image, Intrinsics, model};
use crate::SceneError;

/// Bytes of a point of an image: x, y and the number of a point.
const POINT: u64 = 24;
/// Longest name of an image.
const LONGEST_NAME: u64 = 1 << 16;

/// A binary file, read value by value. What its header claims allocates nothing.
struct Reader<'a> {
    path: &'a Path,
    file: BufReader<File>,
    /// What is being read, for messages.
    what: String,
}

impl<'a> Reader<'a> {
    fn open(path: &'a Path) -> Result<Self, SceneError> {
        let file = antirad_base::input::open(path).map_err(cannot_be_read(path))?;
        Ok(Self { path, file: BufReader::new(file), what: "its count".to_owned() })
    }

    fn refuse(&self, message: impl std::fmt::Display) -> SceneError {
        refuse(self.path, format!("{}: {message}", self.what))
    }

    fn cut_off(&self) -> SceneError {
        self.refuse("the file ends within it; it is cut off: copy or write it again")
    }

    fn failed(&self, error: io::Error) -> SceneError {
        match error.kind() {
            ErrorKind::UnexpectedEof => self.cut_off(),
            _ => cannot_be_read(self.path)(error),
        }
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], SceneError> {
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|error| self.failed(error))?;
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, SceneError> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, SceneError> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, SceneError> {
        self.bytes().map(f64::from_le_bytes)
    }

    /// Bytes up to a zero, as text.
    fn name(&mut self) -> Result<String, SceneError> {
        let mut name = Vec::new();
        let read = (&mut self.file).take(LONGEST_NAME).read_until(0, &mut name);
        read.map_err(|error| self.failed(error))?;
        if name.pop() != Some(0) {
            return Err(self.cut_off());
        }
        String::from_utf8(name).map_err(|_| self.refuse("its name is no UTF-8; rename the picture"))
    }

    fn skip(&mut self, bytes: u64) -> Result<(), SceneError> {
        let skipped = io::copy(&mut (&mut self.file).take(bytes), &mut io::sink());
        match skipped.map_err(|error| self.failed(error))? {
            skipped if skipped == bytes => Ok(()),
            _ => Err(self.cut_off()),
        }
    }
}

pub(super) fn cameras(path: &Path) -> Result<HashMap<u32, Intrinsics>, SceneError> {
    let mut reader = Reader::open(path)?;
    let count = reader.u64()?;
    let mut cameras = HashMap::new();
    for number in 1..=count {
        reader.what = format!("camera {number} of {count}");
        let (id, model) = (reader.u32()?, reader.u32()?);
        let name = match model::NAMES.get(model as usize) {
            Some(name) => (*name).to_owned(),
            None => format!("number {model}"),
        };
        let wanted = model::parameters(&name).map_err(|message| reader.refuse(message))?;
        let size = [reader.u64()?, reader.u64()?];
        let parameters = (0..wanted).map(|_| reader.f64()).collect::<Result<Vec<_>, _>>()?;
        let intrinsics =
            model::intrinsics(&name, size, &parameters).map_err(|message| reader.refuse(message))?;
        cameras.insert(id, intrinsics);
    }
    Ok(cameras)
}

pub(super) fn images(path: &Path) -> Result<Vec<Image>, SceneError> {
    let mut reader = Reader::open(path)?;
    let count = reader.u64()?;
    let mut images = Vec::new();
    for number in 1..=count {
        reader.what = format!("image {number} of {count}");
        reader.u32()?;
        let rotation = [reader.f64()?, reader.f64()?, reader.f64()?, reader.f64()?];
        let translation = [reader.f64()?, reader.f64()?, reader.f64()?];
        let camera = reader.u32()?;
        let name = reader.name()?;
        let points = reader.u64()?;
        reader.what = format!("image {number} of {count} (\"{name}\")");
        let bytes = points.checked_mul(POINT).ok_or_else(|| reader.cut_off())?;
        reader.skip(bytes)?;
        images.push(Image { rotation, translation, camera, name });
    }
    Ok(images)
}
