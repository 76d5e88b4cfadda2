//! The GPU layer on a real device (a CPU driver suffices), with validation: every test ends with an empty message log
//! after the device is destroyed, so that leaks are found as well.

mod devices;
mod dispatches;
mod memory;
mod metal;
#[path = "../support/reflect.rs"]
mod reflect;
mod shader_files;

use antirad::gpu::{Device, DeviceOptions};
use antirad::scene::Precision;
use antirad_core::shaders;
use antirad_gpu::{Buffer, BufferKind, Pipeline};
use bytemuck::{Pod, Zeroable};

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Axpy {
    a: f32,
    b: f32,
    count: u32,
}

const AXPY_PUSH: u32 = size_of::<Axpy>() as u32;

fn options() -> DeviceOptions {
    DeviceOptions::default().validation(true)
}

fn device() -> Device {
    Device::new(&options()).unwrap()
}

/// Drops the last reference to the device and requires that validation has found nothing.
fn finish(device: Device) {
    let log = device.validation_log();
    drop(device);
    assert_eq!(log.messages(), Vec::<String>::new());
}

fn axpy_pipeline(device: &Device) -> Pipeline {
    Pipeline::new(device, shaders::COMBINE.of(Precision::F32), 2, AXPY_PUSH, &[(0, 32)]).unwrap()
}

fn filled(device: &Device, label: &str, values: &[f32]) -> Buffer {
    let bytes = size_of_val(values) as u64;
    let buffer = Buffer::new(device, label, bytes, BufferKind::Storage).unwrap();
    device.upload_slice(&buffer, 0, values).unwrap();
    buffer
}

fn ramp(count: usize) -> Vec<f32> {
    (0..count).map(|i| i as f32).collect()
}

/// Integers below 2^24: f32 is exact, whether multiply and add are fused or not.
fn axpy(a: f32, x: &[f32], y: &[f32]) -> Vec<f32> {
    x.iter().zip(y).map(|(x, y)| a * x + y).collect()
}
