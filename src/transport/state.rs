//! What arrives and what leaves, on the device.

use crate::gpu::{Buffer, BufferKind, Device, GpuError};
use crate::plan::{Group, Plan};
use std::ops::Deref;
use std::sync::Arc;

/// What arrives: irradiance of every slot, and radiance per bin for the groups that have bins. A handle: the memory belongs to a
/// [`Pool`] and is used again when the last handle is gone.
#[derive(Clone)]
pub struct State(Arc<StateBuffers>);

/// The memory of a state.
pub struct StateBuffers {
    /// E, W/m², vec4 per slot; the last component is unused and zero.
    pub irradiance: Buffer,
    /// Per group: A(b) = H(b) / c_b, W/(m² sr), reals by triangle, bin, channel. Of a blocker it is at once what leaves
    /// the back as antiradiance: J is the identity on this state.
    pub bins: Vec<Option<Buffer>>,
}

/// E + K H: radiance of the fronts of every slot, and per bin. W/(m² sr).
pub struct Leaving {
    /// Diffuse radiance of the fronts, vec4 per slot.
    pub radiance: Buffer,
    /// Per group: specular radiance of the fronts of glossy triangles.
    pub specular: Vec<Option<Buffer>>,
}

impl Deref for State {
    type Target = StateBuffers;

    fn deref(&self) -> &StateBuffers {
        &self.0
    }
}

impl State {
    fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let bytes = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        Ok(Self(Arc::new(StateBuffers {
            irradiance: Buffer::new(device, "state: irradiance", bytes, BufferKind::Storage)?,
            bins: pages(device, plan, "state: bins", |group| group.class.has_bins())?,
        })))
    }

    /// All arrays of reals of two states, side by side, with their lengths.
    pub fn arrays<'a>(&'a self, other: &'a Self, plan: &Plan) -> Vec<(&'a Buffer, &'a Buffer, u32)> {
        let mut arrays = vec![(&self.irradiance, &other.irradiance, plan.layout.slots() * 4)];
        for ((x, y), group) in self.bins.iter().zip(&other.bins).zip(&plan.layout.groups) {
            if let (Some(x), Some(y)) = (x, y) {
                arrays.push((x, y, page_reals(plan, group)));
            }
        }
        arrays
    }
}

impl Leaving {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let bytes = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        Ok(Self {
            radiance: Buffer::new(device, "radiance", bytes, BufferKind::Storage)?,
            specular: pages(device, plan, "specular radiance", |group| group.class.glossy)?,
        })
    }
}

/// Reals of one page of bins.
pub fn page_reals(plan: &Plan, group: &Group) -> u32 {
    plan.layout.slots_of(&group.tiles).len() as u32 * plan.bins.count() as u32 * plan.channels
}

/// One buffer of bins for each group that `wanted` picks.
pub fn pages(
    device: &Device,
    plan: &Plan,
    label: &str,
    wanted: impl Fn(&Group) -> bool,
) -> Result<Vec<Option<Buffer>>, GpuError> {
    let page = |group: &Group| {
        let new = || Buffer::new(device, label, plan.page_bytes(group), BufferKind::Storage);
        wanted(group).then(new).transpose()
    };
    plan.layout.groups.iter().map(page).collect()
}

/// The memory of all states: what the plan counts is made at once.
pub struct Pool {
    states: Vec<State>,
}

impl Pool {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let states: Result<_, _> = (0..plan.vectors()).map(|_| State::new(device, plan)).collect();
        Ok(Self { states: states? })
    }

    /// A state that nobody holds, or a new one, beyond the plan, if users hold on to more than it counts. Its values
    /// are those of its last user.
    pub fn take(&mut self, device: &Device, plan: &Plan) -> Result<State, GpuError> {
        if let Some(idle) = self.states.iter().find(|state| Arc::strong_count(&state.0) == 1) {
            return Ok(idle.clone());
        }
        self.states.push(State::new(device, plan)?);
        Ok(self.states[self.states.len() - 1].clone())
    }
}
