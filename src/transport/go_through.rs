//! J: what blockers hold back leaves their backs as antiradiance.

use super::state::{State, page_floats};
use super::{Context, WORKGROUP, bin_constants};
use crate::gpu::{Device, GpuError, Pipeline};
use crate::plan::Plan;
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};

/// `ThroughPush` of glsl/go_through.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ThroughPush {
    pub count: u32,
}

/// Workgroups of one dispatch: a lane walks over the rest.
const GROUPS: u32 = 1024;

pub struct GoThrough {
    /// Only where something blocks.
    kernel: Option<Pipeline>,
}

impl GoThrough {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let any_blocker = plan.layout.groups.iter().any(|g| g.class.blocker);
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let push = size_of::<ThroughPush>() as u32;
        let kernel = || Pipeline::new(device, &shaders::GO_THROUGH, 3, push, &constants, None);
        Ok(Self { kernel: any_blocker.then(kernel).transpose()? })
    }

    /// The antiradiance of the backs under `x`; none without.
    pub fn run(&self, context: &Context, x: Option<&State>) -> Result<(), GpuError> {
        let Context { device, plan, scene, leaving } = context;
        let Some(kernel) = &self.kernel else { return Ok(()) };
        let mut batch = device.batch()?;
        for (g, group) in plan.layout.groups.iter().enumerate() {
            let Some(antiradiance) = &leaving.antiradiance[g] else { continue };
            let floats = page_floats(plan, group);
            match x.and_then(|x| x.bins[g].as_ref()) {
                None => batch.fill(antiradiance, 0, u64::from(floats) * 4, 0)?,
                Some(arriving) => {
                    let buffers = [scene.bin_table.whole(), arriving.whole(), antiradiance.whole()];
                    let push = ThroughPush { count: floats };
                    let groups = [floats.div_ceil(WORKGROUP).min(GROUPS), 1, 1];
                    batch.dispatch(kernel, "bins to bins", &buffers, bytes_of(&push), groups)?;
                }
            }
        }
        batch.submit()?;
        Ok(())
    }
}
