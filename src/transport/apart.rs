//! States of several ranks: each holds the bins of its own triangles, and sends them to all others where these read them.

use super::completion::broadcast;
use super::residency::Part;
use super::state::StateBuffers;
use super::watch::TransportError;
use crate::gpu::{Buffer, BufferKind, Device, GpuError};
use crate::plan::Plan;
use crate::ranks::Ranks;
use std::ops::Range;

/// Who holds which bins.
pub struct Apart {
    pub ranks: Ranks,
    /// Slots with bins and the rank that holds them.
    shares: Vec<(usize, Range<u32>)>,
    /// Bytes of the bins of one slot.
    pub slot_bytes: u64,
}

impl Apart {
    pub fn new(device: &Device, plan: &Plan) -> Self {
        let groups = plan.layout.groups.iter().enumerate().filter(|(_, group)| group.class.has_bins());
        let shares = groups.flat_map(|(g, _)| plan.slots_by_rank(g).into_iter().enumerate());
        Self {
            ranks: device.ranks().clone(),
            shares: shares.filter(|(_, slots)| !slots.is_empty()).collect(),
            slot_bytes: plan.bin_bytes(),
        }
    }

    /// Calls `each` with the bins of some slots, whichever ranks hold them, and the byte among all of them with which they begin. `own`
    /// copies those that this rank holds. All ranks call it.
    pub fn gather(
        &self,
        slots: &Range<u32>,
        own: impl Fn(&Range<u32>, &mut [u8]) -> Result<(), TransportError>,
        mut each: impl FnMut(u64, &[u8]) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        let shares = self.shares.iter().map(|(rank, share)| (*rank, overlap(share, slots)));
        let receive = |_, some: &Range<u32>, values: &[u8]| {
            each(u64::from(some.start - slots.start) * self.slot_bytes, values)
        };
        broadcast(&self.ranks, shares, self.slot_bytes, own, receive)
    }

    /// The bins of some slots.
    pub fn gathered(
        &self,
        slots: &Range<u32>,
        own: impl Fn(&Range<u32>, &mut [u8]) -> Result<(), TransportError>,
    ) -> Result<Vec<u8>, TransportError> {
        let mut all = Vec::new();
        self.gather(slots, own, |_, values| {
            all.extend_from_slice(values);
            Ok(())
        })?;
        Ok(all)
    }

    /// Calls `with` with the number and the bins of each of some parts, one after the other; those of the next part come from when `with`
    /// lets them. All ranks call it. Holds another part in host memory.
    pub fn each(
        &self,
        parts: &[Option<Part>],
        own: impl Fn(&Range<u32>, &mut [u8]) -> Result<(), TransportError> + Sync,
        mut with: impl FnMut(usize, Option<(&Part, &[u8])>, &mut dyn FnMut()) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        std::thread::scope(|scope| {
            let mut left = parts.iter().flatten().filter_map(Part::slots);
            let own = &own;
            let mut coming = None;
            let mut next = |coming: &mut Option<_>| {
                if coming.is_none() {
                    *coming = left.next().map(|slots| scope.spawn(move || self.gathered(slots, own)));
                }
            };
            for (number, part) in parts.iter().enumerate() {
                next(&mut coming);
                let Some(part) = part else {
                    with(number, None, &mut || {})?;
                    continue;
                };
                let thread = coming.take().ok_or_else(|| TransportError::missing("bins of other ranks"))?;
                let values = thread.join().map_err(|payload| TransportError::panicked(&*payload))??;
                with(number, Some((part, &values)), &mut || next(&mut coming))?;
            }
            Ok(())
        })
    }
}

/// What states of several ranks on their devices share: room for a group's bins of all ranks, or for those of two.
pub struct Shown {
    apart: Apart,
    window: Option<Buffer>,
    beside: Option<Buffer>,
    /// The slots of each group whose bins this rank holds.
    own: Vec<Range<u32>>,
}

impl Shown {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let largest = plan.largest_group(|group| group.class.has_bins());
        let bytes = u64::from(largest) * plan.tile_bytes();
        let buffer = || Buffer::new(device, "state: bins", bytes, BufferKind::Storage);
        let own = |g: usize| plan.layout.slots_of(&plan.own(g).tiles);
        Ok(Self {
            apart: Apart::new(device, plan),
            window: (largest > 0).then(buffer).transpose()?,
            beside: (largest > 0 && plan.shows_two()).then(buffer).transpose()?,
            own: (0..plan.layout.groups.len()).map(own).collect(),
        })
    }

    /// One of the two windows.
    pub fn window(&self, beside: bool) -> Result<&Buffer, TransportError> {
        let window = if beside { &self.beside } else { &self.window };
        window.as_ref().ok_or_else(|| TransportError::missing("a window on bins"))
    }

    /// The bins of a part, of all ranks.
    pub fn download(
        &self,
        device: &Device,
        state: &StateBuffers,
        group: usize,
        slots: &Range<u32>,
    ) -> Result<Vec<u8>, TransportError> {
        let own = |some: &Range<u32>, values: &mut [u8]| {
            let first = u64::from(some.start - self.own[group].start) * self.apart.slot_bytes;
            Ok(device.download_into(state.page(group)?, first, values)?)
        };
        self.apart.gathered(slots, own)
    }

    /// See [`State::show_each`](super::state::State::show_each). Holds what this rank holds of the parts and another part in host memory:
    /// the device has other work while they are sent.
    pub fn each(
        &self,
        device: &Device,
        state: &StateBuffers,
        parts: &[Option<Part>],
        with: impl FnMut(usize, Option<(&Part, &[u8])>, &mut dyn FnMut()) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        let mut held: Vec<(Range<u32>, Vec<u8>)> = Vec::new();
        for part in parts.iter().flatten() {
            let Part::Bins { group, slots, .. } = part else { continue };
            let slots = overlap(&self.own[*group], slots);
            if !slots.is_empty() {
                let first = u64::from(slots.start - self.own[*group].start) * self.apart.slot_bytes;
                let bytes = slots.len() as u64 * self.apart.slot_bytes;
                held.push((slots, device.download(state.page(*group)?, first, bytes)?));
            }
        }
        let own = |some: &Range<u32>, values: &mut [u8]| {
            let of = held.iter().find(|(slots, _)| slots.start <= some.start && some.end <= slots.end);
            let (slots, held) = of.ok_or_else(|| TransportError::missing("bins of this rank"))?;
            let first = u64::from(some.start - slots.start) * self.apart.slot_bytes;
            values.copy_from_slice(&held[first as usize..][..values.len()]);
            Ok(())
        };
        self.apart.each(parts, own, with)
    }

    /// Sets what this rank holds of a part.
    pub fn upload(
        &self,
        device: &Device,
        state: &StateBuffers,
        (group, slots): (usize, &Range<u32>),
        values: &[u8],
    ) -> Result<(), TransportError> {
        let some = overlap(&self.own[group], slots);
        if some.is_empty() {
            return Ok(());
        }
        let bytes = |slots: u32| u64::from(slots) * self.apart.slot_bytes;
        let from = bytes(some.start - slots.start) as usize;
        let values = &values[from..][..bytes(some.len() as u32) as usize];
        Ok(device.upload(state.page(group)?, bytes(some.start - self.own[group].start), values)?)
    }
}

/// What two ranges have in common; where that is nothing, a range that is empty.
pub fn overlap(a: &Range<u32>, b: &Range<u32>) -> Range<u32> {
    a.start.max(b.start)..a.end.min(b.end)
}
