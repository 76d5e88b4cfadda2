//! Batches: operations recorded in order, submitted at once, waited for.

use std::mem;
use std::sync::Arc;
use std::time::Instant;

use ash::vk;

use super::buffer::{Block, Buffer, BufferSlice};
use super::device::Device;
use super::error::GpuError;
use super::pipeline::Pipeline;
use super::recorder::Recorder;
use super::transfer::{Deferred, UsedScopes};
use super::{Result, lock};
use antirad_base::usage::{ALIGN, Bytes};

/// Bytes that Vulkan sets at a time.
const MOST_UPDATED: usize = 65_536;

/// How long a batch took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BatchTiming {
    /// Number of kernels that ran; copies and fills are not counted.
    pub dispatches: u64,
    /// Device time of the dispatches, s; 0 where the device has no timestamps.
    pub device_seconds: f64,
    /// Host time from the first submission to the end, s.
    pub wall_seconds: f64,
}

/// Batches that wait in a scope; where there are as many they are executed.
const MOST_DEFERRED: usize = 64;

/// A sequence of operations, each of which sees everything that earlier ones wrote. It keeps the buffers that it uses
/// until it has ended. Dropping it discards it, except that a batch of hundreds of dispatches is executed in parts
/// as it grows.
pub struct Batch {
    pub(super) device: Device,
    recorder: Recorder,
    timing: BatchTiming,
    used: UsedScopes,
    kept: Vec<Arc<Block>>,
    /// Leaves out the barriers, to see that validation misses them.
    #[cfg(test)]
    unordered: bool,
}

impl Device {
    /// An empty batch. It reuses the Vulkan objects of earlier ones, and so costs little more than its submission.
    ///
    /// # Errors
    /// Fails if the driver cannot make the Vulkan objects of a new one.
    #[doc(hidden)]
    pub fn batch(&self) -> Result<Batch> {
        let idle = lock(&self.shared.idle).pop();
        let recorder = match idle {
            Some(recorder) => recorder,
            None => Recorder::new(&self.shared)?,
        };
        let timing = BatchTiming::default();
        Ok(Batch {
            device: self.clone(),
            recorder,
            timing,
            used: UsedScopes::default(),
            kept: Vec::new(),
            #[cfg(test)]
            unordered: false,
        })
    }

    /// Executes what [waits](Batch::defer) in this scope, and tells how long that took.
    ///
    /// # Errors
    /// Fails if the device does, or does not finish in time.
    #[doc(hidden)]
    pub fn execute_waiting(&self) -> Result<BatchTiming> {
        self.execute_deferred(&self.scope.alone())
    }

    /// Whether anything [waits](Batch::defer) in this scope.
    #[doc(hidden)]
    pub fn anything_waits(&self) -> bool {
        !self.scope.alone().deferred().is_empty()
    }

    /// Executes what waits in these scopes.
    pub(super) fn execute_deferred(&self, used: &UsedScopes) -> Result<BatchTiming> {
        let mut timing = BatchTiming::default();
        self.execute(used, None, &mut timing)?;
        Ok(timing)
    }

    /// Executes what waits in the scopes that are used, and then `last`, in one submission.
    fn execute(
        &self,
        used: &UsedScopes,
        last: Option<&mut Recorder>,
        timing: &mut BatchTiming,
    ) -> Result<()> {
        let mut deferred = used.deferred();
        let before = deferred.iter_mut().flat_map(|of| of.iter_mut()).map(|batch| &mut batch.recorder);
        let mut recorders: Vec<&mut Recorder> = before.chain(last).collect();
        if recorders.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let executed = Recorder::execute(&mut recorders, &self.shared, |kernel, shape, seconds| {
            timing.dispatches += 1;
            timing.device_seconds += seconds;
            lock(&self.shared.profile).add(kernel, shape, seconds);
        });
        timing.wall_seconds += start.elapsed().as_secs_f64();
        deferred.iter_mut().for_each(|of| of.clear());
        executed
    }
}

impl Batch {
    /// Runs `pipeline` over `groups` workgroups. `shape` labels the size of the work in the profile, e.g. "64x4096".
    pub fn dispatch(
        &mut self,
        pipeline: &Pipeline,
        shape: &str,
        buffers: &[BufferSlice],
        push: &[u8],
        groups: [u32; 3],
    ) -> Result<()> {
        let kernel = pipeline.kernel;
        self.check(pipeline, buffers, push, groups)?;
        self.make_room(pipeline.bindings.count())?;
        buffers.iter().for_each(|slice| self.will_use(slice.buffer));
        let shared = &self.device.shared;
        let parts = pipeline.parts()?;
        let recorder = &mut self.recorder;
        let set = recorder.descriptor_set(shared, parts.set_layout, pipeline.bindings.count(), kernel)?;
        let ranges: Vec<_> = buffers
            .iter()
            .map(|slice| {
                [vk::DescriptorBufferInfo::default()
                    .buffer(slice.buffer.raw())
                    .offset(slice.offset)
                    .range(slice.bytes)]
            })
            .collect();
        let writes: Vec<_> = (0u32..)
            .zip(&ranges)
            .map(|(binding, range)| {
                vk::WriteDescriptorSet::default()
                    .dst_set(set)
                    .dst_binding(binding)
                    .descriptor_type(pipeline.bindings.kind(binding))
                    .buffer_info(range)
            })
            .collect();
        // SAFETY: the set is new, so nothing uses it; the ranges were checked.
        unsafe { shared.raw().update_descriptor_sets(&writes, &[]) };
        recorder.timed(shared, kernel, shape, |device, commands| {
            let point = vk::PipelineBindPoint::COMPUTE;
            let stage = vk::ShaderStageFlags::COMPUTE;
            // SAFETY: recording; all objects belong to this device and live until the batch has ended (`kept`; the device
            // keeps pipelines).
            unsafe {
                device.cmd_bind_pipeline(commands, point, parts.pipeline);
                device.cmd_bind_descriptor_sets(commands, point, parts.layout, 0, &[set], &[]);
                if !push.is_empty() {
                    device.cmd_push_constants(commands, parts.layout, stage, 0, push);
                }
                device.cmd_dispatch(commands, groups[0], groups[1], groups[2]);
            }
        });
        Ok(())
    }

    /// Sets `bytes` from `offset` on to repetitions of `value`. Both are multiples of 4.
    ///
    /// # Errors
    /// Fails if the range is not aligned or goes beyond the buffer, or if the buffer is of another device.
    pub fn fill(&mut self, buffer: &Buffer, offset: u64, bytes: u64, value: u32) -> Result<()> {
        buffer.check(&self.device, offset, bytes)?;
        buffer.check_aligned(offset, bytes, 4)?;
        if bytes == 0 {
            return Ok(());
        }
        self.make_room(0)?;
        self.will_use(buffer);
        let device = self.device.shared.raw();
        // SAFETY: recording; the range was checked, the buffer lives until the batch has ended (`kept`).
        unsafe {
            device.cmd_fill_buffer(self.recorder.commands, buffer.raw(), offset, bytes, value);
        }
        Ok(())
    }

    /// Sets the values from `offset` on, which the batch carries with it: few, or an upload is better. Both are multiples of 4.
    ///
    /// # Errors
    /// Fails if the range is not aligned or goes beyond the buffer, or if the buffer is of another device.
    pub fn update(&mut self, buffer: &Buffer, offset: u64, values: &[u8]) -> Result<()> {
        let bytes = values.len() as u64;
        buffer.check(&self.device, offset, bytes)?;
        buffer.check_aligned(offset, bytes, 4)?;
        for (piece, at) in values.chunks(MOST_UPDATED).zip((offset..).step_by(MOST_UPDATED)) {
            self.make_room(0)?;
            self.will_use(buffer);
            let device = self.device.shared.raw();
            // SAFETY: recording; the range was checked, the buffer lives until the batch has ended (`kept`).
            unsafe { device.cmd_update_buffer(self.recorder.commands, buffer.raw(), at, piece) };
        }
        Ok(())
    }

    /// Copies `bytes` between buffers, or within one if the ranges do not overlap.
    ///
    /// # Errors
    /// Fails if a range goes beyond its buffer, if both overlap, or if a buffer is of another device.
    pub fn copy(
        &mut self,
        source: &Buffer,
        source_offset: u64,
        target: &Buffer,
        target_offset: u64,
        bytes: u64,
    ) -> Result<()> {
        source.check(&self.device, source_offset, bytes)?;
        target.check(&self.device, target_offset, bytes)?;
        if source.raw() == target.raw() && source_offset.abs_diff(target_offset) < bytes {
            return Err(GpuError::Overlap { label: source.label().to_owned() });
        }
        self.will_use(source);
        self.will_use(target);
        // SAFETY: checked above; both live until the batch has ended (`kept`).
        unsafe { self.copy_raw(source.raw(), source_offset, target.raw(), target_offset, bytes) }
    }

    /// Keeps the buffer until the batch has ended, and the host's work out of it while the batch runs.
    pub(super) fn will_use(&mut self, buffer: &Buffer) {
        self.used.add(buffer.use_of_buffers());
        self.kept.push(buffer.block().clone());
    }

    /// # Safety
    /// The batch [will use](Self::will_use) both. Both ranges exist, do not overlap, and live until the batch has ended.
    pub(super) unsafe fn copy_raw(
        &mut self,
        source: vk::Buffer,
        source_offset: u64,
        target: vk::Buffer,
        target_offset: u64,
        bytes: u64,
    ) -> Result<()> {
        if bytes == 0 {
            return Ok(());
        }
        self.make_room(0)?;
        let region = vk::BufferCopy { src_offset: source_offset, dst_offset: target_offset, size: bytes };
        let device = self.device.shared.raw();
        // SAFETY: recording; the rest is the caller's promise.
        unsafe { device.cmd_copy_buffer(self.recorder.commands, source, target, &[region]) };
        Ok(())
    }

    /// Executes what was recorded, after all that waits in the scopes of its buffers, and waits for its end.
    ///
    /// # Errors
    /// Fails if the device does, or does not finish in time.
    pub fn submit(mut self) -> Result<BatchTiming> {
        self.execute()?;
        Ok(self.timing)
    }

    /// Leaves what was recorded to be executed before anything else that uses the buffers of its scope: the next batch that is submitted,
    /// a transfer, or work of the host. All of it is one submission then, and its errors are those of whatever comes next. Where nothing
    /// comes it is not executed.
    ///
    /// # Errors
    /// Fails if the driver cannot end the recording, or if what waits must be executed at once and the device
    /// fails.
    pub fn defer(mut self) -> Result<()> {
        if !self.recorder.is_recording() {
            return Ok(());
        }
        let scope = self.device.scope.clone();
        if !self.used.only(&scope) {
            return self.execute();
        }
        self.end()?;
        let (recorder, kept) = (mem::take(&mut self.recorder), mem::take(&mut self.kept));
        let full = scope.defer(Deferred::new(&self.device.shared, recorder, kept)) >= MOST_DEFERRED;
        if full { self.device.execute_waiting().map(|_| ()) } else { Ok(()) }
    }

    fn check(
        &self,
        pipeline: &Pipeline,
        buffers: &[BufferSlice<'_>],
        push: &[u8],
        groups: [u32; 3],
    ) -> Result<()> {
        let kernel = pipeline.kernel;
        let info = self.device.info();
        pipeline.check(&self.device)?;
        let arguments = [
            ("buffers", buffers.len(), pipeline.bindings.count()),
            ("bytes of push constants", push.len(), pipeline.push_bytes),
        ];
        for (what, given, wanted) in arguments {
            let wanted = wanted as usize;
            if given != wanted {
                return Err(GpuError::WrongArguments { kernel, what, given, wanted });
            }
        }
        let limit = info.max_workgroup_count;
        if groups.iter().zip(&limit).any(|(groups, limit)| groups > limit) {
            return Err(GpuError::TooManyGroups { kernel, groups, limit });
        }
        for (binding, BufferSlice { buffer, offset, bytes }) in (0..).zip(buffers) {
            buffer.check(&self.device, *offset, *bytes)?;
            match pipeline.bindings.kind(binding) == vk::DescriptorType::UNIFORM_BUFFER {
                true => check_uniform(buffer, *offset, *bytes, info.max_uniform_buffer_range)?,
                false => buffer.check_aligned(*offset, 0, info.storage_buffer_alignment)?,
            }
            if *bytes == 0 {
                // Vulkan cannot bind an empty range.
                let (label, size) = (buffer.label().to_owned(), buffer.bytes());
                return Err(GpuError::OutOfRange { label, offset: *offset, bytes: 0, size });
            }
        }
        Ok(())
    }

    /// Before every operation: starts recording, executes what was recorded if the operation would no longer fit, and
    /// makes it wait for all earlier work, that of earlier batches too. One barrier serves everything: the kernels of a
    /// batch nearly always depend on each other, and each of them fills the device.
    fn make_room(&mut self, bindings: u32) -> Result<()> {
        if self.recorder.is_recording() && !self.recorder.fits(bindings) {
            self.execute()?;
        }
        let shared = &self.device.shared;
        if shared.is_hung() {
            return Err(GpuError::DeviceLost("starting a batch".into()));
        }
        if !self.recorder.is_recording() {
            self.recorder.begin(shared)?;
        }
        #[cfg(test)]
        if self.unordered {
            return Ok(());
        }
        let stages = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER;
        let writes = vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE;
        let shaders = vk::AccessFlags::SHADER_READ | vk::AccessFlags::UNIFORM_READ;
        let reads = shaders | vk::AccessFlags::TRANSFER_READ;
        self.barrier(stages, writes, stages, reads | writes);
        Ok(())
    }

    fn execute(&mut self) -> Result<()> {
        let recorded = self.recorder.is_recording();
        if recorded {
            self.end()?;
        }
        let last = recorded.then_some(&mut self.recorder);
        self.device.execute(&self.used, last, &mut self.timing)?;
        self.kept.clear();
        Ok(())
    }

    fn end(&mut self) -> Result<()> {
        // The host may read mapped buffers next.
        let stages = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER;
        let writes = vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE;
        self.barrier(stages, writes, vk::PipelineStageFlags::HOST, vk::AccessFlags::HOST_READ);
        self.recorder.end(&self.device.shared)
    }

    fn barrier(
        &self,
        from: vk::PipelineStageFlags,
        written: vk::AccessFlags,
        to: vk::PipelineStageFlags,
        used: vk::AccessFlags,
    ) {
        let barrier = [vk::MemoryBarrier::default().src_access_mask(written).dst_access_mask(used)];
        let none = vk::DependencyFlags::empty();
        // SAFETY: recording.
        unsafe {
            let device = self.device.shared.raw();
            device.cmd_pipeline_barrier(self.recorder.commands, from, to, none, &barrier, &[], &[]);
        }
    }
}

/// Checks that a byte range of a buffer can be a uniform buffer. The alignment is the largest that Vulkan
/// lets any device require, not that of this one: what passes here passes on every device.
fn check_uniform(buffer: &Buffer, offset: u64, bytes: u64, limit: u64) -> Result<()> {
    buffer.check_aligned(offset, 0, ALIGN)?;
    if bytes > limit {
        let (bytes, limit) = (Bytes(bytes), Bytes(limit));
        return Err(GpuError::BufferTooLarge { label: buffer.label().to_owned(), bytes, limit });
    }
    Ok(())
}

impl Drop for Batch {
    fn drop(&mut self) {
        mem::take(&mut self.recorder).set_aside(&self.device.shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shader::engine_kernel;
    use crate::{Bindings, BufferKind, DeviceOptions, UNIFORM_BYTES};

    fn device() -> Device {
        Device::new(&DeviceOptions::default().validation(true)).expect("a Vulkan device")
    }

    fn buffer(device: &Device, label: &str, bytes: u64) -> Buffer {
        Buffer::new(device, label, bytes, BufferKind::Storage).expect("a buffer")
    }

    /// Two kernels, the second of which reads and writes what the first has written; and a copy of that.
    fn storage(unordered: bool) -> Vec<String> {
        let device = device();
        let [x, y] = ["x", "y"].map(|label| buffer(&device, label, 4096));
        let shader = &engine_kernel("combine");
        let combine = Pipeline::new(&device, shader, 2, 12, &[]).expect("a pipeline");
        let fours = 4096_u32 / 16;
        let push = [3.0_f32.to_ne_bytes(), 1.0_f32.to_ne_bytes(), fours.to_ne_bytes()].concat();
        let mut batch = device.batch().expect("a batch");
        batch.unordered = unordered;
        for _ in 0..2 {
            batch.dispatch(&combine, "vector", &[x.whole(), y.whole()], &push, [16, 1, 1]).expect("recorded");
        }
        batch.copy(&y, 0, &x, 0, 4096).expect("recorded");
        batch.submit().expect("submitted");
        device.validation_messages()
    }

    /// A kernel that reads what was filled before as a uniform buffer.
    fn uniform(unordered: bool) -> Vec<String> {
        let device = device();
        let bound = ["facets", "runs", "irradiance", "partners", "radiance"];
        let buffers = bound.map(|label| buffer(&device, label, UNIFORM_BYTES.into()));
        let shader = &engine_kernel("transport_irradiance");
        let bindings = Bindings { storage: 3, uniform: 2 };
        let transport =
            Pipeline::new(&device, shader, bindings, 28, &[(0, 8), (1, 64), (13, 8)]).expect("a pipeline");
        let mut batch = device.batch().expect("a batch");
        batch.unordered = unordered;
        batch.fill(&buffers[4], 0, UNIFORM_BYTES.into(), 0).expect("recorded");
        let bound = buffers.each_ref().map(Buffer::whole);
        batch.dispatch(&transport, "none", &bound, &[0; 28], [1, 1, 1]).expect("recorded");
        batch.submit().expect("submitted");
        device.validation_messages()
    }

    /// Silence of the validation layer means something: it speaks where barriers are left out.
    #[test]
    fn validation_reports_a_missing_barrier() {
        let cases = [("storage", storage as fn(bool) -> Vec<String>, 2), ("uniform", uniform, 1)];
        for (name, messages, least) in cases {
            assert_eq!(messages(false), Vec::<String>::new(), "{name}");
            let said = messages(true);
            let hazards = said.iter().filter(|message| message.contains("HAZARD"));
            assert!(hazards.count() >= least, "{name}: {said:?}");
        }
    }
}
