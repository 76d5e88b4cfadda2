//! `antirad devices`.

use crate::Failure;
use antirad::backend::{Backend, BackendKind};
use antirad::gpu::{Bytes, Device, DeviceOptions, KernelStatistics, ListedDevice, list_devices};
use antirad::image::Rasterizer;
use antirad::output::atomic_write;
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::scene::{
    Lamps, Material, Scene, SceneBuilder, SceneError, Shape, SolveSettings, VisibilityChoice,
};
use antirad_core::transport::vulkan;
use clap::Args;
use glam::{DAffine3, DVec3};
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

#[derive(Args)]
#[command(after_help = "Examples:
  antirad devices
  ANTIRAD_DEVICE=1 antirad render scenes/cornell_boxes.toml
  antirad devices --kernels=kernels.csv")]
pub struct Arguments {
    /// Compile the kernels of solves, gradients and pictures on the device, and write what its driver tells of each, such as registers and scratch
    /// memory, as CSV to this file, or to the standard output
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    kernels: Option<Option<PathBuf>>,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(file) = &arguments.kernels {
        return kernels(file.as_deref());
    }
    let backend = Backend::chosen(None, &DeviceOptions::default());
    let cpu = Backend::cpu();
    antirad::say!("backend cpu: {}{}", cpu.device_name(), usual(backend == BackendKind::Cpu));
    antirad::say!("   threads           {}", cpu.threads());
    antirad::say!("   vectors           {}", cpu.driver());
    antirad::say!("   memory budget     {}", Bytes(cpu.memory().budget));
    antirad::say!("backend vulkan{}", usual(backend == BackendKind::Vulkan));
    let devices = match list_devices() {
        Ok(devices) => devices,
        Err(error) => {
            antirad::say!("   {error}");
            return Ok(());
        }
    };
    if devices.is_empty() {
        antirad::say!("   no Vulkan device (on a server without a GPU: apt install mesa-vulkan-drivers)");
    }
    for device in devices {
        let info = &device.info;
        antirad::say!(
            "{}: {} ({}, {}, Vulkan {})",
            info.index,
            info.name,
            info.kind,
            info.driver,
            info.api_version
        );
        antirad::say!("   memory            {} on the device", Bytes(info.heap_bytes));
        antirad::say!("   largest buffer    {} seen by a kernel", Bytes(info.largest_buffer()));
        antirad::say!("   subgroup          {} lanes", info.subgroup_size);
        antirad::say!("   storage buffers   {} in a kernel", info.max_storage_buffers);
        antirad::say!("   double precision  {}", if info.enabled.float64 { "yes" } else { "no" });
        antirad::say!("   timestamps        {}", if info.timestamp_period_ns > 0.0 { "yes" } else { "no" });
        antirad::say!("   antirad           {}", verdict(&device));
    }
    Ok(())
}

/// Said of the backend that is taken unless another is asked for.
fn usual(is: bool) -> &'static str {
    if is { " (taken unless another is asked for)" } else { "" }
}

/// What antirad can do with a device.
fn verdict(device: &ListedDevice) -> String {
    match device.missing.as_slice() {
        [] if device.info.enabled.float64 => "has all it needs".to_owned(),
        [] => "has all it needs, but for precision \"f64\" (shaderFloat64)".to_owned(),
        missing => format!("cannot use it: it lacks {}", missing.join(", ")),
    }
}

/// Writes what the driver tells of kernels.
fn kernels(file: Option<&Path>) -> Result<(), Failure> {
    // What is compiled in another run is not told of.
    let options = DeviceOptions::default().statistics(true).kernel_cache(None);
    let device = Device::new(&options)?;
    let scene = every_class()?;
    let options = PlanOptions::of(&device).boundless().gradients(GradientRequest::EVERYTHING);
    let settings = SolveSettings::default().visibility(VisibilityChoice::Implicit).lamps(Lamps::Exact);
    vulkan::compile(&device, &Plan::new(&scene, &options, &settings)?)?;
    Rasterizer::new(&device)?;
    let rows = device.kernel_statistics();
    if rows.iter().all(|row| row.values.is_empty()) {
        let name = &device.info().name;
        return Err(io::Error::other(format!("the driver of {name} tells nothing of kernels")).into());
    }
    let table = table(&rows)?;
    match file {
        Some(file) => atomic_write(file, |to| to.write_all(&table))?,
        None => antirad::say!("{}", String::from_utf8_lossy(&table).trim_end()),
    }
    Ok(())
}

/// Triangles of all classes: a glossy floor, a blocker above it, and a lamp above both.
fn every_class() -> Result<Scene, SceneError> {
    let floor = Material { specular: [0.2; 3], power: 10.0, ..Material::named("floor") };
    let lamp = Material { emission: [5.0, 4.0, 3.0], ..Material::named("lamp") };
    let down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
    let at = |height: f64| DAffine3::from_translation(DVec3::new(0.0, height, 0.0));
    let mut builder = SceneBuilder::new();
    builder
        .shape("floor", Shape::Quad { cells: 3 }, &floor, at(0.0))
        .shape("blocker", Shape::Quad { cells: 2 }, &Material::named("blocker"), at(0.5))
        .shape("lamp", Shape::Quad { cells: 1 }, &lamp, at(1.0) * down);
    builder.finish("every class")
}

/// A line per kernel, and a column for each name that the driver knows.
fn table(rows: &[KernelStatistics]) -> Result<Vec<u8>, Failure> {
    let names: BTreeSet<&str> =
        rows.iter().flat_map(|row| row.values.iter().map(|(name, _)| name.as_str())).collect();
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(["kernel", "specialization"].into_iter().chain(names.iter().copied()))?;
    for row in rows {
        let constants = row.specialization.iter().map(|(id, value)| format!("{id}={value}"));
        let constants: Vec<String> = constants.collect();
        let value = |name: &&str| row.get(name).map_or_else(String::new, |value| value.to_string());
        let own = [row.kernel.to_owned(), constants.join(" ")];
        table.write_record(own.into_iter().chain(names.iter().map(value)))?;
    }
    Ok(table.into_inner().map_err(csv::IntoInnerError::into_error)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad::gpu::DeviceInfo;

    #[test]
    fn verdicts_name_what_is_missing() {
        let mut device = ListedDevice { info: DeviceInfo::default(), missing: Vec::new() };
        assert_eq!(verdict(&device), "has all it needs, but for precision \"f64\" (shaderFloat64)");
        device.info.enabled = device.info.enabled.float64(true);
        assert_eq!(verdict(&device), "has all it needs");
        device.missing = vec!["scalarBlockLayout".to_owned(), "a compute queue".to_owned()];
        assert_eq!(verdict(&device), "cannot use it: it lacks scalarBlockLayout, a compute queue");
    }
}
