//! `antirad devices`.

use crate::Failure;
use antirad::gpu::{Bytes, list_devices};

pub fn run() -> Result<(), Failure> {
    let devices = list_devices()?;
    if devices.is_empty() {
        antirad::say!("no Vulkan device (on a server without a GPU: apt install mesa-vulkan-drivers)");
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
        antirad::say!("   largest buffer    {} seen by a kernel", Bytes(info.max_storage_buffer_range));
        let (least, most) = info.subgroup_size_range;
        let sizes = if least == most { String::new() } else { format!(", {least} to {most} on request") };
        antirad::say!("   subgroup          {} lanes{sizes}", info.subgroup_size);
        antirad::say!("   storage buffers   {} in a kernel", info.max_storage_buffers);
        antirad::say!("   double precision  {}", if info.enabled.float64 { "yes" } else { "no" });
        antirad::say!("   timestamps        {}", if info.timestamp_period_ns > 0.0 { "yes" } else { "no" });
        match device.missing.as_slice() {
            [] => antirad::say!("   antirad           has all it needs"),
            missing => antirad::say!("   antirad           cannot use it: it lacks {}", missing.join(", ")),
        }
    }
    Ok(())
}
