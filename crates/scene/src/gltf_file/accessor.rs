//! Numbers of a glTF file. No offset of the file is trusted.

use gltf::accessor::sparse::IndexType;
use gltf::accessor::{DataType, Dimensions};

use super::buffers::Buffers;

/// Most rows of an accessor without data, which are zeros.
const MOST_ZEROS: usize = 10_000_000;

pub(super) struct Accessors<'a> {
    buffers: &'a Buffers,
}

impl<'a> Accessors<'a> {
    pub fn new(buffers: &'a Buffers) -> Self {
        Self { buffers }
    }

    /// Rows of N numbers, integers scaled to 0 … 1 or -1 … 1 if they are normalized.
    ///
    /// # Errors
    /// Fails if rows do not have N numbers, if data are missing or past the end of a buffer, or if a number is not finite.
    pub fn rows<const N: usize>(&self, accessor: &gltf::Accessor) -> Result<Vec<[f64; N]>, String> {
        let number = |row: &[u8], at: usize| {
            let (x, most) = number(row, at, accessor.data_type());
            if accessor.normalized() { (x / most).max(-1.0) } else { x }
        };
        let rows = self.bytes(accessor, N)?.into_iter();
        let rows: Vec<[f64; N]> = rows.map(|row| std::array::from_fn(|k| number(row, k))).collect();
        match rows.iter().flatten().all(|x| x.is_finite()) {
            true => Ok(rows),
            false => Err(format!("accessor {} has numbers that are not finite", accessor.index())),
        }
    }

    /// RGB of colours with or without alpha.
    ///
    /// # Errors
    /// Fails as [`Self::rows`] does.
    pub fn colours(&self, accessor: &gltf::Accessor) -> Result<Vec<[f64; 3]>, String> {
        match accessor.dimensions() {
            Dimensions::Vec4 => Ok(self.rows::<4>(accessor)?.iter().map(|&[r, g, b, _]| [r, g, b]).collect()),
            _ => self.rows::<3>(accessor),
        }
    }

    pub fn indices(&self, accessor: &gltf::Accessor) -> Result<Vec<u32>, String> {
        if !matches!(accessor.data_type(), DataType::U8 | DataType::U16 | DataType::U32) {
            return Err(format!("accessor {} has indices that are no unsigned integers", accessor.index()));
        }
        let rows = self.bytes(accessor, 1)?.into_iter();
        Ok(rows.map(|row| number(row, 0, accessor.data_type()).0 as u32).collect())
    }

    /// The bytes of each row: those of its view, or zeros, with the sparse ones in their place.
    fn bytes(&self, accessor: &gltf::Accessor, width: usize) -> Result<Vec<&'a [u8]>, String> {
        const ZEROS: &[u8] = &[0; 64];
        let wrong = |what: &str| format!("accessor {} {what}", accessor.index());
        let past_the_end = || wrong("reads past the end of its buffer");
        if accessor.dimensions().multiplicity() != width {
            return Err(wrong(&format!(
                "has {} numbers a row; expected {width}",
                accessor.dimensions().multiplicity()
            )));
        }
        let size = accessor.data_type().size() * width;
        let mut rows: Vec<&[u8]> = match accessor.view() {
            Some(view) => self
                .elements(&view, accessor.offset(), accessor.count(), size)
                .ok_or_else(past_the_end)?
                .collect(),
            None if accessor.count() > MOST_ZEROS => {
                return Err(wrong(&format!("has more than {MOST_ZEROS} rows without data")));
            }
            None => vec![&ZEROS[..size]; accessor.count()],
        };
        if let Some(sparse) = accessor.sparse() {
            let (places, values, count) = (sparse.indices(), sparse.values(), sparse.count());
            let kind = match places.index_type() {
                IndexType::U8 => DataType::U8,
                IndexType::U16 => DataType::U16,
                IndexType::U32 => DataType::U32,
            };
            let places = self.elements(&places.view(), places.offset(), count, kind.size());
            let values = self.elements(&values.view(), values.offset(), count, size);
            for (place, value) in places.ok_or_else(past_the_end)?.zip(values.ok_or_else(past_the_end)?) {
                let row = rows.get_mut(number(place, 0, kind).0 as usize);
                *row.ok_or_else(|| wrong("has sparse values past its last row"))? = value;
            }
        }
        Ok(rows)
    }

    /// The bytes of each of `count` elements of a view from an offset, or `None` if they reach past its end.
    fn elements(
        &self,
        view: &gltf::buffer::View,
        offset: usize,
        count: usize,
        size: usize,
    ) -> Option<impl Iterator<Item = &'a [u8]> + use<'a>> {
        let stride = view.stride().unwrap_or(size).max(size);
        let bytes = self.buffers.view(view)?.get(offset..)?;
        let end = count.saturating_sub(1).checked_mul(stride)?.checked_add(size)?;
        let fits = count == 0 || end <= bytes.len();
        fits.then(|| (0..count).map(move |row| &bytes[row * stride..row * stride + size]))
    }
}

/// A number of a row, and the largest of its type.
fn number(row: &[u8], at: usize, kind: DataType) -> (f64, f64) {
    fn bytes<const N: usize>(row: &[u8], at: usize) -> [u8; N] {
        std::array::from_fn(|k| row[at * N + k])
    }
    match kind {
        DataType::I8 => (i8::from_le_bytes(bytes(row, at)).into(), 127.0),
        DataType::U8 => (u8::from_le_bytes(bytes(row, at)).into(), 255.0),
        DataType::I16 => (i16::from_le_bytes(bytes(row, at)).into(), 32767.0),
        DataType::U16 => (u16::from_le_bytes(bytes(row, at)).into(), 65535.0),
        DataType::U32 => (u32::from_le_bytes(bytes(row, at)).into(), f64::from(u32::MAX)),
        DataType::F32 => (f32::from_le_bytes(bytes(row, at)).into(), 1.0),
    }
}
