//! The CPU as a device: memory under a budget, and a profile.

use antirad_base::ranks::Ranks;
use antirad_base::setters;
use antirad_base::usage::{
    LabelReport, Ledger, MemoryReport, OverBudget, Profile, ProfileRow, ScopeId, rounded,
};
use bytemuck::Zeroable;
use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Percentage of the memory of the system that is the budget unless one is given.
const SHARE_OF_MEMORY: u64 = 75;
/// Memory assumed where the system does not tell how much it has, bytes.
const UNKNOWN_MEMORY: u64 = 4 << 30;

/// How the CPU is used.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct CpuOptions {
    /// Budget of all arrays, bytes; `None`: three quarters of the memory that this process may have.
    pub memory_budget: Option<u64>,
}

setters!(CpuOptions { memory_budget: Option<u64> });

/// The CPU. Clones are cheap and share it; threads may use it at the same time.
#[derive(Clone)]
pub struct Cpu {
    shared: Arc<Shared>,
    scope: ScopeId,
    ranks: Ranks,
}

struct Shared {
    name: String,
    ledger: Mutex<Ledger>,
    profile: Mutex<Profile>,
    scopes: AtomicU64,
}

/// Counters and lists are intact even where a thread panicked that held the lock.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Cpu {
    /// The CPU of this machine.
    pub fn new(options: &CpuOptions) -> Self {
        let budget = options.memory_budget.unwrap_or_else(|| system_memory() / 100 * SHARE_OF_MEMORY);
        let ledger = Ledger::new(budget);
        let shared = Shared {
            name: model(),
            ledger: Mutex::new(ledger),
            profile: Mutex::default(),
            scopes: AtomicU64::new(0),
        };
        Self { shared: Arc::new(shared), scope: ScopeId(0), ranks: Ranks::default() }
    }

    /// Returns the CPU for one of its users, such as an engine: its arrays are counted separately
    /// ([`Self::scope_memory`]), under the common budget.
    #[doc(hidden)]
    pub fn scope(&self) -> Self {
        let scope = ScopeId(1 + self.shared.scopes.fetch_add(1, Ordering::Relaxed));
        Self { scope, ..self.clone() }
    }

    /// Returns the CPU as that of one of several ranks.
    #[must_use]
    #[doc(hidden)]
    pub fn with_ranks(self, ranks: Ranks) -> Self {
        Self { ranks, ..self }
    }

    /// The processes that this one works with.
    #[doc(hidden)]
    pub fn ranks(&self) -> &Ranks {
        &self.ranks
    }

    /// Model of the CPU, as the system tells.
    #[doc(hidden)]
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    /// The vector instructions that the operators use.
    #[doc(hidden)]
    pub fn instructions(&self) -> &'static str {
        antirad_gpu::vector_instructions()
    }

    /// Memory in use by label, under the budget.
    #[doc(hidden)]
    pub fn memory(&self) -> MemoryReport {
        let ledger = lock(&self.shared.ledger);
        ledger.report(ledger.in_use)
    }

    /// Memory by label of the arrays made with this handle or its clones.
    #[doc(hidden)]
    pub fn scope_memory(&self) -> Vec<LabelReport> {
        lock(&self.shared.ledger).report_of(self.scope)
    }

    /// Counts peaks of memory use from now on.
    #[doc(hidden)]
    pub fn reset_peak_memory(&self) {
        lock(&self.shared.ledger).reset_peak();
    }

    /// Time by operator and shape, most expensive first.
    #[doc(hidden)]
    pub fn profile(&self) -> Vec<ProfileRow> {
        lock(&self.shared.profile).rows()
    }

    /// Forgets the profile.
    #[doc(hidden)]
    pub fn reset_profile(&self) {
        lock(&self.shared.profile).clear();
    }

    /// Adds work to the profile.
    pub(crate) fn record(&self, kernel: &'static str, shape: &str, seconds: f64, items: u64) {
        let mut profile = lock(&self.shared.profile);
        profile.add(kernel, shape.to_owned(), seconds);
        profile.credit(kernel, shape, items, 0);
    }

    /// Counts `bytes` under `label` until the lease is dropped.
    ///
    /// # Errors
    /// Where the budget does not hold them.
    #[doc(hidden)]
    pub fn lease(&self, label: &str, bytes: u64) -> Result<Lease, OverBudget> {
        let bytes = rounded(bytes);
        lock(&self.shared.ledger).take(self.scope, label, bytes)?;
        Ok(Lease { shared: self.shared.clone(), scope: self.scope, label: label.to_owned(), bytes })
    }

    /// An array of zeros, counted under `label`.
    ///
    /// # Errors
    /// Where the budget does not hold it.
    #[doc(hidden)]
    pub fn array<T: Zeroable + Clone>(&self, label: &str, count: usize) -> Result<Array<T>, OverBudget> {
        let lease = self.lease(label, (count * size_of::<T>()) as u64)?;
        Ok(Array { values: vec![T::zeroed(); count], _lease: lease })
    }

    /// An array of these values.
    ///
    /// # Errors
    /// Where the budget does not hold it.
    #[doc(hidden)]
    pub fn filled<T>(&self, label: &str, values: Vec<T>) -> Result<Array<T>, OverBudget> {
        let lease = self.lease(label, size_of_val(&values[..]) as u64)?;
        Ok(Array { values, _lease: lease })
    }
}

/// Memory that is counted until this is dropped.
pub struct Lease {
    shared: Arc<Shared>,
    scope: ScopeId,
    label: String,
    bytes: u64,
}

impl Drop for Lease {
    fn drop(&mut self) {
        lock(&self.shared.ledger).give_back(self.scope, &self.label, self.bytes);
    }
}

/// Values in memory that is counted.
pub struct Array<T> {
    values: Vec<T>,
    _lease: Lease,
}

impl<T> Deref for Array<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.values
    }
}

impl<T> DerefMut for Array<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values
    }
}

/// Bytes of memory that this process may have: that of the system, or less where its control group has a limit.
fn system_memory() -> u64 {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let total = read("/proc/meminfo").and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
        Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10)
    });
    let limits = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    let limits = limits.into_iter().filter_map(|path| read(path)?.trim().parse::<u64>().ok());
    limits.chain(total).min().unwrap_or(UNKNOWN_MEMORY)
}

/// Model of the CPU.
fn model() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name =
        text.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split(": ").nth(1));
    name.map_or_else(|| format!("{} CPU", std::env::consts::ARCH), |name| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_counted_while_they_live() {
        let cpu = Cpu::new(&CpuOptions::default().memory_budget(Some(2048))).scope();
        let array = cpu.array::<f32>("values", 100).expect("room");
        assert_eq!(array.len(), 100);
        let report = cpu.scope_memory();
        assert_eq!((report.len(), report[0].bytes, report[0].count), (1, 512, 1));
        let error = cpu.array::<f64>("others", 1000).err().expect("no room");
        assert!(error.to_string().contains("others"), "{error}");
        drop(array);
        assert_eq!((cpu.memory().in_use, cpu.memory().peak), (0, 512));
        assert!(cpu.scope_memory().is_empty());
    }
}
