//! Transfers between host and device, through staging buffers of a bounded size.

use std::collections::BTreeMap;
use std::mem;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard};

use bytemuck::Pod;

use super::buffer::{Block, Buffer, BufferKind, BufferMemory, BufferSlice};
use super::commands::{Batch, BatchTiming};
use super::device::{Device, Shared};
use super::error::GpuError;
use super::recorder::Recorder;
use super::{Result, lock};
use antirad_base::usage::{ALIGN, ScopeId, rounded};

/// Bytes of one staging buffer, unless [`Device::scope`] says otherwise; longer transfers go piece by piece. Large
/// enough that a piece costs more than its submission, small compared with most budgets.
pub const STAGING_CHUNK: u64 = 8 << 20;

/// Device memory of transfers, for a plan to count: staging buffers for upload and download, made at first use.
pub const fn staging_bytes() -> u64 {
    2 * rounded(STAGING_CHUNK)
}

/// Bytes of each of two staging buffers that are to have `staging` together, where no buffer may exceed `limit`.
fn staging_buffer(staging: u64, limit: u64) -> u64 {
    rounded(staging / 2).min(limit / ALIGN * ALIGN)
}

/// The state of one user of a device: the id under which its buffers are counted, and its staging buffers, each locked
/// by one transfer at a time.
pub(super) struct Scope {
    shared: Arc<Shared>,
    id: ScopeId,
    /// Bytes of each staging buffer.
    chunk: u64,
    upload: Mutex<Option<BufferMemory>>,
    readback: Mutex<Option<BufferMemory>>,
    use_of_buffers: Arc<UseOfBuffers>,
}

/// Who uses the buffers of a scope.
pub(super) struct UseOfBuffers {
    scope: ScopeId,
    /// What is executed before anything else.
    deferred: Mutex<Vec<Deferred>>,
}

/// A batch that was recorded, and waits for the next use of the buffers of its scope.
pub(super) struct Deferred {
    shared: Arc<Shared>,
    pub(super) recorder: Recorder,
    /// The buffers that the batch uses, kept alive.
    _kept: Vec<Arc<Block>>,
}

impl Deferred {
    pub(super) fn new(shared: &Arc<Shared>, recorder: Recorder, kept: Vec<Arc<Block>>) -> Self {
        Self { shared: shared.clone(), recorder, _kept: kept }
    }
}

impl Drop for Deferred {
    fn drop(&mut self) {
        mem::take(&mut self.recorder).set_aside(&self.shared);
    }
}

/// The scopes whose buffers are used together, in the order in which all threads lock them.
#[derive(Default)]
pub(super) struct UsedScopes(BTreeMap<ScopeId, Arc<UseOfBuffers>>);

impl UsedScopes {
    pub(super) fn add(&mut self, of: &Arc<UseOfBuffers>) {
        self.0.entry(of.scope).or_insert_with(|| of.clone());
    }

    /// Whether no scope is used but one.
    pub(super) fn only(&self, scope: &Scope) -> bool {
        self.0.keys().all(|&id| id == scope.id)
    }

    /// What waits in them.
    pub(super) fn deferred(&self) -> Vec<MutexGuard<'_, Vec<Deferred>>> {
        self.0.values().map(|of| lock(&of.deferred)).filter(|deferred| !deferred.is_empty()).collect()
    }
}

impl Scope {
    /// A new scope with `staging` bytes for both staging buffers together, or the most that the device
    /// allows.
    pub(super) fn new(shared: &Arc<Shared>, staging: u64) -> Arc<Self> {
        let id = ScopeId(shared.scopes.fetch_add(1, Ordering::Relaxed));
        let chunk = staging_buffer(staging, shared.info.largest_buffer());
        Arc::new(Self {
            shared: shared.clone(),
            id,
            chunk,
            upload: Mutex::default(),
            readback: Mutex::default(),
            use_of_buffers: Arc::new(UseOfBuffers { scope: id, deferred: Mutex::default() }),
        })
    }

    pub(super) fn id(&self) -> ScopeId {
        self.id
    }

    pub(super) fn use_of_buffers(&self) -> &Arc<UseOfBuffers> {
        &self.use_of_buffers
    }

    /// The set that contains this scope and no other.
    pub(super) fn alone(&self) -> UsedScopes {
        let mut used = UsedScopes::default();
        used.add(&self.use_of_buffers);
        used
    }

    /// Adds a batch to those that wait, and tells how many there are now.
    pub(super) fn defer(&self, batch: Deferred) -> usize {
        let mut deferred = lock(&self.use_of_buffers.deferred);
        deferred.push(batch);
        deferred.len()
    }

    /// The staging buffer of a slot, made at its first use.
    fn staging<'a>(
        &self,
        slot: &'a mut Option<BufferMemory>,
        label: &str,
        kind: BufferKind,
    ) -> Result<&'a mut BufferMemory> {
        match slot {
            Some(block) => Ok(block),
            None => Ok(slot.insert(BufferMemory::new(&self.shared, self.id, label, self.chunk, kind)?)),
        }
    }
}

impl Drop for Scope {
    fn drop(&mut self) {
        // Nobody can read what would come of it.
        lock(&self.use_of_buffers.deferred).clear();
        for slot in [&self.upload, &self.readback] {
            if let Some(block) = lock(slot).take() {
                block.destroy(&self.shared);
            }
        }
    }
}

impl Device {
    /// Writes `data` into `buffer` from `offset` (bytes) on.
    ///
    /// # Errors
    /// Fails if the range goes beyond the buffer, if the buffer is of another device, or if the device fails.
    #[doc(hidden)]
    pub fn upload(&self, buffer: &Buffer, offset: u64, data: &[u8]) -> Result<()> {
        buffer.check(self, offset, data.len() as u64)?;
        if data.is_empty() {
            return Ok(());
        }
        let mut slot = lock(&self.scope.upload);
        let staging = self.scope.staging(&mut slot, "staging upload", BufferKind::Upload)?;
        let mut at = offset;
        for piece in data.chunks(staging.bytes() as usize) {
            let bytes = piece.len() as u64;
            mapped(staging)?[..piece.len()].copy_from_slice(piece);
            let mut batch = self.batch()?;
            batch.will_use(buffer);
            // SAFETY: the range was checked; the lock and the borrow keep both buffers to the end of the batch.
            unsafe { batch.copy_raw(staging.raw, 0, buffer.raw(), at, bytes)? };
            batch.submit()?;
            at += bytes;
        }
        Ok(())
    }

    /// Reads `into.len()` bytes of `buffer` from `offset` on.
    ///
    /// # Errors
    /// Fails if the range goes beyond the buffer, if the buffer is of another device, or if the device fails.
    #[doc(hidden)]
    pub fn download_into(&self, buffer: &Buffer, offset: u64, into: &mut [u8]) -> Result<()> {
        buffer.check(self, offset, into.len() as u64)?;
        if into.is_empty() {
            return Ok(());
        }
        let mut slot = lock(&self.scope.readback);
        let staging = self.scope.staging(&mut slot, "staging readback", BufferKind::Readback)?;
        let mut at = offset;
        for piece in into.chunks_mut(staging.bytes() as usize) {
            let bytes = piece.len() as u64;
            let mut batch = self.batch()?;
            batch.will_use(buffer);
            // SAFETY: as in `upload`.
            unsafe { batch.copy_raw(buffer.raw(), at, staging.raw, 0, bytes)? };
            batch.submit()?;
            piece.copy_from_slice(&mapped(staging)?[..piece.len()]);
            at += bytes;
        }
        Ok(())
    }

    /// Reads `bytes` of `buffer` from `offset` on.
    ///
    /// # Errors
    /// Fails if the range goes beyond the buffer, if the buffer is of another device, or if the device fails.
    #[doc(hidden)]
    pub fn download(&self, buffer: &Buffer, offset: u64, bytes: u64) -> Result<Vec<u8>> {
        self.download_slice(buffer, offset, bytes)
    }

    /// Writes `values` into `buffer` from `offset` (bytes) on.
    ///
    /// # Errors
    /// Fails if the range goes beyond the buffer, if the buffer is of another device, or if the device fails.
    #[doc(hidden)]
    pub fn upload_slice<T: Pod>(&self, buffer: &Buffer, offset: u64, values: &[T]) -> Result<()> {
        self.upload(buffer, offset, bytemuck::cast_slice(values))
    }

    /// Reads `count` values from `offset` (bytes) on.
    ///
    /// # Errors
    /// Fails if the range goes beyond the buffer, if the buffer is of another device, or if the device fails.
    #[doc(hidden)]
    pub fn download_slice<T: Pod>(&self, buffer: &Buffer, offset: u64, count: u64) -> Result<Vec<T>> {
        // Checked before host memory is allocated: a wrong count is an error, not an abort.
        buffer.check(self, offset, count.saturating_mul(size_of::<T>() as u64))?;
        let mut values = vec![T::zeroed(); count as usize];
        self.download_into(buffer, offset, bytemuck::cast_slice_mut(&mut values))?;
        Ok(values)
    }
}

impl Batch {
    /// Executes what was recorded and reads ranges of buffers as it leaves them: in one submission, where
    /// they fit a staging buffer together.
    ///
    /// # Errors
    /// Fails if a range goes beyond its buffer, if a buffer is of another device, or if the device fails.
    pub fn submit_and_read(mut self, parts: &[BufferSlice]) -> Result<(Vec<Vec<u8>>, BatchTiming)> {
        let device = self.device.clone();
        parts.iter().try_for_each(|part| part.buffer.check(&device, part.offset, part.bytes))?;
        let mut slot = lock(&device.scope.readback);
        let staging = device.scope.staging(&mut slot, "staging readback", BufferKind::Readback)?;
        let ends = parts.iter().scan(0_u64, |end, part| {
            *end = end.saturating_add(part.bytes);
            Some(*end)
        });
        let ends: Vec<u64> = ends.collect();
        if ends.last().is_some_and(|&end| end > staging.bytes()) {
            drop(slot);
            let timing = self.submit()?;
            let read = parts.iter().map(|part| device.download(part.buffer, part.offset, part.bytes));
            return Ok((read.collect::<Result<_>>()?, timing));
        }
        for (part, end) in parts.iter().zip(&ends) {
            self.will_use(part.buffer);
            // SAFETY: the ranges were checked; the lock and the borrow keep the buffers to the end of the batch.
            unsafe {
                self.copy_raw(part.buffer.raw(), part.offset, staging.raw, end - part.bytes, part.bytes)?;
            }
        }
        let timing = self.submit()?;
        let values = mapped(staging)?;
        let read =
            |(part, end): (&BufferSlice, &u64)| values[(end - part.bytes) as usize..*end as usize].to_vec();
        Ok((parts.iter().zip(&ends).map(read).collect(), timing))
    }
}

fn mapped(block: &mut BufferMemory) -> Result<&mut [u8]> {
    let what = "mapping a staging buffer".to_owned();
    let result = ash::vk::Result::ERROR_MEMORY_MAP_FAILED.to_string();
    block.mapped().ok_or(GpuError::Vulkan { what, result })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn staging_buffers_keep_to_the_limit_of_a_device() {
        let limit = (1 << 27) + 100;
        assert_eq!(staging_buffer(staging_bytes(), limit), STAGING_CHUNK);
        assert_eq!(staging_buffer(0, limit), ALIGN);
        assert_eq!(staging_buffer(2 * limit, limit), 1 << 27);
        assert_eq!(staging_buffer(u64::MAX, limit), 1 << 27);
        assert_eq!(staging_buffer(staging_bytes(), 1000), 768);
    }
}
