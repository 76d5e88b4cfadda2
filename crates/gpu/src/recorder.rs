//! The Vulkan objects behind a batch, kept by the device from one batch to the next.

use ash::vk;
use std::sync::atomic::Ordering;

use super::Result;
use super::device::Shared;
use super::error::{During, GpuError};
use super::lock;
use super::pipeline::MAX_BINDINGS;

/// Dispatches that a recorder holds. A longer batch is submitted in parts.
const MAX_DISPATCHES: u32 = 256;
/// Storage buffers that they can bind in all.
const MAX_DESCRIPTORS: u32 = 8 * MAX_DISPATCHES;
const _: () = assert!(MAX_BINDINGS <= MAX_DESCRIPTORS);

/// Longest time of a submission. A liveness guard, not a performance budget: a plan's dispatches take a
/// fraction of a second, and a batch minutes at most, on a slow CPU too.
const TIMEOUT_SECONDS: u64 = 600;

/// Handles are null until made.
#[derive(Default)]
pub(super) struct Recorder {
    pool: vk::CommandPool,
    pub(super) commands: vk::CommandBuffer,
    descriptors: vk::DescriptorPool,
    /// Two timestamps per dispatch; null where the device has none.
    queries: vk::QueryPool,
    fence: vk::Fence,
    /// Kernel and shape of each dispatch recorded so far.
    dispatches: Vec<(&'static str, String)>,
    descriptors_used: u32,
    recording: bool,
}

impl Recorder {
    pub(super) fn new(shared: &Shared) -> Result<Self> {
        let mut recorder = Self::default();
        match recorder.create(shared) {
            Ok(()) => Ok(recorder),
            Err(error) => {
                recorder.destroy(shared);
                Err(error)
            }
        }
    }

    fn create(&mut self, shared: &Shared) -> Result<()> {
        let device = shared.raw();
        let create = vk::CommandPoolCreateInfo::default()
            .queue_family_index(shared.queue_family)
            .flags(vk::CommandPoolCreateFlags::TRANSIENT);
        // SAFETY: the device is alive and has this queue family, here and below.
        self.pool =
            unsafe { device.create_command_pool(&create, None) }.during("creating", "batch command pool")?;
        let allocate = vk::CommandBufferAllocateInfo::default()
            .command_pool(self.pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        // SAFETY: as above.
        let buffers = unsafe { device.allocate_command_buffers(&allocate) }
            .during("creating", "batch command buffer")?;
        self.commands = buffers.into_iter().next().unwrap_or_default();

        let sizes = [
            vk::DescriptorPoolSize::default()
                .ty(vk::DescriptorType::STORAGE_BUFFER)
                .descriptor_count(MAX_DESCRIPTORS),
            vk::DescriptorPoolSize::default()
                .ty(vk::DescriptorType::UNIFORM_BUFFER)
                .descriptor_count(MAX_DESCRIPTORS),
        ];
        let create = vk::DescriptorPoolCreateInfo::default().max_sets(MAX_DISPATCHES).pool_sizes(&sizes);
        // SAFETY: as above.
        self.descriptors = unsafe { device.create_descriptor_pool(&create, None) }
            .during("creating", "batch descriptor pool")?;

        if shared.timestamp_bits > 0 {
            let create = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(2 * MAX_DISPATCHES);
            // SAFETY: as above.
            self.queries =
                unsafe { device.create_query_pool(&create, None) }.during("creating", "batch timestamps")?;
            shared.name(self.queries, "batch timestamps");
        }
        // SAFETY: as above.
        self.fence = unsafe { device.create_fence(&vk::FenceCreateInfo::default(), None) }
            .during("creating", "batch fence")?;
        shared.name(self.pool, "batch command pool");
        shared.name(self.commands, "batch command buffer");
        shared.name(self.descriptors, "batch descriptor pool");
        shared.name(self.fence, "batch fence");
        Ok(())
    }

    pub(super) fn is_recording(&self) -> bool {
        self.recording
    }

    /// Whether a dispatch that binds this many buffers still fits.
    pub(super) fn fits(&self, bindings: u32) -> bool {
        self.dispatches.len() < MAX_DISPATCHES as usize && self.descriptors_used + bindings <= MAX_DESCRIPTORS
    }

    /// Discards what was recorded and starts over.
    pub(super) fn begin(&mut self, shared: &Shared) -> Result<()> {
        self.clear();
        let device = shared.raw();
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: nothing of this recorder executes: `execute` waits for the end, or the device counts as hung.
        unsafe {
            device
                .reset_command_pool(self.pool, vk::CommandPoolResetFlags::empty())
                .and_then(|()| {
                    let flags = vk::DescriptorPoolResetFlags::empty();
                    device.reset_descriptor_pool(self.descriptors, flags)
                })
                .and_then(|()| device.reset_fences(&[self.fence]))
                .and_then(|()| device.begin_command_buffer(self.commands, &begin))
        }
        .during("starting", "batch")?;
        self.recording = true;
        Ok(())
    }

    pub(super) fn clear(&mut self) {
        self.recording = false;
        self.dispatches.clear();
        self.descriptors_used = 0;
    }

    pub(super) fn descriptor_set(
        &mut self,
        shared: &Shared,
        layout: vk::DescriptorSetLayout,
        bindings: u32,
        kernel: &str,
    ) -> Result<vk::DescriptorSet> {
        let layouts = [layout];
        let allocate =
            vk::DescriptorSetAllocateInfo::default().descriptor_pool(self.descriptors).set_layouts(&layouts);
        // SAFETY: pool and layout belong to this device; `fits` was asked.
        let sets = unsafe { shared.raw().allocate_descriptor_sets(&allocate) }
            .during("binding the buffers of kernel", kernel)?;
        self.descriptors_used += bindings;
        Ok(sets.into_iter().next().unwrap_or_default())
    }

    /// Calls `record` between two timestamps.
    pub(super) fn timed(
        &mut self,
        shared: &Shared,
        kernel: &'static str,
        shape: &str,
        record: impl FnOnce(&ash::Device, vk::CommandBuffer),
    ) {
        let device = shared.raw();
        let first = 2 * self.dispatches.len() as u32;
        let timed = self.queries != vk::QueryPool::null();
        // Both at the bottom of the pipe: the first is the end of all earlier work, the second the end of this.
        let stage = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
        if timed {
            // SAFETY: recording, and `fits` bounds the number of dispatches by that of queries.
            unsafe {
                device.cmd_reset_query_pool(self.commands, self.queries, first, 2);
                device.cmd_write_timestamp(self.commands, stage, self.queries, first);
            }
        }
        record(&device, self.commands);
        if timed {
            // SAFETY: as above.
            unsafe { device.cmd_write_timestamp(self.commands, stage, self.queries, first + 1) };
        }
        self.dispatches.push((kernel, shape.to_owned()));
    }

    /// Ends the recording, so that it can be submitted.
    pub(super) fn end(&mut self, shared: &Shared) -> Result<()> {
        self.recording = false;
        // SAFETY: the commands are in the recording state.
        unsafe { shared.raw().end_command_buffer(self.commands) }.during("recording", "batch")
    }

    /// Submits what several have recorded, one after the other, and waits for its end. Calls `row` with kernel, shape and seconds of
    /// each dispatch.
    pub(super) fn execute(
        recorders: &mut [&mut Self],
        shared: &Shared,
        mut row: impl FnMut(&'static str, String, f64),
    ) -> Result<()> {
        let Some(fence) = recorders.last().map(|last| last.fence) else { return Ok(()) };
        let device = shared.raw();
        let commands: Vec<_> = recorders.iter().map(|recorder| recorder.commands).collect();
        let submit = [vk::SubmitInfo::default().command_buffers(&commands)];
        {
            let queue = lock(&shared.queue);
            // SAFETY: the lock makes this the only use of the queue; batches keep what the commands use alive.
            unsafe { device.queue_submit(*queue, &submit, fence) }.during("submitting", "batch")?;
        }
        shared.submissions.fetch_add(1, Ordering::Relaxed);
        let describe = || describe(recorders.iter().flat_map(|recorder| &recorder.dispatches));
        // SAFETY: the fence was submitted above.
        match unsafe { device.wait_for_fences(&[fence], true, TIMEOUT_SECONDS * 1_000_000_000) } {
            Ok(()) => {}
            Err(vk::Result::TIMEOUT) => {
                shared.hang();
                return Err(GpuError::Timeout { seconds: TIMEOUT_SECONDS });
            }
            Err(vk::Result::ERROR_DEVICE_LOST) => {
                return Err(GpuError::DeviceLost(describe()));
            }
            Err(result) => {
                // The work may still execute.
                shared.hang();
                return Err(GpuError::Vulkan { what: describe(), result: result.to_string() });
            }
        }
        for recorder in recorders {
            let seconds = recorder.seconds(shared)?;
            for ((kernel, shape), seconds) in recorder.dispatches.drain(..).zip(seconds) {
                row(kernel, shape, seconds);
            }
        }
        Ok(())
    }

    /// Device time of each dispatch, s.
    fn seconds(&self, shared: &Shared) -> Result<Vec<f64>> {
        let count = self.dispatches.len();
        if self.queries == vk::QueryPool::null() || count == 0 {
            return Ok(vec![0.0; count]);
        }
        let mut ticks = vec![0u64; 2 * count];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT;
        // SAFETY: all of these were written by the commands that have ended.
        unsafe { shared.raw().get_query_pool_results(self.queries, 0, &mut ticks, flags) }
            .during("reading", "batch timestamps")?;
        // Clocks of fewer bits wrap around.
        let mask = u64::MAX >> (64 - shared.timestamp_bits.clamp(1, 64));
        let second = f64::from(shared.info.timestamp_period_ns) * 1e-9;
        let span = |pair: &[u64]| (pair[1].wrapping_sub(pair[0]) & mask) as f64 * second;
        Ok(ticks.chunks_exact(2).map(span).collect())
    }

    /// Keeps it for another batch.
    pub(super) fn set_aside(mut self, shared: &Shared) {
        // On a hung device it may be in use for ever: it is neither kept nor destroyed. One that was taken away is null.
        if !shared.is_hung() && self.pool != vk::CommandPool::null() {
            self.clear();
            lock(&shared.idle).push(self);
        }
    }

    pub(super) fn destroy(self, shared: &Shared) {
        if shared.is_hung() {
            return;
        }
        let device = shared.raw();
        // SAFETY: nothing of this recorder executes, see `begin`. Null is ignored.
        unsafe {
            device.destroy_fence(self.fence, None);
            device.destroy_query_pool(self.queries, None);
            device.destroy_descriptor_pool(self.descriptors, None);
            device.destroy_command_pool(self.pool, None);
        }
    }
}

/// What is waited for, for an error.
fn describe<'a>(
    mut dispatches: impl DoubleEndedIterator<Item = &'a (&'static str, String)> + Clone,
) -> String {
    let count = dispatches.clone().count();
    match (dispatches.next(), dispatches.next_back()) {
        (None, _) => "waiting for a batch of copies".to_owned(),
        (Some((kernel, shape)), None) => format!("waiting for kernel \"{kernel}\" ({shape})"),
        (Some((first, _)), Some((last, _))) => {
            format!("waiting for {count} kernels, \"{first}\" to \"{last}\"")
        }
    }
}
