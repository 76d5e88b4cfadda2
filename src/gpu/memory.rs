//! The memory of a device: every byte is labelled and counted against the budget before it is allocated.

use std::collections::BTreeMap;
use std::fmt;
use std::mem::ManuallyDrop;

use ash::vk;
use gpu_allocator::vulkan::{
    Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc,
};
use gpu_allocator::{AllocationSizes, AllocatorDebugSettings, MemoryLocation};

use super::Result;
use super::error::GpuError;

/// Buffer sizes are multiples of this many bytes: the largest alignment that Vulkan lets a device require of a storage
/// buffer's offset, so that the sizes a plan computes hold on every device.
pub const ALIGN: u64 = 256;

/// Size of the blocks that small buffers share. It is small, since what blocks reserve escapes the budget; larger
/// buffers get memory of their own.
const DEVICE_BLOCK: u64 = 8 << 20;
const HOST_BLOCK: u64 = 4 << 20;

/// The bytes that a buffer of `bytes` takes. An empty one takes [`ALIGN`]: Vulkan has no empty buffers.
pub const fn rounded(bytes: u64) -> u64 {
    let blocks = bytes.div_ceil(ALIGN);
    if blocks == 0 { ALIGN } else { blocks.saturating_mul(ALIGN) }
}

/// A number of bytes that prints itself both rounded and exactly: `8.0 MiB (8388608 bytes)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bytes(pub u64);

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(bytes) = *self;
        let (unit, name) = match bytes {
            0..=1023 => return write!(f, "{bytes} bytes"),
            1024..=0xF_FFFF => (1u64 << 10, "KiB"),
            0x10_0000..=0x3FFF_FFFF => (1 << 20, "MiB"),
            _ => (1 << 30, "GiB"),
        };
        write!(f, "{:.1} {name} ({bytes} bytes)", bytes as f64 / unit as f64)
    }
}

/// The memory in use under one label.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelReport {
    /// Label of the buffers.
    pub label: String,
    /// Their total size, each rounded up.
    pub bytes: u64,
    /// Number of buffers.
    pub count: u64,
}

/// Memory use of a device, bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemoryReport {
    /// Budget of all buffers together.
    pub budget: u64,
    /// Size of all buffers now.
    pub in_use: u64,
    /// The largest `in_use` so far.
    pub peak: u64,
    /// Memory taken from the driver: `in_use`, and what is free in the blocks that small buffers share.
    pub reserved: u64,
    /// Sorted by label.
    pub by_label: Vec<LabelReport>,
    /// Peak bytes of each label, labels freed since included.
    pub peak_by_label: Vec<(String, u64)>,
}

/// The bookkeeping alone, without a device.
#[derive(Default)]
struct Ledger {
    budget: u64,
    in_use: u64,
    peak: u64,
    /// Bytes and number of buffers.
    labels: BTreeMap<String, (u64, u64)>,
    peaks: BTreeMap<String, u64>,
    /// The same bytes and numbers, by the scope of the buffers.
    scopes: BTreeMap<ScopeId, BTreeMap<String, (u64, u64)>>,
}

/// Which handle a buffer was made with: [`Device::scope`](super::Device::scope).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ScopeId(pub(super) u64);

impl Ledger {
    fn take(&mut self, scope: ScopeId, label: &str, bytes: u64) -> Result<()> {
        // Written without a sum, which could overflow, and without trusting that in_use <= budget.
        if bytes > self.budget.saturating_sub(self.in_use) {
            return Err(GpuError::OverBudget {
                label: label.to_owned(),
                requested: Bytes(bytes),
                in_use: Bytes(self.in_use),
                budget: Bytes(self.budget),
            });
        }
        self.in_use += bytes;
        self.peak = self.peak.max(self.in_use);
        let own = self.scopes.entry(scope).or_default().entry(label.to_owned()).or_default();
        *own = (own.0 + bytes, own.1 + 1);
        let entry = self.labels.entry(label.to_owned()).or_default();
        *entry = (entry.0 + bytes, entry.1 + 1);
        let peak = self.peaks.entry(label.to_owned()).or_default();
        *peak = (*peak).max(entry.0);
        Ok(())
    }

    fn give_back(&mut self, scope: ScopeId, label: &str, bytes: u64) {
        self.in_use = self.in_use.saturating_sub(bytes);
        forget(&mut self.labels, label, bytes);
        if let Some(own) = self.scopes.get_mut(&scope) {
            forget(own, label, bytes);
            if own.is_empty() {
                self.scopes.remove(&scope);
            }
        }
    }
}

/// Removes one buffer of `bytes` from the counts.
fn forget(labels: &mut BTreeMap<String, (u64, u64)>, label: &str, bytes: u64) {
    if let Some(entry) = labels.get_mut(label) {
        *entry = (entry.0.saturating_sub(bytes), entry.1.saturating_sub(1));
        if entry.1 == 0 {
            labels.remove(label);
        }
    }
}

fn rows(labels: &BTreeMap<String, (u64, u64)>) -> Vec<LabelReport> {
    let row =
        |(label, &(bytes, count)): (&String, &(u64, u64))| LabelReport { label: label.clone(), bytes, count };
    labels.iter().map(row).collect()
}

pub(super) struct Memory {
    ledger: Ledger,
    /// Frees its blocks when dropped, so it must go before the device; `close` does.
    allocator: ManuallyDrop<Allocator>,
}

impl Memory {
    pub(super) fn new(
        instance: &ash::Instance,
        device: &ash::Device,
        physical_device: vk::PhysicalDevice,
        budget: u64,
    ) -> Result<Self> {
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.clone(),
            device: device.clone(),
            physical_device,
            debug_settings: AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: AllocationSizes::new(DEVICE_BLOCK, HOST_BLOCK),
        })
        .map_err(|source| GpuError::Allocation {
            label: "allocator".into(),
            bytes: Bytes(0),
            source: source.into(),
        })?;
        let ledger = Ledger { budget, ..Ledger::default() };
        Ok(Self { ledger, allocator: ManuallyDrop::new(allocator) })
    }

    /// Counts `bytes` under `label`, or fails if they exceed the budget. Precedes `allocate`.
    pub(super) fn take(&mut self, scope: ScopeId, label: &str, bytes: u64) -> Result<()> {
        self.ledger.take(scope, label, bytes)
    }

    pub(super) fn give_back(&mut self, scope: ScopeId, label: &str, bytes: u64) {
        self.ledger.give_back(scope, label, bytes);
    }

    pub(super) fn allocate(
        &mut self,
        label: &str,
        requirements: vk::MemoryRequirements,
        location: MemoryLocation,
    ) -> Result<Allocation> {
        let description = AllocationCreateDesc {
            name: label,
            requirements,
            location,
            linear: true,
            allocation_scheme: AllocationScheme::GpuAllocatorManaged,
        };
        self.allocator.allocate(&description).map_err(|source| GpuError::Allocation {
            label: label.to_owned(),
            bytes: Bytes(requirements.size),
            source: source.into(),
        })
    }

    pub(super) fn free(&mut self, allocation: Allocation) {
        if let Err(error) = self.allocator.free(allocation) {
            tracing::error!("device memory is leaked: {error}");
        }
    }

    /// Forgets the peaks of the past.
    pub(super) fn reset_peak(&mut self) {
        let ledger = &mut self.ledger;
        ledger.peak = ledger.in_use;
        ledger.peaks = ledger.labels.iter().map(|(label, &(bytes, _))| (label.clone(), bytes)).collect();
    }

    pub(super) fn report(&self) -> MemoryReport {
        let Ledger { budget, in_use, peak, labels, peaks, .. } = &self.ledger;
        MemoryReport {
            budget: *budget,
            in_use: *in_use,
            peak: *peak,
            reserved: self.allocator.capacity(),
            by_label: rows(labels),
            peak_by_label: peaks.iter().map(|(label, &bytes)| (label.clone(), bytes)).collect(),
        }
    }

    /// Memory by label of the buffers of one scope.
    pub(super) fn report_of(&self, scope: ScopeId) -> Vec<LabelReport> {
        self.ledger.scopes.get(&scope).map(rows).unwrap_or_default()
    }

    /// Returns all blocks to the driver.
    ///
    /// # Safety
    /// The device is alive and idle, no buffer is left, and nothing but dropping follows.
    pub(super) unsafe fn close(&mut self) {
        // SAFETY: the caller does not use `self` again.
        unsafe { ManuallyDrop::drop(&mut self.allocator) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_rounded_up() {
        let cases = [(0, 256), (1, 256), (256, 256), (257, 512), (u64::MAX, u64::MAX)];
        for (bytes, expected) in cases {
            assert_eq!(rounded(bytes), expected);
        }
    }

    #[test]
    fn bytes_print_for_people_and_exactly() {
        assert_eq!(Bytes(1000).to_string(), "1000 bytes");
        assert_eq!(Bytes(1536).to_string(), "1.5 KiB (1536 bytes)");
        assert_eq!(Bytes(8 << 20).to_string(), "8.0 MiB (8388608 bytes)");
    }

    #[test]
    fn ledger_counts_and_refuses() {
        let scope = ScopeId(3);
        let mut ledger = Ledger { budget: 1000, ..Ledger::default() };
        assert!(ledger.take(scope, "a", 600).is_ok());
        assert!(ledger.take(scope, "b", 401).is_err());
        assert!(ledger.take(scope, "b", u64::MAX).is_err());
        assert!(ledger.take(scope, "b", 400).is_ok());
        ledger.give_back(scope, "a", 600);
        assert_eq!((ledger.in_use, ledger.peak), (400, 1000));
        assert_eq!(ledger.labels.keys().collect::<Vec<_>>(), ["b"]);
        assert_eq!(ledger.peaks.keys().collect::<Vec<_>>(), ["a", "b"]);
        // A budget below what is in use must refuse, not wrap.
        ledger.budget = 100;
        assert!(ledger.take(scope, "c", 1).is_err());
    }

    #[test]
    fn scopes_are_counted_apart() {
        let (one, other) = (ScopeId(1), ScopeId(2));
        let mut ledger = Ledger { budget: 1000, ..Ledger::default() };
        for (scope, label, bytes) in [(one, "a", 100), (other, "a", 200), (one, "a", 10), (one, "b", 1)] {
            ledger.take(scope, label, bytes).unwrap();
        }
        assert_eq!(ledger.scopes[&one], BTreeMap::from([("a".into(), (110, 2)), ("b".into(), (1, 1))]));
        assert_eq!(ledger.scopes[&other], BTreeMap::from([("a".into(), (200, 1))]));
        assert_eq!((ledger.labels["a"], ledger.in_use), ((310, 3), 311));
        ledger.give_back(other, "a", 200);
        assert_eq!(ledger.scopes.keys().collect::<Vec<_>>(), [&one]);
        assert_eq!((ledger.labels["a"], ledger.in_use), ((110, 2), 111));
    }
}
