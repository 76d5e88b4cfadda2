//! S: the radiance that each triangle sends to a camera.

use super::{Context, WORKGROUP, bin_constants};
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::plan::Plan;
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};
use glam::DVec3;

/// `ObservePush` of glsl/observe.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ObservePush {
    pub eye: [f32; 3],
    pub begin: u32,
    pub end: u32,
}

pub struct Observation {
    /// Of diffuse triangles, and of glossy ones.
    kernels: [Pipeline; 2],
    /// vec4 per slot.
    colours: Buffer,
}

impl Observation {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let kernel = |glossy: u32| {
            let constants = [&[(0, WORKGROUP), (8, glossy)][..], &bin_constants(plan)].concat();
            Pipeline::new(device, &shaders::OBSERVE, 5, size_of::<ObservePush>() as u32, &constants, None)
        };
        let bytes = u64::from(plan.layout.slots()) * 16;
        Ok(Self {
            kernels: [kernel(0)?, kernel(1)?],
            colours: Buffer::new(device, "face colours", bytes, BufferKind::Storage)?,
        })
    }

    /// RGB of every slot towards `eye`, which is in metres. W/(m² sr).
    pub fn run(&self, context: &Context, eye: DVec3) -> Result<Vec<[f32; 4]>, GpuError> {
        let Context { device, plan, scene, leaving } = context;
        let eye = plan.placement.apply(eye).as_vec3().to_array();
        let mut batch = device.batch()?;
        for (g, group) in plan.layout.groups.iter().enumerate() {
            let slots = plan.layout.slots_of(&group.tiles);
            let buffers = [
                scene.facets.whole(),
                leaving.radiance.whole(),
                scene.no_bins.whole(),
                leaving.specular[g].as_ref().unwrap_or(&scene.no_bins).whole(),
                self.colours.whole(),
            ];
            let push = ObservePush { eye, begin: slots.start, end: slots.end };
            let kernel = &self.kernels[usize::from(group.class.glossy)];
            let groups = [(slots.len() as u32).div_ceil(WORKGROUP), 1, 1];
            batch.dispatch(kernel, "all", &buffers, bytes_of(&push), groups)?;
        }
        batch.submit()?;
        device.download_slice(&self.colours, 0, plan.layout.slots().into())
    }
}
