//! Numbers of a glTF file. No offset of the file is trusted.

use gltf::accessor::{DataType, Dimensions};

pub(super) struct Accessors<'a> {
    buffers: &'a [Vec<u8>],
}

impl<'a> Accessors<'a> {
    pub fn new(buffers: &'a [Vec<u8>]) -> Self {
        Self { buffers }
    }

    /// Rows of N numbers, integers scaled to 0 … 1 if they are normalized.
    ///
    /// # Errors
    /// Fails if rows do not have N numbers, if data are sparse, missing or past the end of a buffer, or if a
    /// number is not finite.
    pub fn rows<const N: usize>(&self, accessor: &gltf::Accessor) -> Result<Vec<[f64; N]>, String> {
        let number = |row: &[u8], at: usize| {
            let (x, most) = number(row, at, accessor.data_type());
            if accessor.normalized() { (x / most).max(-1.0) } else { x }
        };
        let rows = self.bytes(accessor, N)?;
        let rows = rows.map(|row| std::array::from_fn(|k| number(row, k)));
        let rows: Vec<[f64; N]> = rows.collect();
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
        Ok(self.bytes(accessor, 1)?.map(|row| number(row, 0, accessor.data_type()).0 as u32).collect())
    }

    /// The bytes of each row, of which there are as many as the file's buffers hold.
    fn bytes(
        &self,
        accessor: &gltf::Accessor,
        width: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]> + use<'a>, String> {
        let wrong = |what: &str| format!("accessor {} {what}", accessor.index());
        if accessor.dimensions().multiplicity() != width {
            return Err(wrong(&format!(
                "has {} numbers a row; expected {width}",
                accessor.dimensions().multiplicity()
            )));
        }
        if accessor.sparse().is_some() {
            return Err(wrong("is sparse, which is not read"));
        }
        let view = accessor.view().ok_or_else(|| wrong("has no data"))?;
        let buffer: &'a [u8] =
            self.buffers.get(view.buffer().index()).ok_or_else(|| wrong("has no buffer"))?;
        let size = accessor.data_type().size() * width;
        let stride = view.stride().unwrap_or(size).max(size);
        let (count, offset) = (accessor.count(), accessor.offset());
        let end = |start: usize, length: usize| start.checked_add(length).filter(|&end| end <= buffer.len());
        let view_end =
            end(view.offset(), view.length()).ok_or_else(|| wrong("reads past the end of its buffer"))?;
        let last = count.saturating_sub(1).checked_mul(stride).and_then(|rows| rows.checked_add(size));
        let start = view.offset().checked_add(offset);
        match (start, last) {
            (Some(start), Some(last))
                if count == 0 || start.checked_add(last).is_some_and(|end| end <= view_end) =>
            {
                Ok((0..count).map(move |row| &buffer[start + row * stride..start + row * stride + size]))
            }
            _ => Err(wrong("reads past the end of its buffer")),
        }
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
