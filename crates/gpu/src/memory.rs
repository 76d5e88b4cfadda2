//! The memory of a device: every byte is labelled and counted against the budget before it is allocated.

use std::mem::ManuallyDrop;

use ash::vk;
use gpu_allocator::vulkan::{
    Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc,
};
use gpu_allocator::{AllocationSizes, AllocatorDebugSettings, MemoryLocation};

use super::Result;
use super::error::GpuError;
use antirad_base::usage::{Bytes, LabelReport, Ledger, MemoryReport, ScopeId};

/// Size of the blocks that small buffers share. It is small, since what blocks reserve escapes the budget; larger
/// buffers get memory of their own.
const DEVICE_BLOCK: u64 = 8 << 20;
const HOST_BLOCK: u64 = 4 << 20;

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
        let ledger = Ledger::new(budget);
        Ok(Self { ledger, allocator: ManuallyDrop::new(allocator) })
    }

    /// Counts `bytes` under `label`, or fails if they exceed the budget. Precedes `allocate`.
    pub(super) fn take(&mut self, scope: ScopeId, label: &str, bytes: u64) -> Result<()> {
        Ok(self.ledger.take(scope, label, bytes)?)
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
        self.ledger.reset_peak();
    }

    pub(super) fn report(&self) -> MemoryReport {
        self.ledger.report(self.allocator.capacity())
    }

    /// Memory by label of the buffers of one scope.
    pub(super) fn report_of(&self, scope: ScopeId) -> Vec<LabelReport> {
        self.ledger.report_of(scope)
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
