//! The backend, by which light is computed: Vulkan kernels on a device, or this program on the CPU. Chosen
//! once, when it is opened; engines and rasterizers are made on it.

mod cpu;

pub use cpu::{Array, Cpu, CpuOptions, Lease};

pub use antirad_scene::{BackendChoice, BackendKind};

use antirad_base::Watch;
use antirad_base::ranks::Ranks;
use antirad_base::usage::{MemoryReport, ProfileRow};
use antirad_gpu::{Device, DeviceKind, DeviceOptions, GpuError, list_devices};
use std::fmt;

/// An open backend. Clones are cheap and share it; threads may use it at the same time.
#[derive(Clone)]
pub enum Backend {
    /// A Vulkan device.
    Vulkan(Device),
    /// The CPU.
    Cpu(Cpu),
}

impl Backend {
    /// Opens a backend. `options` are those of a Vulkan device; the CPU takes its memory budget from them. Where the
    /// choice is left open, the environment variable ANTIRAD_BACKEND decides.
    ///
    /// # Errors
    /// Where Vulkan is wanted and no device can be opened, or a named device does not exist.
    pub fn open(choice: Option<BackendChoice>, options: &DeviceOptions) -> Result<Self, GpuError> {
        match Self::chosen(choice, options) {
            BackendKind::Vulkan => Device::new(options).map(Self::Vulkan),
            BackendKind::Cpu => Ok(Self::on_cpu(options)),
        }
    }

    /// The backend that [`Self::open`] takes.
    pub fn chosen(choice: Option<BackendChoice>, options: &DeviceOptions) -> BackendKind {
        let stated = choice.filter(|choice| *choice != BackendChoice::Auto);
        match stated.or_else(BackendChoice::of_environment).unwrap_or_default() {
            BackendChoice::Vulkan => BackendKind::Vulkan,
            BackendChoice::Cpu => BackendKind::Cpu,
            BackendChoice::Auto if options.selector.is_some() || has_gpu() => BackendKind::Vulkan,
            BackendChoice::Auto => BackendKind::Cpu,
        }
    }

    /// Returns the backend for one of its users: its memory is counted separately, and its transfers use
    /// staging buffers of its own, of `staging` bytes together.
    #[must_use]
    #[doc(hidden)]
    pub fn scope(&self, staging: u64) -> Self {
        match self {
            Self::Vulkan(device) => Self::Vulkan(device.scope(staging)),
            Self::Cpu(cpu) => Self::Cpu(cpu.scope()),
        }
    }

    /// The CPU with its default budget.
    pub fn cpu() -> Self {
        Self::Cpu(Cpu::new(&CpuOptions::default()))
    }

    fn on_cpu(options: &DeviceOptions) -> Self {
        Self::Cpu(Cpu::new(&CpuOptions::default().memory_budget(options.memory_budget)))
    }

    /// Which of the two it is.
    pub fn kind(&self) -> BackendKind {
        match self {
            Self::Vulkan(_) => BackendKind::Vulkan,
            Self::Cpu(_) => BackendKind::Cpu,
        }
    }

    /// Name of the device, or model of the CPU.
    pub fn device_name(&self) -> &str {
        match self {
            Self::Vulkan(device) => &device.info().name,
            Self::Cpu(cpu) => cpu.name(),
        }
    }

    /// Driver and its version; for the CPU, the vector instructions in use.
    #[doc(hidden)]
    pub fn driver(&self) -> &str {
        match self {
            Self::Vulkan(device) => &device.info().driver,
            Self::Cpu(cpu) => cpu.instructions(),
        }
    }

    /// Threads of this process that compute.
    pub fn threads(&self) -> usize {
        rayon::current_num_threads()
    }

    /// The Vulkan device, if it is one.
    pub fn vulkan(&self) -> Option<&Device> {
        match self {
            Self::Vulkan(device) => Some(device),
            Self::Cpu(_) => None,
        }
    }

    /// The Vulkan device, if its kernels are those of a GPU: it takes over what the host does otherwise on all cores.
    #[doc(hidden)]
    pub fn gpu(&self) -> Option<&Device> {
        self.vulkan().filter(|device| device.kernels_for() != DeviceKind::Cpu)
    }

    /// The processes that this one works with.
    #[doc(hidden)]
    pub fn ranks(&self) -> &Ranks {
        match self {
            Self::Vulkan(device) => device.ranks(),
            Self::Cpu(cpu) => cpu.ranks(),
        }
    }

    /// Returns the backend as that of one of several ranks. Its engines compute a share of every pass,
    /// together with those of the other ranks, which must be made and used in the same order.
    #[must_use]
    pub fn with_ranks(self, ranks: Ranks) -> Self {
        match self {
            Self::Vulkan(device) => Self::Vulkan(device.with_ranks(ranks)),
            Self::Cpu(cpu) => Self::Cpu(cpu.with_ranks(ranks)),
        }
    }

    /// Returns the backend with a watch that is asked before each kernel is compiled, which may take a Vulkan
    /// driver long.
    #[must_use]
    pub fn with_watch(self, watch: Watch) -> Self {
        match self {
            Self::Vulkan(device) => Self::Vulkan(device.with_watch(watch)),
            Self::Cpu(cpu) => Self::Cpu(cpu),
        }
    }

    /// Memory in use by label, under the budget.
    pub fn memory(&self) -> MemoryReport {
        match self {
            Self::Vulkan(device) => device.memory(),
            Self::Cpu(cpu) => cpu.memory(),
        }
    }

    /// Counts peaks of memory use from now on.
    #[doc(hidden)]
    pub fn reset_peak_memory(&self) {
        match self {
            Self::Vulkan(device) => device.reset_peak_memory(),
            Self::Cpu(cpu) => cpu.reset_peak_memory(),
        }
    }

    /// Time by kernel and shape since the last [`reset_profile`](Self::reset_profile), most expensive first.
    pub fn profile(&self) -> Vec<ProfileRow> {
        match self {
            Self::Vulkan(device) => device.profile(),
            Self::Cpu(cpu) => cpu.profile(),
        }
    }

    /// Forgets the profile.
    #[doc(hidden)]
    pub fn reset_profile(&self) {
        match self {
            Self::Vulkan(device) => device.reset_profile(),
            Self::Cpu(cpu) => cpu.reset_profile(),
        }
    }
}

impl fmt::Debug for Backend {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} on {}", self.kind(), self.device_name())
    }
}

impl From<Device> for Backend {
    fn from(device: Device) -> Self {
        Self::Vulkan(device)
    }
}

impl From<&Device> for Backend {
    fn from(device: &Device) -> Self {
        Self::Vulkan(device.clone())
    }
}

impl From<&Backend> for Backend {
    fn from(backend: &Backend) -> Self {
        backend.clone()
    }
}

/// Whether there is a GPU that Vulkan can use.
fn has_gpu() -> bool {
    let gpu = |kind: DeviceKind| !matches!(kind, DeviceKind::Cpu | DeviceKind::Other);
    list_devices().is_ok_and(|all| all.iter().any(|of| of.missing.is_empty() && gpu(of.info.kind)))
}
