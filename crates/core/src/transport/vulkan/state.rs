//! Incident and outgoing light.

use super::distributed::{self, OnDevices};
use super::real;
use super::residency::{Hosted, Part, View, Windows};
use crate::plan::{Group, Plan, Residency};
use crate::transport::TransportError;
use antirad_gpu::{Buffer, BufferKind, BufferSlice, Device, GpuError};
use antirad_scene::Precision;
use std::sync::Arc;

/// Incident light: irradiance of every slot, and radiance per bin for the groups that have bins. Kernels access it
/// through views of its parts, wherever it lives. A handle: the memory belongs to a pool and is reused when the last
/// handle is dropped.
#[derive(Clone)]
pub struct State(Arc<Memory>);

/// The memory that holds the values of a state.
enum Memory {
    Device(StateBuffers),
    /// Buffers on the devices of several ranks, of which this one has its share.
    Devices(OnDevices),
    Host(Hosted),
}

/// The memory of a state on the device. Where several ranks hold it, this is what this one holds.
pub struct StateBuffers {
    /// E, W/m², vec4 per slot; the last component is unused and zero.
    pub irradiance: Buffer,
    /// Per group: A(b) = H(b) / c_b, W/(m² sr), reals by triangle, bin, channel. For a blocker this is also the
    /// antiradiance of the back: J is the identity on this state.
    pub bins: Vec<Option<Buffer>>,
}

/// E + K H: radiance of the fronts of every slot, and per bin. W/(m² sr).
pub struct Outgoing {
    /// Diffuse radiance of the fronts, vec4 per slot.
    pub radiance: Buffer,
    /// Per group: specular radiance of the fronts of glossy triangles. Where the device does not hold states whole, of none.
    pub specular: Vec<Option<Buffer>>,
    /// There, the specular radiance of the current piece of sources, or where states are on the host, cotangents of it.
    window: Option<Buffer>,
}

impl StateBuffers {
    fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let bytes = plan.irradiance_bytes();
        Ok(Self {
            irradiance: Buffer::new(device, "state: irradiance", bytes, BufferKind::Storage)?,
            bins: pages(device, "state: bins", plan.own_pages(|group| group.class.has_bins()))?,
        })
    }

    /// The buffer of a part, to bind to a kernel.
    ///
    /// # Errors
    /// Fails if the part has no bins.
    pub fn part(&self, part: &Part) -> Result<BufferSlice<'_>, TransportError> {
        Ok(self.view(part)?.slice())
    }

    pub fn view(&self, part: &Part) -> Result<View<'_>, TransportError> {
        match part {
            Part::Bins { group, slots, .. } => {
                Ok(View::resident(self.page(*group)?, slots.start, part.bytes()))
            }
            Part::Irradiance { .. } => Ok(View::resident(&self.irradiance, 0, part.bytes())),
        }
    }

    pub fn page(&self, group: usize) -> Result<&Buffer, TransportError> {
        page(&self.bins, group)
    }
}

impl State {
    /// The buffers of a state on the device, with what this rank holds.
    ///
    /// # Errors
    /// Fails with [`TransportError::NotResident`] if the state lives on the host.
    pub fn resident(&self) -> Result<&StateBuffers, TransportError> {
        match &*self.0 {
            Memory::Device(buffers) | Memory::Devices(OnDevices { buffers, .. }) => Ok(buffers),
            Memory::Host(_) => Err(TransportError::NotResident),
        }
    }

    /// A view for kernels to read a part, valid until another part of any state is shown. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, or if another rank has ended.
    pub fn show(&self, device: &Device, part: &Part) -> Result<View<'_>, TransportError> {
        match &*self.0 {
            Memory::Device(buffers) => buffers.view(part),
            Memory::Devices(state) => state.show(device, part),
            Memory::Host(hosted) => hosted.show(device, part),
        }
    }

    /// Calls `with` with the number and a view of each of some parts, one after the other. Where other ranks hold bins of them, those of
    /// the next part come from when `with` calls its last argument, after which it must not communicate with other ranks. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, if another rank has ended, or if `with` fails.
    pub fn show_each(
        &self,
        device: &Device,
        parts: &[Option<Part>],
        mut with: impl FnMut(usize, Option<View>, &mut dyn FnMut()) -> Result<(), TransportError>,
    ) -> Result<(), TransportError> {
        match &*self.0 {
            Memory::Host(hosted) if hosted.is_apart() => hosted.show_each(device, parts, with),
            Memory::Devices(state) => state.show_each(device, parts, with),
            _ => parts.iter().enumerate().try_for_each(|(number, part)| {
                let view = part.as_ref().map(|part| self.show(device, part)).transpose()?;
                with(number, view, &mut || {})
            }),
        }
    }

    /// A view for kernels to read a part that this rank holds, valid until another part of any state is
    /// shown. No other rank need call it.
    ///
    /// # Errors
    /// Fails if the device does, or if this rank does not hold the part.
    pub fn read(&self, device: &Device, part: &Part) -> Result<View<'_>, TransportError> {
        match &*self.0 {
            Memory::Device(buffers) | Memory::Devices(OnDevices { buffers, .. }) => buffers.view(part),
            Memory::Host(hosted) => hosted.read(device, part),
        }
    }

    /// A view in which kernels accumulate the incident light of a part, initially zero. It is valid together with the
    /// other parts of the same sweep, until a part of another sweep or state is opened. The view must be stored at
    /// the end.
    ///
    /// # Errors
    /// Fails if the device does, or if this rank does not hold the part.
    pub fn receive(&self, device: &Device, part: &Part) -> Result<View<'_>, TransportError> {
        let view = self.open(part)?;
        view.clear(device)?;
        Ok(view)
    }

    /// A view like that of [`receive`](Self::receive), but with undefined values, which the caller makes
    /// zero.
    ///
    /// # Errors
    /// Fails if this rank does not hold the part.
    pub fn open(&self, part: &Part) -> Result<View<'_>, TransportError> {
        match &*self.0 {
            Memory::Device(buffers) | Memory::Devices(OnDevices { buffers, .. }) => buffers.view(part),
            Memory::Host(hosted) => hosted.receive(part),
        }
    }

    /// A view for kernels to change a part, valid until another part of any state is opened; with `old` it holds the
    /// part's values. The view must be stored if it was changed.
    ///
    /// # Errors
    /// Fails if the device does, or if this rank does not hold the part.
    pub fn edit(&self, device: &Device, part: &Part, old: bool) -> Result<View<'_>, TransportError> {
        match &*self.0 {
            Memory::Device(buffers) | Memory::Devices(OnDevices { buffers, .. }) => buffers.view(part),
            Memory::Host(hosted) => hosted.edit(device, part, old),
        }
    }

    /// The values of a part. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, or if another rank has ended.
    pub fn download(
        &self,
        device: &Device,
        part: &Part,
        precision: Precision,
    ) -> Result<Vec<f64>, TransportError> {
        let bytes = match &*self.0 {
            Memory::Device(buffers) => buffers.view(part)?.download(device)?,
            Memory::Devices(state) => state.download(device, part)?,
            Memory::Host(hosted) => hosted.download(part)?,
        };
        Ok(real::decode(precision, &bytes))
    }

    /// Sets the values of a part.
    ///
    /// # Errors
    /// Fails if the device does, or if the part lies outside the state.
    pub fn upload(
        &self,
        device: &Device,
        part: &Part,
        precision: Precision,
        values: &[f64],
    ) -> Result<(), TransportError> {
        let values = real::encode(precision, values);
        match &*self.0 {
            Memory::Device(buffers) => Ok(buffers.view(part)?.upload(device, &values)?),
            Memory::Devices(state) => state.set(device, part, &values),
            Memory::Host(hosted) => hosted.set(part, &values),
        }
    }
}

impl Outgoing {
    /// Allocates what the plan counts; no light is computed yet.
    ///
    /// # Errors
    /// Fails if the device has no memory for a buffer.
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let label = "specular radiance";
        let buffer = |label: &str, bytes: u64| Buffer::new(device, label, bytes, BufferKind::Storage);
        let glossy = |group: &Group| group.class.glossy;
        let (specular, window) = match plan.states_are_whole() {
            true => (pages(device, label, plan.own_pages(glossy))?, None),
            false => {
                let window = || buffer(label, u64::from(plan.specular_window()) * plan.tile_bytes());
                let any = plan.layout.groups.iter().any(glossy);
                (plan.layout.groups.iter().map(|_| None).collect(), any.then(window).transpose()?)
            }
        };
        Ok(Self { radiance: buffer("radiance", plan.radiance_bytes())?, specular, window })
    }

    /// The buffer for the specular radiance of a piece of a glossy group.
    ///
    /// # Errors
    /// Fails if the group is not glossy.
    pub fn specular_of(&self, group: usize) -> Result<&Buffer, TransportError> {
        self.window.as_ref().map_or_else(|| page(&self.specular, group), Ok)
    }
}

/// Reals of one page of bins.
pub fn page_reals(plan: &Plan, group: &Group) -> u32 {
    plan.layout.slots_of(&group.tiles).len() as u32 * plan.bins.count() as u32 * plan.channels
}

/// The page of a group.
///
/// # Errors
/// Fails if the group has none.
pub fn page(pages: &[Option<Buffer>], group: usize) -> Result<&Buffer, TransportError> {
    let page = pages.get(group).and_then(Option::as_ref);
    page.ok_or_else(|| TransportError::missing(format!("bins of group {group}")))
}

/// The page to bind if the group's class has one; else `none`, which kernels of that class do not read.
///
/// # Errors
/// Fails if the group should have a page and has none.
pub fn page_of<'a>(
    pages: &'a [Option<Buffer>],
    group: usize,
    there: bool,
    none: &'a Buffer,
) -> Result<BufferSlice<'a>, TransportError> {
    Ok(if there { page(pages, group)? } else { none }.whole())
}

/// One buffer for each number of bytes; none where that is 0.
///
/// # Errors
/// Fails if the device has no memory for a buffer.
pub fn pages(
    device: &Device,
    label: &str,
    bytes: impl Iterator<Item = u64>,
) -> Result<Vec<Option<Buffer>>, GpuError> {
    let page =
        |bytes| (bytes > 0).then(|| Buffer::new(device, label, bytes, BufferKind::Storage)).transpose();
    bytes.map(page).collect()
}

/// The memory of all states. What the plan counts on the device is allocated at once.
pub struct Pool {
    states: Vec<State>,
    shared: Shared,
}

/// What all states share.
enum Shared {
    /// Nothing: the device holds states whole.
    Nothing,
    /// Windows of states on the devices of several ranks.
    OnDevices(Arc<distributed::Windows>),
    /// Windows of states on the host.
    OnHost(Arc<Windows>),
}

impl Pool {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let shared = match plan.residency {
            Residency::Device if plan.states_are_whole() => Shared::Nothing,
            Residency::Device => Shared::OnDevices(Arc::new(distributed::Windows::new(device, plan)?)),
            Residency::Host { receivers, sources } => {
                Shared::OnHost(Arc::new(Windows::new(device, plan, receivers, sources)?))
            }
        };
        let mut pool = Self { states: Vec::new(), shared };
        if plan.residency == Residency::Device {
            for _ in 0..plan.vectors() {
                pool.states.push(pool.on_device(device, plan)?);
            }
        }
        Ok(pool)
    }

    fn on_device(&self, device: &Device, plan: &Plan) -> Result<State, GpuError> {
        let buffers = StateBuffers::new(device, plan)?;
        Ok(State(Arc::new(match &self.shared {
            Shared::OnDevices(windows) => Memory::Devices(OnDevices { buffers, windows: windows.clone() }),
            _ => Memory::Device(buffers),
        })))
    }

    /// An unused state, or a new one. A new one on the device exceeds the plan: its users hold more states than it
    /// counts. The values are undefined.
    ///
    /// # Errors
    /// Fails if the device, or the host, has no memory for a new one.
    pub fn take(&mut self, device: &Device, plan: &Plan) -> Result<State, TransportError> {
        if let Some(idle) = self.states.iter().find(|state| Arc::strong_count(&state.0) == 1) {
            return Ok(idle.clone());
        }
        let state = match &self.shared {
            Shared::OnHost(windows) => State(Arc::new(Memory::Host(Hosted::new(windows)?))),
            _ => self.on_device(device, plan)?,
        };
        self.states.push(state.clone());
        Ok(state)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::operators;
    use super::*;
    use crate::solve::LightOperator;
    use crate::transport::{self, Operators};
    use antirad_scene::Movable;

    /// Kernels that read irradiance in place of bins would give plausible but wrong results.
    #[test]
    fn a_page_that_is_missing_is_an_error_not_other_light() {
        let mut operators = operators();
        let plan = operators.plan();
        let (g, group) = plan.glossy_groups().next().expect("a glossy group");
        let part = Part::of_group(plan, g, group).expect("bins");
        let device = operators.forward.context.device.clone();
        let mut buffers = StateBuffers::new(&device, plan).expect("buffers");
        buffers.bins[g] = None;
        let holed = State(Arc::new(Memory::Device(buffers)));
        let missing = |error: Option<TransportError>| {
            assert!(
                matches!(&error, Some(TransportError::Missing { what }) if what.contains("bins")),
                "{error:?}"
            );
        };
        missing(holed.show(&device, &part).err());
        missing(holed.receive(&device, &part).err());
        missing(holed.edit(&device, &part, true).err());
        missing(holed.download(&device, &part, Precision::F32).err());
        let mut holed = transport::State(transport::Values::Vulkan(holed));
        let whole = operators.vector().expect("a vector");
        let mut out = operators.vector().expect("a vector");
        missing(operators.pass(Some(&holed), true, &mut out).err());
        missing(operators.pass(Some(&whole), true, &mut holed).err());
        let mut transposed = operators.adjoint().expect("what was planned");
        transposed.pass(Some(&whole), false, &mut out).expect("a pass");
        missing(transposed.pass(Some(&holed), false, &mut out).err());
        missing(transposed.pass(Some(&whole), false, &mut holed).err());
        missing(transposed.lobe_sums(&holed).err());
        missing(transposed.geometry(&whole, &holed, &[], Some(&Movable::All)).err());
    }
}
