//! Buffers: labelled, counted, freed when dropped.

use std::sync::Arc;
use std::{fmt, mem};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::Allocation;

use super::device::{Device, Shared};
use super::error::{During, GpuError};
use super::transfer::UseOfBuffers;
use super::{Result, lock};
use antirad_base::usage::{Bytes, ScopeId, rounded};

/// The memory that a buffer lives in. Kernels and copies can use every kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BufferKind {
    /// Memory of the device.
    Storage,
    /// Memory that the host writes in sequence; slow to read there.
    Upload,
    /// Memory that the host reads, through its caches.
    Readback,
}

/// A buffer of a device. The label names it in errors, reports and debuggers.
pub struct Buffer {
    use_of_buffers: Arc<UseOfBuffers>,
    block: Arc<Block>,
}

/// What a buffer and the batches that use it share: it is freed when none of them is left.
pub(super) struct Block {
    shared: Arc<Shared>,
    memory: BufferMemory,
}

/// A byte range of a buffer, to bind to a kernel.
#[derive(Clone, Copy, Debug)]
pub struct BufferSlice<'a> {
    pub(super) buffer: &'a Buffer,
    pub(super) offset: u64,
    pub(super) bytes: u64,
}

impl<'a> BufferSlice<'a> {
    /// The buffer that the range lies in.
    pub fn buffer(&self) -> &'a Buffer {
        self.buffer
    }

    /// An empty range of the same buffer.
    pub fn empty(self) -> Self {
        Self { offset: 0, bytes: 0, ..self }
    }
}

impl Buffer {
    /// Allocates `bytes`, rounded up by [`rounded`]. The content is undefined.
    ///
    /// # Errors
    /// Fails if the memory budget or the device does not hold it.
    pub fn new(device: &Device, label: &str, bytes: u64, kind: BufferKind) -> Result<Self> {
        let memory = BufferMemory::new(&device.shared, device.scope.id(), label, bytes, kind)?;
        let block = Arc::new(Block { shared: device.shared.clone(), memory });
        Ok(Self { use_of_buffers: device.scope.use_of_buffers().clone(), block })
    }

    /// The name in errors, reports and debuggers.
    pub fn label(&self) -> &str {
        &self.block.memory.label
    }

    /// The size, rounded up.
    pub fn bytes(&self) -> u64 {
        self.block.memory.bytes
    }

    /// The content of an [`Upload`](BufferKind::Upload) or [`Readback`](BufferKind::Readback) buffer, mapped for the
    /// host; `None` for other kinds, and while a batch that uses it is not yet executed.
    pub fn mapped(&mut self) -> Option<&mut [u8]> {
        Arc::get_mut(&mut self.block)?.memory.mapped()
    }

    /// All of it, to bind to a kernel.
    pub fn whole(&self) -> BufferSlice<'_> {
        self.slice(0, self.bytes())
    }

    /// A byte range of the buffer. Range and alignment are checked where the slice is used.
    pub fn slice(&self, offset: u64, bytes: u64) -> BufferSlice<'_> {
        BufferSlice { buffer: self, offset, bytes }
    }

    /// The Vulkan handle, for embedders that record commands of their own.
    #[doc(hidden)]
    pub fn raw(&self) -> vk::Buffer {
        self.block.memory.raw
    }

    pub(super) fn use_of_buffers(&self) -> &Arc<UseOfBuffers> {
        &self.use_of_buffers
    }

    /// Keeps it alive.
    pub(super) fn block(&self) -> &Arc<Block> {
        &self.block
    }

    /// Checks that the buffer belongs to `device` and contains these bytes.
    pub(super) fn check(&self, device: &Device, offset: u64, bytes: u64) -> Result<()> {
        let label = || self.label().to_owned();
        if !Arc::ptr_eq(&self.block.shared, &device.shared) {
            return Err(GpuError::OtherDevice { label: label() });
        }
        let size = self.bytes();
        if offset > size || bytes > size - offset {
            return Err(GpuError::OutOfRange { label: label(), offset, bytes, size });
        }
        Ok(())
    }

    pub(super) fn check_aligned(&self, offset: u64, bytes: u64, alignment: u64) -> Result<()> {
        if offset.is_multiple_of(alignment) && bytes.is_multiple_of(alignment) {
            return Ok(());
        }
        Err(GpuError::Misaligned { label: self.label().to_owned(), offset, bytes, alignment })
    }
}

impl fmt::Debug for Buffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Buffer({:?}, {} bytes)", self.label(), self.bytes())
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        mem::take(&mut self.memory).destroy(&self.shared);
    }
}

/// A buffer that does not keep its device alive, so that the device can own it.
#[derive(Default)]
pub(super) struct BufferMemory {
    pub(super) raw: vk::Buffer,
    allocation: Allocation,
    scope: ScopeId,
    label: String,
    bytes: u64,
}

impl BufferMemory {
    pub(super) fn new(
        shared: &Shared,
        scope: ScopeId,
        label: &str,
        bytes: u64,
        kind: BufferKind,
    ) -> Result<Self> {
        let bytes = rounded(bytes);
        let limit = shared.info.largest_buffer();
        if bytes > limit {
            let (bytes, limit) = (Bytes(bytes), Bytes(limit));
            return Err(GpuError::BufferTooLarge { label: label.to_owned(), bytes, limit });
        }
        lock(&shared.memory).take(scope, label, bytes)?;
        // From here on `destroy` undoes everything, on failure too.
        let mut block = Self { scope, label: label.to_owned(), bytes, ..Self::default() };
        match block.create(shared, kind) {
            Ok(()) => Ok(block),
            Err(error) => {
                block.destroy(shared);
                Err(error)
            }
        }
    }

    fn create(&mut self, shared: &Shared, kind: BufferKind) -> Result<()> {
        let create = vk::BufferCreateInfo::default()
            .size(self.bytes)
            .usage(
                vk::BufferUsageFlags::STORAGE_BUFFER
                    | vk::BufferUsageFlags::UNIFORM_BUFFER
                    | vk::BufferUsageFlags::TRANSFER_SRC
                    | vk::BufferUsageFlags::TRANSFER_DST,
            )
            .sharing_mode(vk::SharingMode::EXCLUSIVE);
        let location = match kind {
            BufferKind::Storage => MemoryLocation::GpuOnly,
            BufferKind::Upload => MemoryLocation::CpuToGpu,
            BufferKind::Readback => MemoryLocation::GpuToCpu,
        };
        let device = shared.raw();
        // SAFETY: the device is alive.
        self.raw = unsafe { device.create_buffer(&create, None) }.during("creating buffer", &self.label)?;
        shared.name(self.raw, &self.label);
        // SAFETY: the buffer was just made from this device.
        let requirements = unsafe { device.get_buffer_memory_requirements(self.raw) };
        self.allocation = lock(&shared.memory).allocate(&self.label, requirements, location)?;
        // SAFETY: the memory is fresh, of the type, size and alignment that the buffer requires, and freed after it.
        unsafe {
            let memory = self.allocation.memory();
            device.bind_buffer_memory(self.raw, memory, self.allocation.offset())
        }
        .during("binding the memory of", &self.label)
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    pub(super) fn mapped(&mut self) -> Option<&mut [u8]> {
        let bytes = usize::try_from(self.bytes).ok()?;
        self.allocation.mapped_slice_mut()?.get_mut(..bytes)
    }

    pub(super) fn destroy(self, shared: &Shared) {
        if shared.is_hung() {
            return;
        }
        let device = shared.raw();
        // SAFETY: nothing executes that uses the buffer: batches keep it until they have ended.
        unsafe { device.destroy_buffer(self.raw, None) };
        let mut memory = lock(&shared.memory);
        memory.free(self.allocation);
        memory.give_back(self.scope, &self.label, self.bytes);
    }
}
