//! What ranks compute in shares, completed: each sends its own, and receives those of all others.

use super::Context;
use crate::transport::TransportError;
use antirad_base::ranks::Ranks;
use antirad_gpu::Buffer;
use std::ops::Range;

/// Most bytes of a share that the host holds at a time.
const MOST_BYTES: u64 = 64 << 20;

/// Layout of values in a buffer, by index.
#[derive(Clone, Copy)]
pub struct Values {
    /// Byte at which the values of the first index begin.
    pub offset: u64,
    /// The first index that the buffer holds.
    pub first: u32,
    /// Bytes of the values of each index.
    pub bytes: u64,
}

impl Context {
    /// Allgathers values: each rank has computed those of its share of indices, and all have the whole
    /// afterwards. All ranks call it.
    pub fn complete(
        &self,
        buffer: &Buffer,
        Values { offset, first, bytes }: Values,
        shares: &[Range<u32>],
    ) -> Result<(), TransportError> {
        let ranks = self.device.ranks();
        if ranks.count() == 1 {
            return Ok(());
        }
        let at = |slots: &Range<u32>| offset + u64::from(slots.start - first) * bytes;
        let send =
            |some: &Range<u32>, values: &mut [u8]| Ok(self.device.download_into(buffer, at(some), values)?);
        let receive = |root, some: &Range<u32>, values: &[u8]| match root == ranks.rank() {
            true => Ok(()),
            false => Ok(self.device.upload(buffer, at(some), values)?),
        };
        let shares = shares.iter().cloned().enumerate();
        broadcast(ranks, shares, bytes, send, receive)
    }

    /// Allgathers an array with `bytes` for each slot. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, or if another rank has ended.
    pub fn complete_slots(&self, buffer: &Buffer, bytes: u64) -> Result<(), TransportError> {
        (0..self.plan.layout.groups.len()).try_for_each(|group| {
            self.complete(buffer, Values { offset: 0, first: 0, bytes }, &self.plan.slots_by_rank(group))
        })
    }
}

/// Sends shares, each with the rank that holds it, to all ranks, some at a time; `bytes`: of each index. `send` fills in values of this rank,
/// and `receive` gets those of every rank, with its number. All ranks call it.
pub(super) fn broadcast(
    ranks: &Ranks,
    shares: impl Iterator<Item = (usize, Range<u32>)>,
    bytes: u64,
    mut send: impl FnMut(&Range<u32>, &mut [u8]) -> Result<(), TransportError>,
    mut receive: impl FnMut(usize, &Range<u32>, &[u8]) -> Result<(), TransportError>,
) -> Result<(), TransportError> {
    let step = (MOST_BYTES / bytes).clamp(1, u64::from(u32::MAX)) as u32;
    let mut values = Vec::new();
    for (root, share) in shares {
        for begin in share.clone().step_by(step as usize) {
            let some = begin..share.end.min(begin.saturating_add(step));
            values.resize((some.len() as u64 * bytes) as usize, 0);
            if root == ranks.rank() {
                send(&some, &mut values)?;
            }
            ranks.broadcast(root, &mut values)?;
            receive(root, &some, &values)?;
        }
    }
    Ok(())
}
