//! What ranks compute in shares, completed: each sends its own, and receives those of all others.

use super::Context;
use super::state::{StateBuffers, page};
use super::watch::TransportError;
use crate::gpu::Buffer;
use crate::plan::Group;
use std::ops::Range;

/// Most bytes that the host holds of a share at a time.
pub(super) const MOST_BYTES: u64 = 64 << 20;

/// Where a buffer holds values, by index.
#[derive(Clone, Copy)]
pub struct Values {
    /// Byte at which those of the first index begin.
    pub offset: u64,
    /// The first index.
    pub first: u32,
    /// Bytes of each.
    pub bytes: u64,
}

impl Context {
    /// Completes values of which each rank has computed a share.
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
        let step = (MOST_BYTES / bytes).max(1) as usize;
        let mut values = Vec::new();
        for (root, share) in shares.iter().enumerate() {
            for begin in share.clone().step_by(step) {
                let count = (share.end - begin).min(step as u32);
                let offset = offset + u64::from(begin - first) * bytes;
                values.resize((u64::from(count) * bytes) as usize, 0);
                let own = root == ranks.rank();
                if own {
                    self.device.download_into(buffer, offset, &mut values)?;
                }
                ranks.broadcast(root, &mut values)?;
                if !own {
                    self.device.upload(buffer, offset, &values)?;
                }
            }
        }
        Ok(())
    }

    /// Completes an array with `bytes` for each slot.
    pub fn complete_slots(&self, buffer: &Buffer, bytes: u64) -> Result<(), TransportError> {
        (0..self.plan.layout.groups.len()).try_for_each(|group| {
            self.complete(buffer, Values { offset: 0, first: 0, bytes }, &self.plan.slots_by_rank(group))
        })
    }

    /// Completes the bins of the groups that `wanted` selects.
    pub fn complete_pages(
        &self,
        pages: &[Option<Buffer>],
        wanted: impl Fn(&Group) -> bool,
    ) -> Result<(), TransportError> {
        for (g, group) in self.plan.layout.groups.iter().enumerate().filter(|(_, group)| wanted(group)) {
            let first = self.plan.layout.slots_of(&group.tiles).start;
            let values = Values { offset: 0, first, bytes: self.plan.bin_bytes() };
            self.complete(page(pages, g)?, values, &self.plan.slots_by_rank(g))?;
        }
        Ok(())
    }

    /// Completes a state.
    pub fn complete_state(&self, state: &StateBuffers) -> Result<(), TransportError> {
        self.complete_slots(&state.irradiance, self.plan.rgb_bytes())?;
        self.complete_pages(&state.bins, |group| group.class.has_bins())
    }
}
