//! States on the host: the device accesses them part by part, through two windows. Results do not depend on where a
//! part lives, bit for bit.

use super::watch::TransportError;
use crate::gpu::{Batch, Buffer, BufferKind, BufferSlice, Device, GpuError};
use crate::plan::{Group, Piece, Plan};
use crate::scene::Precision;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A part of a state that one dispatch can access.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Part {
    /// Irradiance of all slots.
    Irradiance { bytes: u64 },
    /// Bins of some slots of a group.
    Bins { group: usize, slots: Range<u32>, bytes: u64 },
}

impl Part {
    pub fn irradiance(plan: &Plan) -> Self {
        Self::Irradiance { bytes: plan.irradiance_bytes() }
    }

    /// The bins of a group, or of some of its tiles. `None` where the class has no bins.
    pub fn of_group(plan: &Plan, group: usize, of: &Group) -> Option<Self> {
        let (slots, bytes) = (plan.layout.slots_of(&of.tiles), plan.page_bytes(of));
        of.class.has_bins().then_some(Self::Bins { group, slots, bytes })
    }

    /// The bins of a piece. `None` where the class has no bins.
    pub fn of_piece(plan: &Plan, piece: &Piece) -> Option<Self> {
        Self::of_group(plan, piece.group, &piece.part)
    }

    /// All parts of a state, one after the other.
    pub fn all(plan: &Plan) -> Vec<Self> {
        let pieces = plan.pieces();
        let bins = pieces.iter().filter_map(|piece| Self::of_piece(plan, piece));
        std::iter::once(Self::irradiance(plan)).chain(bins).collect()
    }

    pub fn bytes(&self) -> u64 {
        match self {
            Self::Irradiance { bytes } | Self::Bins { bytes, .. } => *bytes,
        }
    }
}

/// A part of a state in a buffer of the device.
pub struct View<'a> {
    buffer: &'a Buffer,
    offset: u64,
    bytes: u64,
    /// The slot of the first values in the buffer.
    pub first_slot: u32,
    /// Where the values are stored on the host, if they are.
    home: Option<(&'a Hosted, Place)>,
}

impl<'a> View<'a> {
    pub fn resident(buffer: &'a Buffer, first_slot: u32, bytes: u64) -> Self {
        Self { buffer, offset: 0, bytes, first_slot, home: None }
    }

    /// The whole buffer, to bind to a kernel.
    pub fn slice(&self) -> BufferSlice<'a> {
        self.buffer.whole()
    }

    /// The values of the part alone.
    pub fn own(&self) -> BufferSlice<'a> {
        self.buffer.slice(self.offset, self.bytes)
    }

    /// How many reals the part has.
    pub fn reals(&self, precision: Precision) -> u32 {
        (self.bytes / precision.bytes()) as u32
    }

    /// Makes all values zero.
    pub fn clear(&self, device: &Device) -> Result<(), GpuError> {
        let mut batch = device.batch()?;
        self.fill(&mut batch)?;
        batch.submit()?;
        Ok(())
    }

    /// The same as part of a batch.
    pub fn fill(&self, batch: &mut Batch<'a>) -> Result<(), GpuError> {
        batch.fill(self.buffer, self.offset, self.bytes, 0)
    }

    pub fn upload(&self, device: &Device, values: &[u8]) -> Result<(), GpuError> {
        device.upload(self.buffer, self.offset, values)
    }

    pub fn download(&self, device: &Device) -> Result<Vec<u8>, GpuError> {
        device.download(self.buffer, self.offset, self.bytes)
    }

    /// Copies the values back to the host, if the state lives there.
    pub fn store(self, device: &Device) -> Result<(), TransportError> {
        if let Some((hosted, place)) = self.home {
            device.download_into(self.buffer, self.offset, place.of(&mut hosted.values())?)?;
        }
        Ok(())
    }
}

/// A window: the irradiance of a state, and bins of a few tiles.
struct Window {
    irradiance: Buffer,
    /// `None` where nothing has bins.
    bins: Option<Buffer>,
}

impl Window {
    fn new(device: &Device, plan: &Plan, tiles: u32) -> Result<Self, GpuError> {
        let buffer = |label, bytes| Buffer::new(device, label, bytes, BufferKind::Storage);
        let bins = || buffer("state: bins", u64::from(tiles) * plan.tile_bytes());
        Ok(Self {
            irradiance: buffer("state: irradiance", plan.irradiance_bytes())?,
            bins: (!plan.tiles_with_bins().is_empty()).then(bins).transpose()?,
        })
    }

    fn buffer(&self, part: &Part) -> Result<&Buffer, TransportError> {
        match part {
            Part::Irradiance { .. } => Ok(&self.irradiance),
            Part::Bins { .. } => {
                self.bins.as_ref().ok_or_else(|| TransportError::missing("a window on bins"))
            }
        }
    }
}

/// The two windows shared by all states, and the layout of the bins on the host.
pub struct Windows {
    read: Window,
    write: Window,
    /// Slots with bins, and the number of them in a sweep.
    slots: Range<u32>,
    swept: u32,
    /// Bytes of the bins of one slot.
    slot_bytes: u64,
    irradiance_bytes: u64,
}

impl Windows {
    pub fn new(device: &Device, plan: &Plan, receivers: u32, sources: u32) -> Result<Self, GpuError> {
        Ok(Self {
            read: Window::new(device, plan, sources)?,
            write: Window::new(device, plan, receivers)?,
            slots: plan.layout.slots_of(&plan.tiles_with_bins()),
            swept: receivers.saturating_mul(plan.layout.tile),
            slot_bytes: plan.bin_bytes(),
            irradiance_bytes: plan.irradiance_bytes(),
        })
    }

    /// Index of the first of `slots` among the slots with bins.
    fn slot(&self, slots: &Range<u32>) -> Result<u32, TransportError> {
        let number = slots.start.checked_sub(self.slots.start);
        number.ok_or_else(|| TransportError::missing(format!("bins of slot {}", slots.start)))
    }
}

/// A state on the host, byte for byte as the device would hold it.
pub struct Hosted {
    windows: Arc<Windows>,
    values: Mutex<Values>,
}

struct Values {
    irradiance: Vec<u8>,
    /// Bins of all slots that have some.
    bins: Vec<u8>,
}

/// A byte range of one of the two arrays.
#[derive(Debug)]
enum Place {
    Irradiance,
    Bins(Range<u64>),
}

impl Place {
    fn of<'a>(&self, values: &'a mut Values) -> Result<&'a mut [u8], TransportError> {
        match self {
            Self::Irradiance => Ok(&mut values.irradiance),
            Self::Bins(range) => {
                let bytes = values.bins.len() as u64;
                let outside = TransportError::OutsideOfState { begin: range.start, end: range.end, bytes };
                let range = range.start as usize..range.end as usize;
                values.bins.get_mut(range).ok_or(outside)
            }
        }
    }
}

impl Hosted {
    pub fn new(windows: &Arc<Windows>) -> Result<Self, TransportError> {
        let bins = windows.slots.len() as u64 * windows.slot_bytes;
        let values = Values { irradiance: zeros(windows.irradiance_bytes)?, bins: zeros(bins)? };
        Ok(Self { windows: windows.clone(), values: Mutex::new(values) })
    }

    fn values(&self) -> MutexGuard<'_, Values> {
        self.values.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn place(&self, part: &Part) -> Result<Place, TransportError> {
        match part {
            Part::Irradiance { .. } => Ok(Place::Irradiance),
            Part::Bins { slots, bytes, .. } => {
                let first = u64::from(self.windows.slot(slots)?) * self.windows.slot_bytes;
                Ok(Place::Bins(first..first + bytes))
            }
        }
    }

    /// The part at the start of a window.
    fn view<'a>(&'a self, window: &'a Window, part: &Part) -> Result<View<'a>, TransportError> {
        let first_slot = match part {
            Part::Irradiance { .. } => 0,
            Part::Bins { slots, .. } => slots.start,
        };
        let home = Some((self, self.place(part)?));
        Ok(View { buffer: window.buffer(part)?, offset: 0, bytes: part.bytes(), first_slot, home })
    }

    fn bring(&self, device: &Device, view: &View, part: &Part) -> Result<(), TransportError> {
        Ok(view.upload(device, self.place(part)?.of(&mut self.values())?)?)
    }

    pub fn show(&self, device: &Device, part: &Part) -> Result<View<'_>, TransportError> {
        let view = self.view(&self.windows.read, part)?;
        self.bring(device, &view, part)?;
        Ok(view)
    }

    pub fn edit(&self, device: &Device, part: &Part, old: bool) -> Result<View<'_>, TransportError> {
        let view = self.view(&self.windows.write, part)?;
        if old {
            self.bring(device, &view, part)?;
        }
        Ok(view)
    }

    /// The parts of a sweep are adjacent in the window.
    pub fn receive(&self, part: &Part) -> Result<View<'_>, TransportError> {
        let view = self.view(&self.windows.write, part)?;
        let Part::Bins { slots, .. } = part else { return Ok(view) };
        let within = self.windows.slot(slots)? % self.windows.swept;
        let offset = u64::from(within) * self.windows.slot_bytes;
        Ok(View { offset, first_slot: slots.start - within, ..view })
    }

    pub fn download(&self, part: &Part) -> Result<Vec<u8>, TransportError> {
        Ok(self.place(part)?.of(&mut self.values())?.to_vec())
    }
}

/// Returns an error where a plain vector would abort for lack of memory.
fn zeros(bytes: u64) -> Result<Vec<u8>, TransportError> {
    let short = || TransportError::HostMemory { bytes };
    let count = usize::try_from(bytes).map_err(|_| short())?;
    let mut values = Vec::new();
    values.try_reserve_exact(count).map_err(|_| short())?;
    values.resize(count, 0);
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{plan, scene};
    use super::*;
    use crate::gpu::DeviceOptions;

    #[test]
    fn parts_that_a_state_does_not_have_are_errors_not_empty() {
        let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device");
        let plan = plan(&device, &scene());
        let windows = Arc::new(Windows::new(&device, &plan, 1, 1).expect("windows"));
        let hosted = Hosted::new(&windows).expect("a state");
        let (g, group) = plan.glossy_groups().next().expect("a glossy group");
        let Some(Part::Bins { slots, bytes, .. }) = Part::of_group(&plan, g, group) else {
            panic!("no bins")
        };
        let part = |slots: Range<u32>| Part::Bins { group: g, slots, bytes };
        assert_eq!(hosted.download(&part(slots.clone())).expect("bins").len() as u64, bytes);
        let end = plan.layout.slots();
        let error = hosted.download(&part(end..end + slots.len() as u32)).expect_err("beyond the end");
        assert!(matches!(error, TransportError::OutsideOfState { .. }), "{error}");
        assert!(matches!(
            hosted.show(&device, &part(end..end + 1)),
            Err(TransportError::OutsideOfState { .. })
        ));
        let view = hosted.receive(&part(end..end + 1)).expect("a view");
        assert!(matches!(view.store(&device), Err(TransportError::OutsideOfState { .. })));
        // Slots without bins come before the first that has some.
        let first = plan.layout.slots_of(&plan.tiles_with_bins()).start;
        assert!(first > 0);
        assert!(matches!(hosted.edit(&device, &part(0..1), false), Err(TransportError::Missing { .. })));
    }
}
