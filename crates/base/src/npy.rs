//! Arrays of numbers in NumPy's format, versions 1 to 3.

use std::io::{self, Write};

/// What every file starts with.
const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// The data start at a multiple of it, bytes.
const ALIGNMENT: usize = 64;

/// A number that arrays hold.
pub trait Number: Copy {
    /// Its kind in a header.
    const KIND: &str;
    /// The bytes of numbers.
    fn write(self, to: &mut dyn Write) -> io::Result<()>;
}

macro_rules! number {
    ($($type:ty, $kind:literal;)*) => {
        $(impl Number for $type {
            const KIND: &str = $kind;
            fn write(self, to: &mut dyn Write) -> io::Result<()> {
                to.write_all(&self.to_le_bytes())
            }
        })*
    };
}

number! {
    f32, "<f4";
    f64, "<f8";
    i64, "<i8";
}

/// Writes numbers as an array of a shape, the last index running fastest.
///
/// # Errors
/// Fails if writing fails, or if there are more or fewer numbers than the shape has.
pub fn write<T: Number>(
    mut to: impl Write,
    shape: &[u64],
    numbers: impl Iterator<Item = T>,
) -> io::Result<()> {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let header = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({sides}), }}", T::KIND);
    let start = MAGIC.len() + 4;
    let length = (start + header.len() + 1).next_multiple_of(ALIGNMENT) - start;
    let of_length = u16::try_from(length).map_err(io::Error::other)?;
    to.write_all(MAGIC)?;
    to.write_all(&[1, 0])?;
    to.write_all(&of_length.to_le_bytes())?;
    writeln!(to, "{header:<width$}", width = length - 1)?;
    let mut count = 0u64;
    for number in numbers {
        number.write(&mut to)?;
        count += 1;
    }
    if count != shape.iter().product::<u64>() {
        return Err(io::Error::other(format!("{count} numbers for the shape {shape:?}")));
    }
    to.flush()
}

/// An array of floats.
#[derive(Clone, Debug, PartialEq)]
pub struct Floats {
    /// Its sides.
    pub shape: Vec<u64>,
    /// The numbers, the last index running fastest.
    pub numbers: Vec<f64>,
}

/// Reads an array of floats of either precision.
///
/// # Errors
/// Fails if it is no such array: the error says why.
pub fn read(bytes: &[u8]) -> Result<Floats, String> {
    let short = "ends too soon";
    let rest = bytes.strip_prefix(MAGIC).ok_or("is no array of NumPy")?;
    let (version, rest) = rest.split_first_chunk::<2>().ok_or(short)?;
    let (length, rest) = match version[0] {
        1 => rest.split_first_chunk().map(|(length, rest)| (u16::from_le_bytes(*length).into(), rest)),
        _ => rest.split_first_chunk().map(|(length, rest)| (u32::from_le_bytes(*length), rest)),
    }
    .ok_or(short)?;
    let (header, data) = rest.split_at_checked(length as usize).ok_or(short)?;
    let header = String::from_utf8_lossy(header);
    // The header is a dictionary in Python, whose keys NumPy writes in one form.
    let value =
        |key: &str| header.split_once(&format!("'{key}':")).map_or("", |(_, value)| value.trim_start());
    if value("fortran_order").starts_with("True") {
        return Err("is stored by columns".to_owned());
    }
    let inner =
        value("shape").strip_prefix('(').and_then(|shape| shape.split_once(')')).ok_or("has no shape")?.0;
    let sides = inner.split(',').map(str::trim).filter(|side| !side.is_empty());
    let shape: Vec<u64> =
        sides.map(str::parse).collect::<Result<_, _>>().map_err(|_| format!("has the shape ({inner})"))?;
    let numbers: Vec<f64> = match value("descr").get(1..4) {
        Some("<f4") => data.as_chunks().0.iter().map(|number| f32::from_le_bytes(*number).into()).collect(),
        Some("<f8") => data.as_chunks().0.iter().map(|number| f64::from_le_bytes(*number)).collect(),
        _ => return Err("holds no floats of 32 or 64 bits".to_owned()),
    };
    let count = shape.iter().try_fold(1u64, |count, side| count.checked_mul(*side));
    if count != Some(numbers.len() as u64) {
        return Err(format!("has {} numbers for the shape {shape:?}", numbers.len()));
    }
    Ok(Floats { shape, numbers })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let numbers = [0.5, -1.0, 3e-40, f64::INFINITY, 2.0, 7.0];
        let mut file = Vec::new();
        write(&mut file, &[2, 3], numbers.into_iter()).expect("written");
        assert_eq!((file.len() - 48) % ALIGNMENT, 0);
        assert_eq!(&file[..10], b"\x93NUMPY\x01\x00\x76\x00");
        assert_eq!(read(&file), Ok(Floats { shape: vec![2, 3], numbers: numbers.to_vec() }));
        let mut single = Vec::new();
        write(&mut single, &[2], [0.25f32, 8.0].into_iter()).expect("written");
        assert_eq!(read(&single), Ok(Floats { shape: vec![2], numbers: vec![0.25, 8.0] }));
        assert!(write(Vec::new(), &[2], [1.0].into_iter()).is_err());
    }

    #[test]
    fn other_files_are_refused() {
        let mut file = Vec::new();
        write(&mut file, &[1], [1.0].into_iter()).expect("written");
        for length in 0..file.len() {
            assert!(read(&file[..length]).is_err(), "{length}");
        }
        for (from, to) in [("<f8", "<i8"), ("False", "True "), ("(1, )", "(-1,)"), ("(1, )", "(9e9)")] {
            let text = String::from_utf8_lossy(&file[10..128]).replace(from, to);
            let other = [&file[..10], text.as_bytes(), &file[128..]].concat();
            assert!(read(&other).is_err(), "{to}");
        }
        assert!(read(b"PNG").is_err());
    }
}
