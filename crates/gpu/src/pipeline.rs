//! Compute pipelines: a kernel with its bindings, push constants and specialization.

use std::fmt;
use std::sync::{Arc, Mutex};

use ash::vk;

use super::device::{Device, Shared};
use super::error::{During, GpuError};
use super::shader::Shader;
use super::{Result, lock};

/// Bytes of push constants that every Vulkan device supports; longer parameters go into a buffer.
pub const MAX_PUSH_BYTES: u32 = 128;

/// Maximum number of storage buffers that one kernel can bind: a batch has this many descriptors.
pub(super) const MAX_BINDINGS: u32 = 64;

/// A kernel that can be dispatched. Its Vulkan objects belong to the device: making the same one again, for
/// another engine, costs nothing.
#[derive(Clone)]
pub struct Pipeline {
    pub(super) device: Device,
    pub(super) kernel: &'static str,
    pub(super) bindings: Bindings,
    pub(super) push_bytes: u32,
    code: &'static [u32],
    specialization: Vec<(u32, u32)>,
    made: Arc<Mutex<Parts>>,
}

/// The Vulkan objects; null where not made yet.
#[derive(Clone, Copy, Default)]
pub(super) struct Parts {
    pub(super) set_layout: vk::DescriptorSetLayout,
    pub(super) layout: vk::PipelineLayout,
    pub(super) pipeline: vk::Pipeline,
}

/// The buffers that a kernel binds: storage buffers at the first bindings of set 0, uniform buffers behind them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bindings {
    /// Number of storage buffers, bindings 0 and up.
    pub storage: u32,
    /// Number of uniform buffers, at the bindings behind them.
    pub uniform: u32,
}

impl From<u32> for Bindings {
    fn from(storage: u32) -> Self {
        Self { storage, uniform: 0 }
    }
}

impl Bindings {
    pub(super) fn count(self) -> u32 {
        self.storage + self.uniform
    }

    pub(super) fn kind(self, binding: u32) -> vk::DescriptorType {
        match binding < self.storage {
            true => vk::DescriptorType::STORAGE_BUFFER,
            false => vk::DescriptorType::UNIFORM_BUFFER,
        }
    }
}

/// What identifies a compiled kernel: the address of its code (unique, unlike its name), its bindings, push constants and
/// specialization.
pub(super) type Key = (usize, Bindings, u32, Vec<(u32, u32)>);

impl Parts {
    pub(super) fn destroy(self, shared: &Shared) {
        let device = shared.raw();
        // SAFETY: nothing executes that uses the pipeline: batches hold the device and wait for their end. Null is
        // ignored.
        unsafe {
            device.destroy_pipeline(self.pipeline, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

impl Pipeline {
    /// Compiles a kernel with these buffers and `push_bytes` of push constants.
    /// `specialization`: (constant id, value) pairs.
    ///
    /// # Errors
    /// Fails if the driver cannot compile it, if buffers or push constants exceed what the device allows, or
    /// with [`GpuError::Interrupted`] if the watch of the device breaks.
    pub fn new(
        device: &Device,
        shader: &Shader,
        bindings: impl Into<Bindings>,
        push_bytes: u32,
        specialization: &[(u32, u32)],
    ) -> Result<Self> {
        let pipeline = Self::uncompiled(device, shader, bindings, push_bytes, specialization)?;
        pipeline.parts()?;
        Ok(pipeline)
    }

    fn uncompiled(
        device: &Device,
        shader: &Shader,
        bindings: impl Into<Bindings>,
        push_bytes: u32,
        specialization: &[(u32, u32)],
    ) -> Result<Self> {
        let kernel = shader.name();
        let info = device.info();
        let limit = info.max_push_bytes.min(MAX_PUSH_BYTES);
        if push_bytes > limit || !push_bytes.is_multiple_of(4) {
            return Err(GpuError::PushTooLarge { kernel, bytes: push_bytes, limit });
        }
        let bindings = bindings.into();
        let limit = info.max_storage_buffers.min(MAX_BINDINGS);
        if bindings.count() > limit {
            return Err(GpuError::TooManyBindings { kernel, bindings: bindings.count(), limit });
        }
        let code = shader.spirv();
        let key = (code.as_ptr() as usize, bindings, push_bytes, specialization.to_vec());
        let made = lock(&device.shared.pipelines).entry(key).or_default().clone();
        Ok(Self {
            device: device.clone(),
            kernel,
            bindings,
            push_bytes,
            code,
            specialization: specialization.to_vec(),
            made,
        })
    }

    /// Compiles the kernel now, unless it is compiled.
    ///
    /// # Errors
    /// Fails if the driver cannot compile it, or if the watch of the device breaks.
    pub fn compile(&self) -> Result<()> {
        self.parts().map(|_| ())
    }

    /// The Vulkan objects of the kernel, made at the first call.
    pub(super) fn parts(&self) -> Result<Parts> {
        // Held while compiling, so that a thread that needs the same kernel waits instead of compiling it again.
        let mut made = lock(&self.made);
        if made.pipeline == vk::Pipeline::null() {
            self.device.check_watch()?;
            let mut parts = Parts::default();
            let created = self.create_layouts(&mut parts).and_then(|()| self.create_pipeline(&mut parts));
            if let Err(error) = created {
                parts.destroy(&self.device.shared);
                return Err(error);
            }
            *made = parts;
        }
        Ok(*made)
    }

    /// The kernel's name, in the profile too.
    pub fn kernel(&self) -> &'static str {
        self.kernel
    }

    fn create_layouts(&self, parts: &mut Parts) -> Result<()> {
        let shared = &self.device.shared;
        let device = shared.raw();
        let bindings: Vec<_> = (0..self.bindings.count())
            .map(|binding| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(binding)
                    .descriptor_type(self.bindings.kind(binding))
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        let create = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        // SAFETY: the device is alive, as in every call of this file.
        parts.set_layout = unsafe { device.create_descriptor_set_layout(&create, None) }
            .during("creating the bindings of kernel", self.kernel)?;
        shared.name(parts.set_layout, self.kernel);

        let sets = [parts.set_layout];
        let ranges = [vk::PushConstantRange::default()
            .stage_flags(vk::ShaderStageFlags::COMPUTE)
            .size(self.push_bytes)];
        // Vulkan has no empty ranges.
        let ranges = if self.push_bytes == 0 { &[][..] } else { &ranges[..] };
        let create = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets).push_constant_ranges(ranges);
        // SAFETY: the set layout was made above; the range was checked against the limit.
        parts.layout = unsafe { device.create_pipeline_layout(&create, None) }
            .during("creating the layout of kernel", self.kernel)?;
        shared.name(parts.layout, self.kernel);
        Ok(())
    }

    fn create_pipeline(&self, parts: &mut Parts) -> Result<()> {
        let shared = &self.device.shared;
        let device = shared.raw();
        let create = vk::ShaderModuleCreateInfo::default().code(self.code);
        // SAFETY: the code comes from the compiler: there are no shaders but those of the build.
        let module =
            unsafe { device.create_shader_module(&create, None) }.during("loading kernel", self.kernel)?;
        shared.name(module, self.kernel);

        let entries: Vec<_> = (0u32..)
            .zip(&self.specialization)
            .map(|(index, &(id, _))| vk::SpecializationMapEntry {
                constant_id: id,
                offset: 4 * index,
                size: 4,
            })
            .collect();
        let values: Vec<u8> = self.specialization.iter().flat_map(|(_, value)| value.to_ne_bytes()).collect();
        let constants = vk::SpecializationInfo::default().map_entries(&entries).data(&values);
        let stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(c"main")
            .specialization_info(&constants);
        let mut create = vk::ComputePipelineCreateInfo::default().stage(stage).layout(parts.layout);
        if shared.statistics.is_some() {
            create = create.flags(vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR);
        }
        let create = [create];
        // SAFETY: module, layout and the pointers in `stage` outlive the call; a pipeline does not need its module.
        let created = unsafe {
            let created = device.create_compute_pipelines(shared.cache, &create, None);
            device.destroy_shader_module(module, None);
            created
        };
        let pipelines = created.map_err(|(_, result)| result);
        parts.pipeline =
            pipelines.during("compiling kernel", self.kernel)?.into_iter().next().unwrap_or_default();
        shared.name(parts.pipeline, self.kernel);
        if let Some(statistics) = &shared.statistics {
            statistics.ask(parts.pipeline, self.kernel, &self.specialization);
        }
        Ok(())
    }

    pub(super) fn check(&self, device: &Device) -> Result<()> {
        if Arc::ptr_eq(&self.device.shared, &device.shared) {
            return Ok(());
        }
        Err(GpuError::OtherDevice { label: self.kernel.to_owned() })
    }
}

impl fmt::Debug for Pipeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Pipeline").field(&self.kernel).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DeviceOptions;
    use crate::shader::engine_kernel;

    #[test]
    fn kernels_of_one_name_are_not_taken_for_one_another() {
        let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device");
        let new = |shader: &Shader| {
            Pipeline::new(&device, shader, 3, 12, &[]).expect("a pipeline").parts().expect("compiled")
        };
        let combine = &engine_kernel("combine");
        let other = Shader::new(combine.name(), engine_kernel("dot").spirv());
        let (parts, others) = (new(combine), new(&other));
        assert_ne!(parts.pipeline, others.pipeline);
        assert_eq!((new(combine).pipeline, new(&other).pipeline), (parts.pipeline, others.pipeline));
    }
}
