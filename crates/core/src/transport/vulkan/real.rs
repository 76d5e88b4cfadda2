//! Conversion between the device's numbers, f32 or f64 by the plan, and the host's, always f64.

use antirad_gpu::{Buffer, BufferKind, Device, GpuError};
use antirad_scene::Precision;
use std::ops::Range;

/// Push constants of a kernel: its reals, then its words. No kernel mixes them, so this is their layout in either
/// precision.
pub fn push(precision: Precision, reals: &[f64], words: &[u32]) -> Vec<u8> {
    let mut bytes = encode(precision, reals);
    bytes.extend(words.iter().flat_map(|word| word.to_ne_bytes()));
    bytes
}

/// Size in bytes of the push constants of `reals` reals and `words` words.
pub fn push_bytes(precision: Precision, reals: u32, words: u32) -> u32 {
    reals * precision.bytes() as u32 + words * 4
}

/// Writes `values` into the buffer from its start on.
///
/// # Errors
/// Fails if the values are too many for the buffer, or if the device fails.
pub fn upload(
    device: &Device,
    buffer: &Buffer,
    precision: Precision,
    values: &[f64],
) -> Result<(), GpuError> {
    device.upload(buffer, 0, &encode(precision, values))
}

/// Reads these values of the buffer.
///
/// # Errors
/// Fails if the range goes beyond the buffer, or if the device fails.
pub fn download(
    device: &Device,
    buffer: &Buffer,
    precision: Precision,
    values: Range<u64>,
) -> Result<Vec<f64>, GpuError> {
    let (offset, count) = (values.start * precision.bytes(), values.end - values.start);
    match precision {
        Precision::F32 => {
            Ok(device.download_slice::<f32>(buffer, offset, count)?.into_iter().map(f64::from).collect())
        }
        Precision::F64 => device.download_slice(buffer, offset, count),
    }
}

/// A new buffer with these values.
///
/// # Errors
/// Fails if the device has no memory for it, or cannot write to it.
pub fn filled(
    device: &Device,
    label: &str,
    precision: Precision,
    values: &[f64],
) -> Result<Buffer, GpuError> {
    let bytes = values.len() as u64 * precision.bytes();
    let buffer = Buffer::new(device, label, bytes, BufferKind::Storage)?;
    upload(device, &buffer, precision, values)?;
    Ok(buffer)
}

/// Values to bytes of the device.
pub fn encode(precision: Precision, values: &[f64]) -> Vec<u8> {
    match precision {
        Precision::F32 => values.iter().flat_map(|&x| (x as f32).to_ne_bytes()).collect(),
        Precision::F64 => bytemuck::cast_slice(values).to_vec(),
    }
}

/// Bytes of the device to values.
pub fn decode(precision: Precision, bytes: &[u8]) -> Vec<f64> {
    match precision {
        Precision::F32 => bytemuck::pod_collect_to_vec::<_, f32>(bytes).into_iter().map(f64::from).collect(),
        Precision::F64 => bytemuck::pod_collect_to_vec(bytes),
    }
}
