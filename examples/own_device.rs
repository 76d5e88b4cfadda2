// The embedder's own Vulkan device, lent to antirad for a solve: cargo run --release --example own_device

use antirad::gpu::{Device, Enabled};
use antirad::scene::{Material, Scene, Shape, Triangle};
use antirad::{Engine, SolveParams};
use antirad_gpu::embed::{RawDevice, ash};
use ash::vk;
use std::error::Error;
use std::f64::consts::FRAC_1_PI;

/// What an embedder has already opened.
struct Own {
    entry: ash::Entry,
    instance: ash::Instance,
    physical_device: vk::PhysicalDevice,
    device: ash::Device,
    queue_family: u32,
}

#[allow(unsafe_code, reason = "plain Vulkan, as an embedder calls it")]
impl Own {
    fn open() -> Result<Self, Box<dyn Error>> {
        // SAFETY: the loader is the system's; the instance is destroyed by `drop`, or here where there is no device.
        let (entry, instance) = unsafe {
            let entry = ash::Entry::load()?;
            // Kernels are SPIR-V 1.5, which Vulkan 1.2 brings.
            let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_2);
            let create = vk::InstanceCreateInfo::default().application_info(&application);
            let instance = entry.create_instance(&create, None)?;
            (entry, instance)
        };
        match Self::open_device(&instance) {
            Ok((physical_device, device, queue_family)) => {
                Ok(Self { entry, instance, physical_device, device, queue_family })
            }
            Err(error) => {
                // SAFETY: nothing made from the instance is left.
                unsafe { instance.destroy_instance(None) };
                Err(error)
            }
        }
    }

    /// The first device with a compute queue. antirad's error names whatever else it lacks.
    fn open_device(
        instance: &ash::Instance,
    ) -> Result<(vk::PhysicalDevice, ash::Device, u32), Box<dyn Error>> {
        // SAFETY: the instance is alive, and what `create` points to outlives the call.
        unsafe {
            for physical_device in instance.enumerate_physical_devices()? {
                let families = instance.get_physical_device_queue_family_properties(physical_device);
                let computes =
                    |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
                let Some(queue_family) = families.iter().position(computes) else { continue };
                let queue_family = queue_family as u32;
                let queues = [vk::DeviceQueueCreateInfo::default()
                    .queue_family_index(queue_family)
                    .queue_priorities(&[1.0])];
                // The one feature that antirad needs; no extension.
                let mut layout =
                    vk::PhysicalDeviceScalarBlockLayoutFeatures::default().scalar_block_layout(true);
                let create =
                    vk::DeviceCreateInfo::default().queue_create_infos(&queues).push_next(&mut layout);
                let device = instance.create_device(physical_device, &create, None)?;
                return Ok((physical_device, device, queue_family));
            }
        }
        Err("no Vulkan device supports compute".into())
    }

    /// The device as antirad takes it.
    fn lend(&self) -> RawDevice {
        RawDevice {
            entry: self.entry.clone(),
            instance: self.instance.clone(),
            physical_device: self.physical_device,
            device: self.device.clone(),
            queue_family: self.queue_family,
            // SAFETY: the device was created with one queue of this family.
            queue: unsafe { self.device.get_device_queue(self.queue_family, 0) },
            // Nothing optional.
            enabled: Enabled::default(),
            memory_budget: Some(64 << 20),
        }
    }
}

#[allow(unsafe_code, reason = "plain Vulkan, as an embedder calls it")]
impl Drop for Own {
    fn drop(&mut self) {
        // SAFETY: all that antirad made is gone: it borrowed the device from a value that lives in `main`.
        unsafe {
            self.device.destroy_device(None);
            self.instance.destroy_instance(None);
        }
    }
}

#[allow(unsafe_code, reason = "plain Vulkan, as an embedder calls it")]
fn main() -> Result<(), Box<dyn Error>> {
    // Declared first, dropped last: the device outlives everything that antirad makes from it.
    let own = Own::open()?;
    // SAFETY: the handles belong together, the device is for Vulkan 1.2 and has scalarBlockLayout, nobody else uses
    // its queue.
    let device = unsafe { Device::from_raw(own.lend()) }?;

    // A closed sphere whose wall emits 1 W/m² and reflects half of the incident light: irradiance is 1 / (1 - 0.5)
    // everywhere.
    let (vertices, faces) = Shape::Icosphere { level: 2, inward: true }.mesh();
    let wall = Material { albedo: [0.5; 3], emission: [FRAC_1_PI; 3], ..Material::named("wall") };
    let triangles = faces.into_iter().map(|vertices| Triangle { vertices, material: 0 }).collect();
    let scene = Scene::new("sphere", vertices, triangles, vec![wall])?;

    let mut engine = Engine::builder(&device, &scene).build()?;
    let solution = engine.solve(&SolveParams::from(&scene.settings))?;
    let mean = solution.irradiance.iter().map(|rgb| rgb[0]).sum::<f64>() / solution.irradiance.len() as f64;
    println!("{}: mean irradiance {mean:.4} W/m², exact 2", device.info().name);
    Ok(())
}
