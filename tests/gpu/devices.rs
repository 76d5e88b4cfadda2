//! Devices: found, chosen, shared, lent by an embedder, watched by validation.
#![allow(
    unsafe_code,
    reason = "devices that plain Vulkan calls opened, and mistakes that validation must find"
)]

use antirad::gpu::{Device, Enabled, GpuError};
use antirad_gpu as gpu;
use antirad_gpu::embed::RawDevice;
use ash::vk;

use crate::{Axpy, axpy_pipeline, device, filled, finish, options};

#[test]
fn device_tells_what_it_is() {
    let device = device();
    let info = device.info();
    assert!(!info.name.is_empty() && !info.driver.trim().is_empty());
    assert!(info.max_storage_buffer_range >= 1 << 27);
    assert!(info.max_allocation > 0 && info.heap_bytes > 0);
    assert!(info.subgroup_size.is_power_of_two());
    assert!(info.max_workgroup_invocations >= 128);
    let listed = gpu::list_devices().unwrap();
    let same = &listed[info.index];
    assert_eq!(same.info.name, info.name);
    assert!(same.missing.is_empty());
    // The index selects it, and so does part of the name in another case.
    for selector in [info.index.to_string(), info.name[..4].to_uppercase()] {
        let options = options().selector(Some(selector));
        finish(Device::new(&options).unwrap());
    }
    finish(device);
}

#[test]
fn unknown_device_is_an_error_that_lists_what_is_there() {
    let name = device().info().name.clone();
    for selector in ["no such device", "4711"] {
        let options = options().selector(Some(selector.into()));
        let Err(error) = Device::new(&options) else { panic!("there is a device {selector}") };
        let error = error.to_string();
        assert!(error.contains(selector) && error.contains(&name), "{error}");
    }
}

#[test]
fn an_embedders_device_is_used_and_left_alone() {
    // SAFETY: plain Vulkan: every object is made before it is used and destroyed after it.
    unsafe {
        let entry = ash::Entry::load().unwrap();
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_2);
        let create = vk::InstanceCreateInfo::default().application_info(&application);
        let instance = entry.create_instance(&create, None).unwrap();
        let physical_device = instance.enumerate_physical_devices().unwrap()[0];
        let families = instance.get_physical_device_queue_family_properties(physical_device);
        let compute =
            |family: &vk::QueueFamilyProperties| family.queue_flags.contains(vk::QueueFlags::COMPUTE);
        let queue_family = families.iter().position(compute).unwrap() as u32;
        let queues =
            [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&[1.0])];
        let mut layout = vk::PhysicalDeviceScalarBlockLayoutFeatures::default().scalar_block_layout(true);
        let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).push_next(&mut layout);
        let raw = instance.create_device(physical_device, &create, None).unwrap();
        let queue = raw.get_device_queue(queue_family, 0);

        for _ in 0..2 {
            let device = Device::from_raw(RawDevice {
                entry: entry.clone(),
                instance: instance.clone(),
                physical_device,
                device: raw.clone(),
                queue_family,
                queue,
                enabled: Enabled::default(),
                memory_budget: Some(64 << 20),
            })
            .unwrap();
            assert_eq!(device.info().enabled, Enabled::default());
            assert_eq!(device.memory().budget, 64 << 20);
            let pipeline = axpy_pipeline(&device);
            let (x, y) = (filled(&device, "x", &[1.0, 2.0]), filled(&device, "y", &[3.0, 4.0]));
            let push = Axpy { count: 2, a: 10.0, b: 1.0 };
            let push = bytemuck::bytes_of(&push);
            let mut batch = device.batch().unwrap();
            batch.dispatch(&pipeline, "2", &[x.whole(), y.whole()], push, [1, 1, 1]).unwrap();
            batch.submit().unwrap();
            assert_eq!(device.download_slice::<f32>(&y, 0, 2).unwrap(), [13.0, 24.0]);
        }
        // The device still belongs to the embedder and works.
        raw.device_wait_idle().unwrap();
        raw.destroy_device(None);
        instance.destroy_instance(None);
    }
}

/// Every test relies on an empty log, so the log must be able to fill.
#[test]
fn validation_finds_a_mistake() {
    let device = device();
    device.check_validation().unwrap();
    // A buffer without any usage: invalid, but harmless.
    let create = vk::BufferCreateInfo::default().size(256);
    // SAFETY: the mistake that validation must find; drivers ignore it.
    unsafe {
        if let Ok(buffer) = device.raw().create_buffer(&create, None) {
            device.raw().destroy_buffer(buffer, None);
        }
    }
    let messages = device.validation_messages();
    assert!(messages.iter().any(|text| text.contains("usage")), "{messages:?}");
    assert!(matches!(device.check_validation(), Err(GpuError::Validation(_))));
}

/// Objects that outlive the device must appear in the log as well: `finish` relies on it.
#[test]
fn validation_finds_leaks() {
    let device = device();
    let create = vk::BufferCreateInfo::default().size(256).usage(vk::BufferUsageFlags::TRANSFER_SRC);
    // SAFETY: a plain call; the leak is the point.
    unsafe { device.raw().create_buffer(&create, None) }.unwrap();
    let log = device.validation_log();
    assert!(log.messages().is_empty());
    drop(device);
    assert!(log.messages().iter().any(|text| text.contains("VkBuffer")), "{:?}", log.messages());
}

/// The validation layer keeps a table of all devices, which it reads in every call without a lock.
#[test]
fn devices_come_and_go_beside_others() {
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| {
                for _ in 0..6 {
                    let device = device();
                    for size in 1..400 {
                        filled(&device, "some", &vec![1.0; size]);
                    }
                    finish(device);
                }
            });
        }
    });
}
