//! A device opened for compute, and the state that its users share.

use antirad_base::setters;
use std::collections::HashMap;
use std::env;
use std::ffi::CString;
use std::fmt;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use ash::ext::debug_utils;
use ash::{khr, vk};

use super::calls::{Call, Calls, Change};
use super::error::{During, GpuError};
use super::info::{DeviceInfo, DeviceKind, Enabled};
use super::instance::Instance;
use super::kernel_cache::{self, KernelCache};
use super::memory::Memory;
use super::pipeline::{Key, Parts};
use super::recorder::Recorder;
use super::statistics::{KernelStatistics, Statistics};
use super::survey::{self, Candidate};
use super::transfer::{STAGING_CHUNK, Scope};
use super::validation::ValidationLog;
use super::{Result, lock};
use antirad_base::Watch;
use antirad_base::ranks::Ranks;
use antirad_base::usage::{LabelReport, MemoryReport, Profile, ProfileRow};

/// `Default` reads the environment; `DeviceOptions::default().validation(true)` overrides it.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct DeviceOptions {
    /// Index in [`list_devices`](super::list_devices) or part of the name, ignoring case; `None`: the best device.
    /// Default: ANTIRAD_DEVICE.
    pub selector: Option<String>,
    /// Check every call with the Vulkan validation layer. Default: whether ANTIRAD_VALIDATION is 1.
    pub validation: bool,
    /// Budget of all buffers, bytes; `None`: 85 % of what VK_EXT_memory_budget leaves to this process, or the whole heap
    /// of a device that does not tell.
    pub memory_budget: Option<u64>,
    /// Folder in which compiled kernels are kept for the next process; `None`: they are not. Default:
    /// ANTIRAD_KERNEL_CACHE (empty for none), or `antirad` in the user's folder for caches.
    pub kernel_cache: Option<PathBuf>,
    /// Ask the driver about each kernel that it compiles, for [`Device::kernel_statistics`]; drivers may compile more slowly then.
    /// Default: no.
    #[doc(hidden)]
    pub statistics: bool,
    /// The kind of device that kernels are chosen for; `None`: its own. Default: that which ANTIRAD_KERNELS names, `cpu` or `gpu`, so that
    /// kernels of GPUs can be tried where there is none.
    #[doc(hidden)]
    pub kernels: Option<DeviceKind>,
}

setters!(DeviceOptions {
    selector: Option<String>,
    validation: bool,
    memory_budget: Option<u64>,
    kernel_cache: Option<PathBuf>,
    #[doc(hidden)]
    statistics: bool,
    #[doc(hidden)]
    kernels: Option<DeviceKind>,
});

impl Default for DeviceOptions {
    fn default() -> Self {
        Self {
            selector: env::var("ANTIRAD_DEVICE").ok().filter(|text| !text.trim().is_empty()),
            validation: env::var("ANTIRAD_VALIDATION").is_ok_and(|text| text == "1"),
            memory_budget: None,
            kernel_cache: kernel_cache::usual_folder(),
            statistics: false,
            kernels: match env::var("ANTIRAD_KERNELS").as_deref() {
                Ok("gpu") => Some(DeviceKind::Discrete),
                Ok("cpu") => Some(DeviceKind::Cpu),
                _ => None,
            },
        }
    }
}

impl DeviceOptions {
    /// The options of a command line, over the defaults.
    pub fn asked(selector: &Option<String>, memory_budget: Option<u64>) -> Self {
        let usual = Self::default();
        Self { selector: selector.clone().or(usual.selector), memory_budget, ..usual }
    }
}

/// Percentage of the free memory that is the budget unless one is given. Other programs, and the driver
/// itself, need some of what is free now. Scratch memory of kernels would come from the rest, too, but they
/// take none where drivers tell (`tests/cli/kernels_navi21.csv`).
const SHARE_OF_FREE: u64 = 85;

/// The budget unless one is given: a share of what is free, or the whole heap of a device that does not tell.
fn usual_budget(info: &DeviceInfo) -> u64 {
    info.available_bytes.map_or(info.heap_bytes, |free| free / 100 * SHARE_OF_FREE)
}

/// A device opened for compute. Clones are cheap and share it; threads may use it at the same time.
#[derive(Clone)]
pub struct Device {
    pub(super) shared: Arc<Shared>,
    pub(super) scope: Arc<Scope>,
    ranks: Ranks,
    watch: Option<Watch>,
    /// The kind of device that kernels are chosen for.
    kernels_for: DeviceKind,
}

pub(super) struct Shared {
    pub(super) info: DeviceInfo,
    pub(super) queue_family: u32,
    /// Vulkan allows one thread at a time to submit.
    pub(super) queue: Mutex<vk::Queue>,
    pub(super) timestamp_bits: u32,
    pub(super) memory: Mutex<Memory>,
    pub(super) cache: vk::PipelineCache,
    /// The pipeline cache on disk, if it is kept.
    kept: Option<KernelCache>,
    /// Every kernel compiled so far, kept until the device is closed. Different ones are compiled at the same time.
    pub(super) pipelines: Mutex<HashMap<Key, Arc<Mutex<Parts>>>>,
    /// Recorders not in use. A batch takes one, or makes one if there is none.
    pub(super) idle: Mutex<Vec<Recorder>>,
    /// Number of scopes made so far.
    pub(super) scopes: AtomicU64,
    /// Number of submissions so far.
    pub(super) submissions: AtomicU64,
    pub(super) profile: Mutex<Profile>,
    /// The device stopped responding. It may still use its objects, so none may be destroyed.
    hung: AtomicBool,
    names: Option<debug_utils::Device>,
    /// What the driver told of kernels, if it does.
    pub(super) statistics: Option<Statistics>,
    // Dropped in this order: the device before its instance.
    logical: Logical,
    instance: Instance,
}

/// The Vulkan device itself.
pub(super) struct Logical {
    pub(super) raw: ash::Device,
    /// Whether the validation layer checks it.
    pub(super) validates: bool,
    /// Whether to destroy it: false for an embedder's device and for one that hangs.
    pub(super) owned: bool,
}

impl Drop for Logical {
    fn drop(&mut self) {
        if self.owned {
            let _change = self.validates.then(Change::begin);
            // SAFETY: whoever holds this has destroyed what was made from the device.
            unsafe { self.raw.destroy_device(None) };
        }
    }
}

impl Device {
    /// Opens the selected device with every optional capability of [`Enabled`] that it has.
    ///
    /// # Errors
    /// Fails if there is no Vulkan driver or no such device, if the device lacks a required feature, or if it
    /// cannot be opened.
    pub fn new(options: &DeviceOptions) -> Result<Self> {
        let instance = Instance::new(options.validation)?;
        let candidate = survey::choose(survey::survey(&instance)?, options.selector.as_deref())?;
        let enabled = candidate.listed.info.enabled;
        let enabled = enabled.statistics(enabled.statistics && options.statistics);
        let raw = open(&instance, &candidate, enabled)?;
        let logical = Logical { raw, validates: options.validation, owned: true };
        let calling = options.validation.then(Call::begin);
        // SAFETY: `open` made the device with one queue of this family.
        let queue = unsafe { logical.raw.get_device_queue(candidate.queue_family, 0) };
        // SAFETY: a device of this living instance.
        let of = unsafe { instance.raw().get_physical_device_properties(candidate.physical) };
        drop(calling);
        let kept = options.kernel_cache.as_ref().map(|folder| KernelCache::open(folder, &of));
        let budget = options.memory_budget;
        let device = Self::assemble(instance, logical, candidate, queue, enabled, budget, kept)?;
        tracing::debug!("opened {} ({})", device.info().name, device.info().driver);
        let kind = options.kernels.unwrap_or(device.info().kind);
        Ok(device.with_kernels_for(kind))
    }

    pub(super) fn assemble(
        instance: Instance,
        logical: Logical,
        candidate: Candidate,
        queue: vk::Queue,
        enabled: Enabled,
        budget: Option<u64>,
        kept: Option<KernelCache>,
    ) -> Result<Self> {
        let Candidate { physical, listed, queue_family, timestamp_bits, .. } = candidate;
        let mut info = listed.info;
        info.enabled = enabled;
        let _calling = logical.validates.then(Call::begin);
        let budget = budget.unwrap_or_else(|| usual_budget(&info));
        let memory = Memory::new(&instance.raw(), &logical.raw, physical, budget)?;
        let names = enabled.debug_utils.then(|| debug_utils::Device::new(&instance.raw(), &logical.raw));
        let statistics = enabled.statistics.then(|| Statistics::new(&instance.raw(), &logical.raw));
        let data = kept.as_ref().map_or(&[][..], KernelCache::data);
        let create = vk::PipelineCacheCreateInfo::default().initial_data(data);
        // SAFETY: the device is alive. This is the last call that can fail, so nothing made here is left behind.
        let cache = unsafe { logical.raw.create_pipeline_cache(&create, None) }
            .during("creating", "pipeline cache")?;
        let kernels_for = info.kind;
        let shared = Shared {
            info,
            queue_family,
            queue: Mutex::new(queue),
            timestamp_bits,
            memory: Mutex::new(memory),
            cache,
            kept,
            pipelines: Mutex::default(),
            idle: Mutex::default(),
            scopes: AtomicU64::new(0),
            submissions: AtomicU64::new(0),
            profile: Mutex::default(),
            hung: AtomicBool::new(false),
            names,
            statistics,
            logical,
            instance,
        };
        shared.name(cache, "pipeline cache");
        let shared = Arc::new(shared);
        Ok(Self {
            scope: Scope::new(&shared, 2 * STAGING_CHUNK),
            shared,
            ranks: Ranks::default(),
            watch: None,
            kernels_for,
        })
    }

    /// A handle on the same device for one of its users, such as an engine. Its allocations are counted separately
    /// ([`Self::scope_memory`]), under the common budget. Its transfers use staging buffers of their own, `staging`
    /// bytes together (less where the device has no buffers as large), from the first transfer until the last clone of the handle
    /// is dropped.
    #[doc(hidden)]
    pub fn scope(&self, staging: u64) -> Self {
        Self {
            scope: Scope::new(&self.shared, staging),
            shared: self.shared.clone(),
            ranks: self.ranks.clone(),
            watch: self.watch.clone(),
            kernels_for: self.kernels_for,
        }
    }

    /// Returns the device with the kernels that one of another kind would run: those for GPUs on a CPU,
    /// slowly.
    #[must_use]
    #[doc(hidden)]
    pub fn with_kernels_for(self, kind: DeviceKind) -> Self {
        Self { kernels_for: kind, ..self }
    }

    /// The kind of device that kernels are chosen for.
    #[doc(hidden)]
    pub fn kernels_for(&self) -> DeviceKind {
        self.kernels_for
    }

    /// Returns the device as that of one of several ranks. Its engines compute a share of every pass,
    /// together with those of the other ranks, which must be made and used in the same order.
    #[must_use]
    #[doc(hidden)]
    pub fn with_ranks(self, ranks: Ranks) -> Self {
        Self { ranks, ..self }
    }

    /// Returns the device with a watch that is asked before each kernel is compiled, which may take a driver
    /// long. Where the watch breaks, the call ends with [`GpuError::Interrupted`].
    #[must_use]
    #[doc(hidden)]
    pub fn with_watch(self, watch: Watch) -> Self {
        Self { watch: Some(watch), ..self }
    }

    /// Asks the watch.
    pub(super) fn check_watch(&self) -> Result<()> {
        match self.watch.as_ref().map(|watch| watch()) {
            Some(ControlFlow::Break(())) => Err(GpuError::Interrupted),
            _ => Ok(()),
        }
    }

    /// The processes that this one works with.
    #[doc(hidden)]
    pub fn ranks(&self) -> &Ranks {
        &self.ranks
    }

    /// Properties of the device, and the optional capabilities that are enabled.
    pub fn info(&self) -> &DeviceInfo {
        &self.shared.info
    }

    /// Memory use of all buffers, host-visible ones included.
    #[doc(hidden)]
    pub fn memory(&self) -> MemoryReport {
        lock(&self.shared.memory).report()
    }

    /// Counts peaks of memory use from now on.
    #[doc(hidden)]
    pub fn reset_peak_memory(&self) {
        lock(&self.shared.memory).reset_peak();
    }

    /// Memory by label of the buffers made with this handle or its clones, staging buffers included.
    #[doc(hidden)]
    pub fn scope_memory(&self) -> Vec<LabelReport> {
        lock(&self.shared.memory).report_of(self.scope.id())
    }

    /// Device time by kernel and shape since the last [`reset_profile`](Self::reset_profile), most expensive first; without what
    /// [waits](super::Batch::defer).
    #[doc(hidden)]
    pub fn profile(&self) -> Vec<ProfileRow> {
        lock(&self.shared.profile).rows()
    }

    /// Credits a kernel under a shape with items of work and bytes of buffer accesses, for the rates of its profile.
    #[doc(hidden)]
    pub fn credit(&self, kernel: &'static str, shape: &str, items: u64, bytes: u64) {
        lock(&self.shared.profile).credit(kernel, shape, items, bytes);
    }

    /// How often work was submitted so far, copies included; the host waits for the end of each submission.
    #[doc(hidden)]
    pub fn submissions(&self) -> u64 {
        self.shared.submissions.load(Ordering::Relaxed)
    }

    /// What the driver told of the kernels compiled so far, in the order of their names; nothing without
    /// [`DeviceOptions::statistics`], or from a driver without VK_KHR_pipeline_executable_properties.
    #[doc(hidden)]
    pub fn kernel_statistics(&self) -> Vec<KernelStatistics> {
        self.shared.statistics.as_ref().map_or_else(Vec::new, Statistics::rows)
    }

    /// Clears all times and credits.
    #[doc(hidden)]
    pub fn reset_profile(&self) {
        lock(&self.shared.profile).clear();
    }

    /// Messages of the validation layer so far; empty without validation.
    #[doc(hidden)]
    pub fn validation_messages(&self) -> Vec<String> {
        self.validation_log().messages()
    }

    /// The log of these messages; a clone of it outlives the device.
    #[doc(hidden)]
    pub fn validation_log(&self) -> ValidationLog {
        self.shared.instance.log().clone()
    }

    /// Checks that the validation layer has reported nothing.
    ///
    /// # Errors
    /// Fails with [`GpuError::Validation`] and the messages, if there are any.
    #[doc(hidden)]
    pub fn check_validation(&self) -> Result<()> {
        let messages = self.validation_messages();
        if messages.is_empty() { Ok(()) } else { Err(GpuError::Validation(messages)) }
    }

    /// The Vulkan device, for embedders that record commands of their own.
    pub fn raw(&self) -> &ash::Device {
        &self.shared.logical.raw
    }
}

impl fmt::Debug for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Device").field(&self.info().name).finish()
    }
}

impl Shared {
    pub(super) fn raw(&self) -> Calls<'_, ash::Device> {
        Calls::of(&self.logical.raw, self.logical.validates)
    }

    /// Gives an object the label that errors and profiles use. For debuggers only, so failures are ignored.
    pub(super) fn name<H: vk::Handle>(&self, handle: H, label: &str) {
        if let (Some(names), Ok(label)) = (&self.names, CString::new(label)) {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(handle).object_name(&label);
            let _calling = self.logical.validates.then(Call::begin);
            // SAFETY: the extension is enabled, the handle belongs to this device and was just made.
            let _ = unsafe { names.set_debug_utils_object_name(&info) };
        }
    }

    /// Marks the device as hung: from now on nothing is submitted to it or destroyed.
    pub(super) fn hang(&self) {
        self.hung.store(true, Ordering::SeqCst);
    }

    pub(super) fn is_hung(&self) -> bool {
        self.hung.load(Ordering::SeqCst)
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        if self.is_hung() {
            self.logical.owned = false;
            self.instance.abandon();
            return;
        }
        if let Some(kept) = &self.kept
            && !lock(&self.pipelines).is_empty()
        {
            // SAFETY: the device is alive. A lost one returns an error.
            match unsafe { self.raw().get_pipeline_cache_data(self.cache) } {
                Ok(data) => kept.keep(&data),
                Err(error) => tracing::debug!("kernels are not kept: {error}"),
            }
        }
        for recorder in std::mem::take(&mut *lock(&self.idle)) {
            recorder.destroy(self);
        }
        for parts in std::mem::take(&mut *lock(&self.pipelines)).into_values() {
            lock(&parts).destroy(self);
        }
        // SAFETY: this is the last reference: no buffer, pipeline or batch is left, and each batch waited for its end.
        unsafe {
            self.raw().destroy_pipeline_cache(self.cache, None);
            let _calling = self.raw();
            lock(&self.memory).close();
        }
    }
}

fn open(instance: &Instance, candidate: &Candidate, enabled: Enabled) -> Result<ash::Device> {
    let has = |name| survey::has_extension(&candidate.extensions, name);
    let mut names = Vec::new();
    // The specification requires enabling it on every device that lists it.
    if has(khr::portability_subset::NAME) {
        names.push(khr::portability_subset::NAME.as_ptr());
    }
    let features = vk::PhysicalDeviceFeatures::default().shader_float64(enabled.float64);
    let mut told =
        vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
    if enabled.statistics {
        names.push(khr::pipeline_executable_properties::NAME.as_ptr());
    }
    let queues = [vk::DeviceQueueCreateInfo::default()
        .queue_family_index(candidate.queue_family)
        .queue_priorities(&[1.0])];
    let mut layout = vk::PhysicalDeviceScalarBlockLayoutFeatures::default().scalar_block_layout(true);
    let mut create = vk::DeviceCreateInfo::default()
        .push_next(&mut layout)
        .queue_create_infos(&queues)
        .enabled_extension_names(&names)
        .enabled_features(&features);
    if enabled.statistics {
        create = create.push_next(&mut told);
    }
    // SAFETY: all pointers in `create` outlive the call; the device lists the extensions and features.
    unsafe { instance.create_device(candidate.physical, &create) }
        .during("opening", &candidate.listed.info.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_budget_leaves_some_of_what_is_free() {
        const GIB: u64 = 1 << 30;
        let of = |heap_bytes, available_bytes| {
            usual_budget(&DeviceInfo { heap_bytes, available_bytes, ..DeviceInfo::default() })
        };
        let (free, heap) = (5 * GIB, 8 * GIB);
        let budget = of(heap, Some(free));
        assert!((budget as f64 / free as f64 - 0.85).abs() < 1e-6, "{budget} of {free}");
        // Other programs have all of it.
        assert_eq!(of(heap, Some(0)), 0);
        // A driver that counts without bound.
        assert!(of(heap, Some(u64::MAX)) < u64::MAX);
        assert_eq!(of(heap, None), heap);
    }
}
