//! States on the host: the device accesses them part by part, through two windows. Results do not depend on where a
//! part lives, bit for bit.

use super::distributed::Distributed;
use crate::plan::{Group, Piece, Plan, overlap};
use crate::transport::TransportError;
use antirad_gpu::{Batch, Buffer, BufferKind, BufferSlice, Device, GpuError};
use antirad_scene::Precision;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A range of a state that one dispatch can access.
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

    /// What this rank holds of the bins of a group. `None` where that is nothing.
    pub fn held(plan: &Plan, group: usize) -> Option<Self> {
        Self::of_group(plan, group, &plan.own(group)).filter(|part| part.bytes() > 0)
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

    /// What this rank holds of a state, one part after the other.
    pub fn own(plan: &Plan) -> Vec<Self> {
        let bins = plan.own_pieces().filter_map(|piece| Self::of_piece(plan, &piece));
        std::iter::once(Self::irradiance(plan)).chain(bins).collect()
    }

    /// The slots of bins.
    pub fn slots(&self) -> Option<&Range<u32>> {
        match self {
            Self::Irradiance { .. } => None,
            Self::Bins { slots, .. } => Some(slots),
        }
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
    /// The place of the values on the host; `None` where the state lives on the device.
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

    /// The place in another buffer that the part has in its own.
    pub fn beside<'b>(&self, buffer: &'b Buffer) -> View<'b> {
        View { buffer, offset: self.offset, bytes: self.bytes, first_slot: self.first_slot, home: None }
    }

    /// Copies the values from the same place in another buffer.
    ///
    /// # Errors
    /// Fails if the range goes beyond a buffer, or if both buffers are one.
    pub fn copy_from(&self, batch: &mut Batch, from: &'a Buffer) -> Result<(), GpuError> {
        batch.copy(from, self.offset, self.buffer, self.offset, self.bytes)
    }

    /// The buffer that the part is in.
    pub fn buffer(&self) -> &'a Buffer {
        self.buffer
    }

    /// How many reals the part has.
    pub fn reals(&self, precision: Precision) -> u32 {
        (self.bytes / precision.bytes()) as u32
    }

    /// Makes all values zero.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn clear(&self, device: &Device) -> Result<(), GpuError> {
        let mut batch = device.batch()?;
        self.fill(&mut batch)?;
        batch.defer()?;
        Ok(())
    }

    /// Records in `batch` that all values become zero.
    ///
    /// # Errors
    /// Fails if the range goes beyond the buffer.
    pub fn fill(&self, batch: &mut Batch) -> Result<(), GpuError> {
        batch.fill(self.buffer, self.offset, self.bytes, 0)
    }

    pub fn upload(&self, device: &Device, values: &[u8]) -> Result<(), GpuError> {
        device.upload(self.buffer, self.offset, values)
    }

    pub fn download(&self, device: &Device) -> Result<Vec<u8>, GpuError> {
        device.download(self.buffer, self.offset, self.bytes)
    }

    /// Copies the values back to the host, if the state lives there.
    ///
    /// # Errors
    /// Fails if the device does.
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

/// Slots of one group that this rank holds.
struct Own {
    slots: Range<u32>,
    /// Number of slots that this rank holds before these; `in_window`: in the same sweep alone.
    before: u32,
    in_window: u32,
}

/// The two windows shared by all states, and the layout of the bins on the host.
pub struct Windows {
    read: Window,
    write: Window,
    /// Slots with bins.
    slots: Range<u32>,
    /// Who holds which bins.
    distributed: Distributed,
    own: Vec<Own>,
    irradiance_bytes: u64,
}

impl Windows {
    pub fn new(device: &Device, plan: &Plan, receivers: u32, sources: u32) -> Result<Self, GpuError> {
        let (mut own, mut before) = (Vec::new(), 0);
        for sweep in plan.sweeps() {
            let first = before;
            for g in sweep.filter(|&g| plan.layout.groups[g].class.has_bins()) {
                let slots = plan.layout.slots_of(&plan.own(g).tiles);
                own.push(Own { slots: slots.clone(), before, in_window: before - first });
                before += slots.len() as u32;
            }
        }
        Ok(Self {
            own,
            distributed: Distributed::new(device, plan),
            read: Window::new(device, plan, sources)?,
            write: Window::new(device, plan, receivers)?,
            slots: plan.layout.slots_of(&plan.tiles_with_bins()),
            irradiance_bytes: plan.irradiance_bytes(),
        })
    }

    /// Index of the first of `slots` among the slots with bins.
    fn slot(&self, slots: &Range<u32>) -> Result<u32, TransportError> {
        let number = slots.start.checked_sub(self.slots.start);
        number.ok_or_else(|| TransportError::missing(format!("bins of slot {}", slots.start)))
    }

    /// How many slots' bins this rank holds.
    fn held(&self) -> u64 {
        self.own.iter().map(|own| own.slots.len() as u64).sum()
    }

    /// The range that some slots are in, if this rank holds them.
    fn own(&self, slots: &Range<u32>) -> Option<&Own> {
        self.own.iter().find(|own| own.slots.start <= slots.start && slots.end <= own.slots.end)
    }
}

/// A state on the host, byte for byte as the device would hold it.
pub struct Hosted {
    windows: Arc<Windows>,
    values: Mutex<Values>,
}

struct Values {
    irradiance: Vec<u8>,
    /// Bins of all slots that have some, and that are the rank's.
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
        let bins = windows.held() * windows.distributed.slot_bytes;
        let values = Values { irradiance: zeros(windows.irradiance_bytes)?, bins: zeros(bins)? };
        Ok(Self { windows: windows.clone(), values: Mutex::new(values) })
    }

    fn values(&self) -> MutexGuard<'_, Values> {
        self.values.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn place(&self, part: &Part) -> Result<Place, TransportError> {
        match part {
            Part::Irradiance { .. } => Ok(Place::Irradiance),
            Part::Bins { slots, .. } => self.place_of(slots),
        }
    }

    /// The bytes on the host that hold the bins of some slots of this rank.
    fn place_of(&self, slots: &Range<u32>) -> Result<Place, TransportError> {
        let slot_bytes = self.windows.distributed.slot_bytes;
        let bytes = |slots: u32| u64::from(slots) * slot_bytes;
        let first = self.windows.slot(slots)?;
        let Some(own) = self.windows.own(slots) else {
            let (begin, end) = (bytes(first), bytes(first + slots.len() as u32));
            return Err(TransportError::OutsideOfState {
                begin,
                end,
                bytes: self.windows.held() * slot_bytes,
            });
        };
        let first = own.before + slots.start - own.slots.start;
        Ok(Place::Bins(bytes(first)..bytes(first + slots.len() as u32)))
    }

    /// Copies bins that this rank holds.
    fn copy(&self, slots: &Range<u32>, values: &mut [u8]) -> Result<(), TransportError> {
        values.copy_from_slice(self.place_of(slots)?.of(&mut self.values())?);
        Ok(())
    }

    /// The part at the start of a window.
    fn view<'a>(&'a self, window: &'a Window, part: &Part) -> Result<View<'a>, TransportError> {
        let home = Some((self, self.place(part)?));
        Ok(View { home, ..Self::foreign_view(window, part)? })
    }

    /// A view in a window of a part that is not stored on the host.
    fn foreign_view<'a>(window: &'a Window, part: &Part) -> Result<View<'a>, TransportError> {
        let first_slot = match part {
            Part::Irradiance { .. } => 0,
            Part::Bins { slots, .. } => slots.start,
        };
        Ok(View { buffer: window.buffer(part)?, offset: 0, bytes: part.bytes(), first_slot, home: None })
    }

    fn bring(&self, device: &Device, view: &View, part: &Part) -> Result<(), TransportError> {
        Ok(view.upload(device, self.place(part)?.of(&mut self.values())?)?)
    }

    pub fn show(&self, device: &Device, part: &Part) -> Result<View<'_>, TransportError> {
        let Part::Bins { slots, .. } = part else { return self.read(device, part) };
        if !self.is_apart() {
            return self.read(device, part);
        }
        let view = Self::foreign_view(&self.windows.read, part)?;
        let own = |slots: &Range<u32>, values: &mut [u8]| self.copy(slots, values);
        self.windows.distributed.gather_into(device, &view, slots, own)?;
        Ok(view)
    }

    /// Whether other ranks hold bins of the state.
    pub fn is_apart(&self) -> bool {
        self.windows.distributed.ranks.count() > 1
    }

    /// See [`State::show_each`](super::state::State::show_each).
    pub fn show_each(
        &self,
        device: &Device,
        parts: &[Option<Part>],
        with: impl FnMut(usize, Option<View>, &mut dyn FnMut()) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        let window = &self.windows.read;
        let own = |slots: &Range<u32>, values: &mut [u8]| self.copy(slots, values);
        self.windows.distributed.each(device, parts, own, |part| Self::foreign_view(window, part), with)
    }

    pub fn read(&self, device: &Device, part: &Part) -> Result<View<'_>, TransportError> {
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

    /// A view in the window to write, in which the parts of a sweep are adjacent.
    ///
    /// # Errors
    /// Fails if this rank does not hold the part.
    pub fn receive(&self, part: &Part) -> Result<View<'_>, TransportError> {
        let view = self.view(&self.windows.write, part)?;
        let Part::Bins { slots, .. } = part else { return Ok(view) };
        let own = self.windows.own(slots).ok_or_else(|| TransportError::missing("a place in the window"))?;
        let within = own.in_window + slots.start - own.slots.start;
        let offset = u64::from(within) * self.windows.distributed.slot_bytes;
        Ok(View { offset, first_slot: slots.start - within, ..view })
    }

    pub fn download(&self, part: &Part) -> Result<Vec<u8>, TransportError> {
        match part {
            Part::Bins { slots, .. } if self.is_apart() => {
                self.windows.distributed.gathered(slots, |slots, values| self.copy(slots, values))
            }
            _ => Ok(self.place(part)?.of(&mut self.values())?.to_vec()),
        }
    }

    /// Sets the values of a part, of which this rank keeps its own.
    ///
    /// # Errors
    /// Fails if the part lies outside the state.
    pub fn set(&self, part: &Part, given: &[u8]) -> Result<(), TransportError> {
        let mut values = self.values();
        let Part::Bins { slots, .. } = part else {
            values.irradiance.copy_from_slice(given);
            return Ok(());
        };
        for Own { slots: own, .. } in &self.windows.own {
            let some = overlap(own, slots);
            if !some.is_empty() {
                let first = u64::from(some.start - slots.start) * self.windows.distributed.slot_bytes;
                let to = self.place_of(&some)?.of(&mut values)?;
                to.copy_from_slice(&given[first as usize..][..to.len()]);
            }
        }
        Ok(())
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
    use antirad_base::ranks::{Communicator, RankError, Ranks, in_threads};
    use antirad_gpu::DeviceOptions;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::{Duration, Instant};

    /// With two ranks, each with its bins, the next part comes while one is worked on, and all have the
    /// values of both.
    #[test]
    fn the_next_part_is_on_its_way() {
        let rank = |ranks: Ranks| {
            let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device").with_ranks(ranks);
            let plan = plan(&device, &scene());
            let windows = Arc::new(Windows::new(&device, &plan, 1, 1).expect("windows"));
            let hosted = Hosted::new(&windows).expect("a state");
            let pieces = plan.pieces();
            let parts: Vec<_> = pieces.iter().map(|piece| Part::of_piece(&plan, piece)).collect();
            let values = |part: &Part| -> Vec<u8> { (0..part.bytes()).map(|k| (k % 251) as u8).collect() };
            for part in parts.iter().flatten() {
                hosted.set(part, &values(part)).expect("a part");
            }
            let with_bins = parts.iter().flatten().count();
            assert!(with_bins > 1 && with_bins < parts.len());
            let (mut seen, mut bytes) = (0, 0);
            let all_moved = || device.ranks().moved().into_iter().sum::<u64>();
            let before = all_moved();
            let moved = || all_moved() - before;
            let work = |number: usize, view: Option<View>, go_on: &mut dyn FnMut()| {
                go_on();
                assert_eq!(view.is_some(), parts[number].is_some());
                let (Some(view), Some(part)) = (view, &parts[number]) else { return Ok(()) };
                assert!(view.download(&device)? == values(part));
                (seen, bytes) = (seen + 1, bytes + part.bytes());
                let waiting = Instant::now();
                while seen < with_bins && moved() <= bytes {
                    assert!(waiting.elapsed() < Duration::from_secs(20), "the next part does not come");
                    std::thread::yield_now();
                }
                Ok(())
            };
            hosted.show_each(&device, &parts, work).expect("all parts");
            assert_eq!((seen, moved()), (with_bins, bytes));
        };
        std::thread::scope(|scope| {
            in_threads(2).into_iter().for_each(|ranks| drop(scope.spawn(|| rank(ranks))))
        });
    }

    /// Connects two ranks, until it panics.
    struct Panicking(Arc<AtomicBool>);

    impl Communicator for Panicking {
        fn rank(&self) -> usize {
            0
        }

        fn count(&self) -> usize {
            2
        }

        fn broadcast(&self, root: usize, _: &mut [u8]) -> Result<(), RankError> {
            assert!(!self.0.load(Ordering::SeqCst), "what root {root} sends burns");
            Ok(())
        }
    }

    #[test]
    fn a_thread_that_panics_says_why() {
        let panics = Arc::new(AtomicBool::new(false));
        let ranks = Ranks::new(Panicking(panics.clone()));
        let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device").with_ranks(ranks);
        let plan = plan(&device, &scene());
        let windows = Arc::new(Windows::new(&device, &plan, 1, 1).expect("windows"));
        let hosted = Hosted::new(&windows).expect("a state");
        let parts: Vec<_> = plan.pieces().iter().map(|piece| Part::of_piece(&plan, piece)).collect();
        panics.store(true, Ordering::SeqCst);
        let error = hosted.show_each(&device, &parts, |_, _, _| Ok(())).expect_err("a panic");
        assert!(matches!(error, TransportError::Panicked { .. }), "{error}");
        assert!(error.to_string().contains("sends burns"), "{error}");
    }

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
        assert!(matches!(hosted.receive(&part(end..end + 1)), Err(TransportError::OutsideOfState { .. })));
        // Slots without bins come before the first that has some.
        let first = plan.layout.slots_of(&plan.tiles_with_bins()).start;
        assert!(first > 0);
        assert!(matches!(hosted.edit(&device, &part(0..1), false), Err(TransportError::Missing { .. })));
    }
}
