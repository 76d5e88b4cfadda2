//! States distributed over several ranks: each holds the bins of its own triangles, and sends them to all
//! others where these read them.

use super::completion::broadcast;
use super::residency::{Part, View};
use super::state::StateBuffers;
use crate::plan::{Plan, overlap};
use crate::transport::TransportError;
use antirad_base::ranks::Ranks;
use antirad_gpu::{Buffer, BufferKind, Device, GpuError};
use std::ops::Range;
use std::sync::Arc;

/// Which rank holds which bins.
pub struct Distributed {
    pub ranks: Ranks,
    /// Slots with bins and the rank that holds them.
    shares: Vec<(usize, Range<u32>)>,
    /// Bytes of the bins of one slot.
    pub slot_bytes: u64,
}

impl Distributed {
    pub fn new(device: &Device, plan: &Plan) -> Self {
        let groups = plan.layout.groups.iter().enumerate().filter(|(_, group)| group.class.has_bins());
        let shares = groups.flat_map(|(g, _)| plan.slots_by_rank(g).into_iter().enumerate());
        Self {
            ranks: device.ranks().clone(),
            shares: shares.filter(|(_, slots)| !slots.is_empty()).collect(),
            slot_bytes: plan.bin_bytes(),
        }
    }

    /// Allgathers the bins of some slots: calls `each` with some of them at a time, and with the byte among
    /// all of them at which these begin. `own` copies those that this rank holds. All ranks call it.
    ///
    /// # Errors
    /// Fails if another rank has ended or does not call it, or if `own` or `each` fails.
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

    /// Allgathers the bins of some slots into a view on the device, chunk by chunk as they arrive. `own`
    /// copies those that this rank holds. All ranks call it.
    ///
    /// # Errors
    /// Fails if another rank has ended or does not call it, if the device fails, or if `own` does.
    pub fn gather_into(
        &self,
        device: &Device,
        view: &View,
        slots: &Range<u32>,
        own: impl Fn(&Range<u32>, &mut [u8]) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        self.gather(slots, own, |at, values| Ok(device.upload(view.buffer(), at, values)?))
    }

    /// Allgathers the bins of some slots into host memory. `own` copies those that this rank holds. All ranks
    /// call it.
    ///
    /// # Errors
    /// Fails if another rank has ended or does not call it, or if `own` fails.
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

    /// Calls `with` with the number and the bins of each of some parts, in the `view` of it, one after the other; those of the next part
    /// come from when `with` lets them, which until then may communicate with other ranks itself. All ranks call it. Holds another part in
    /// host memory.
    ///
    /// # Errors
    /// Fails if another rank has ended or does not call it, if the device fails, if a closure does, or if the
    /// thread that brings bins panics.
    pub fn each<'a>(
        &self,
        device: &Device,
        parts: &[Option<Part>],
        own: impl Fn(&Range<u32>, &mut [u8]) -> Result<(), TransportError> + Sync,
        view: impl Fn(&Part) -> Result<View<'a>, TransportError>,
        mut with: impl FnMut(usize, Option<View>, &mut dyn FnMut()) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        std::thread::scope(|scope| {
            let (slots_of, own) = (|of: usize| parts.get(of)?.as_ref()?.slots(), &own);
            let gather = |slots| scope.spawn(move || self.gathered(slots, own));
            let mut coming = None;
            for (number, part) in parts.iter().enumerate() {
                let this = coming.take().or_else(|| slots_of(number).map(gather));
                // No later one: what is not a part may be sent in between.
                let mut next = || coming = coming.take().or_else(|| slots_of(number + 1).map(gather));
                let Some(part) = part else {
                    with(number, None, &mut next)?;
                    continue;
                };
                let thread = this.ok_or_else(|| TransportError::missing("bins of other ranks"))?;
                let values = thread.join().map_err(|payload| TransportError::panicked(&*payload))??;
                let view = view(part)?;
                view.upload(device, &values)?;
                with(number, Some(view), &mut next)?;
            }
            Ok(())
        })
    }
}

/// What the states of several ranks on their devices share.
pub struct Windows {
    distributed: Distributed,
    /// Room for the bins of a group, of all ranks.
    window: Option<Buffer>,
    /// The slots of each group whose bins this rank holds.
    own: Vec<Range<u32>>,
}

impl Windows {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let largest = plan.largest_group(|group| group.class.has_bins());
        let bytes = u64::from(largest) * plan.tile_bytes();
        let buffer = || Buffer::new(device, "state: bins", bytes, BufferKind::Storage);
        let own = |g: usize| plan.layout.slots_of(&plan.own(g).tiles);
        Ok(Self {
            distributed: Distributed::new(device, plan),
            window: (largest > 0).then(buffer).transpose()?,
            own: (0..plan.layout.groups.len()).map(own).collect(),
        })
    }

    /// A part in the window, with values to come.
    fn view(&self, part: &Part) -> Result<View<'_>, TransportError> {
        let window = self.window.as_ref().ok_or_else(|| TransportError::missing("a window on bins"))?;
        Ok(View::resident(window, part.slots().map_or(0, |slots| slots.start), part.bytes()))
    }

    fn bytes(&self, slots: u32) -> u64 {
        u64::from(slots) * self.distributed.slot_bytes
    }
}

/// A state on the devices of several ranks, of which this one holds some bins.
pub struct OnDevices {
    pub buffers: StateBuffers,
    pub windows: Arc<Windows>,
}

impl OnDevices {
    /// The bins of a part, allgathered into the window; irradiance in the buffer that holds it. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, or if another rank has ended.
    pub fn show(&self, device: &Device, part: &Part) -> Result<View<'_>, TransportError> {
        let Part::Bins { group, slots, .. } = part else { return self.buffers.view(part) };
        let view = self.windows.view(part)?;
        let own = |some: &Range<u32>, values: &mut [u8]| self.copy(device, *group, some, values);
        self.windows.distributed.gather_into(device, &view, slots, own)?;
        Ok(view)
    }

    /// See [`State::show_each`](super::state::State::show_each). Holds what this rank holds of the parts and another part in host memory:
    /// the device has other work while they are sent.
    ///
    /// # Errors
    /// Fails if the device does, if another rank has ended, or if `with` fails.
    pub fn show_each(
        &self,
        device: &Device,
        parts: &[Option<Part>],
        with: impl FnMut(usize, Option<View>, &mut dyn FnMut()) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        let windows = &*self.windows;
        let mut held: Vec<(Range<u32>, Vec<u8>)> = Vec::new();
        for part in parts.iter().flatten() {
            let Part::Bins { group, slots, .. } = part else { continue };
            let slots = overlap(&windows.own[*group], slots);
            if !slots.is_empty() {
                let mut values = vec![0; windows.bytes(slots.len() as u32) as usize];
                self.copy(device, *group, &slots, &mut values)?;
                held.push((slots, values));
            }
        }
        let own = |some: &Range<u32>, values: &mut [u8]| {
            let of = held.iter().find(|(slots, _)| slots.start <= some.start && some.end <= slots.end);
            let (slots, held) = of.ok_or_else(|| TransportError::missing("bins of this rank"))?;
            let first = windows.bytes(some.start - slots.start) as usize;
            values.copy_from_slice(&held[first..][..values.len()]);
            Ok(())
        };
        windows.distributed.each(device, parts, own, |part| windows.view(part), with)
    }

    /// The bytes of a part, whichever ranks hold them. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, or if another rank has ended.
    pub fn download(&self, device: &Device, part: &Part) -> Result<Vec<u8>, TransportError> {
        match part {
            Part::Irradiance { .. } => Ok(self.buffers.view(part)?.download(device)?),
            Part::Bins { group, slots, .. } => {
                let own = |some: &Range<u32>, values: &mut [u8]| self.copy(device, *group, some, values);
                self.windows.distributed.gathered(slots, own)
            }
        }
    }

    /// Copies bins that this rank holds.
    fn copy(
        &self,
        device: &Device,
        group: usize,
        slots: &Range<u32>,
        values: &mut [u8],
    ) -> Result<(), TransportError> {
        let first = self.windows.bytes(slots.start - self.windows.own[group].start);
        Ok(device.download_into(self.buffers.page(group)?, first, values)?)
    }

    /// Sets the values of a part, of which this rank keeps its own.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn set(&self, device: &Device, part: &Part, values: &[u8]) -> Result<(), TransportError> {
        let windows = &*self.windows;
        let Part::Bins { group, slots, .. } = part else {
            return Ok(self.buffers.view(part)?.upload(device, values)?);
        };
        let some = overlap(&windows.own[*group], slots);
        if some.is_empty() {
            return Ok(());
        }
        let from = windows.bytes(some.start - slots.start) as usize;
        let values = &values[from..][..windows.bytes(some.len() as u32) as usize];
        let first = windows.bytes(some.start - windows.own[*group].start);
        Ok(device.upload(self.buffers.page(*group)?, first, values)?)
    }
}
