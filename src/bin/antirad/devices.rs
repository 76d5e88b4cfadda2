//! `antirad devices`.

use crate::Failure;
use antirad::gpu::{Bytes, list_devices};

pub fn run() -> Result<(), Failure> {
    let devices = list_devices()?;
    if devices.is_empty() {
        println!("no Vulkan device (on a server without a GPU: apt install mesa-vulkan-drivers)");
    }
    for device in devices {
        let info = &device.info;
        println!(
            "{}: {} ({}, {}, Vulkan {})",
            info.index, info.name, info.kind, info.driver, info.api_version
        );
        println!("   memory            {} on the device", Bytes(info.heap_bytes));
        println!("   largest buffer    {} seen by a kernel", Bytes(info.max_storage_buffer_range));
        let (least, most) = info.subgroup_size_range;
        let sizes = if least == most { String::new() } else { format!(", {least} to {most} on request") };
        println!("   subgroup          {} lanes{sizes}", info.subgroup_size);
        println!("   storage buffers   {} in a kernel", info.max_storage_buffers);
        println!("   double precision  {}", if info.enabled.float64 { "yes" } else { "no" });
        println!("   timestamps        {}", if info.timestamp_period_ns > 0.0 { "yes" } else { "no" });
        match device.missing.as_slice() {
            [] => println!("   antirad           has all it needs"),
            missing => println!("   antirad           cannot use it: it lacks {}", missing.join(", ")),
        }
    }
    Ok(())
}
