//! K and E: what triangles emit, and reflect of what arrives.

use super::state::{State, page_reals};
use super::{Context, WORKGROUP, bin_constants};
use crate::gpu::{Device, GpuError, Pipeline};
use crate::plan::Plan;
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};

/// `ReflectPush` of glsl/reflect.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ReflectPush {
    pub count: u32,
    pub emission: f32,
    pub reflection: f32,
}

/// `GlossyPush` of glsl/reflect_glossy.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GlossyPush {
    pub page: u32,
    pub first: u32,
    pub count: u32,
}

/// Workgroups of one dispatch of the glossy kernel: some tens of milliseconds on a CPU.
pub const GLOSSY_GROUPS: u32 = 1024;

pub struct Reflection {
    diffuse: Pipeline,
    /// Only where something is glossy.
    glossy: Option<Pipeline>,
}

impl Reflection {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let precision = plan.accuracy.precision;
        let any_glossy = plan.layout.groups.iter().any(|g| g.class.glossy);
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let glossy = || {
            Pipeline::new(
                device,
                shaders::REFLECT_GLOSSY.of(precision),
                4,
                size_of::<GlossyPush>() as u32,
                &constants,
                None,
            )
        };
        let push = size_of::<ReflectPush>() as u32;
        Ok(Self {
            diffuse: Pipeline::new(device, shaders::REFLECT.of(precision), 3, push, &[(0, WORKGROUP)], None)?,
            glossy: any_glossy.then(glossy).transpose()?,
        })
    }

    /// The radiance of the fronts under `x`, or of their emission alone.
    pub fn run(&self, context: &Context, x: Option<&State>, emission: bool) -> Result<(), GpuError> {
        let Context { device, plan, scene, leaving } = context;
        let slots = plan.layout.slots();
        let push = ReflectPush {
            count: slots,
            emission: if emission { 1.0 } else { 0.0 },
            reflection: if x.is_some() { 1.0 } else { 0.0 },
        };
        let mut batch = device.batch()?;
        // Without a state something has to be bound all the same; it is not read.
        let arriving = x.map_or(scene.no_bins.whole(), |x| x.irradiance.whole());
        let buffers = [scene.surfaces.whole(), arriving, leaving.radiance.whole()];
        batch.dispatch(&self.diffuse, "all", &buffers, bytes_of(&push), [slots.div_ceil(WORKGROUP), 1, 1])?;
        for (g, group) in plan.layout.groups.iter().enumerate() {
            let (Some(kernel), Some(specular)) = (&self.glossy, &leaving.specular[g]) else { continue };
            let reals = page_reals(plan, group);
            let Some(arriving) = x.and_then(|x| x.bins[g].as_ref()) else {
                batch.fill(specular, 0, u64::from(reals) * plan.accuracy.precision.bytes(), 0)?;
                continue;
            };
            let buffers =
                [scene.surfaces.whole(), scene.bin_table.whole(), arriving.whole(), specular.whole()];
            let bins = reals / plan.channels;
            for first in (0..bins).step_by((GLOSSY_GROUPS * WORKGROUP) as usize) {
                let count = (bins - first).min(GLOSSY_GROUPS * WORKGROUP);
                let push = GlossyPush { page: group.tiles.start * plan.layout.tile, first, count };
                let groups = [count.div_ceil(WORKGROUP), 1, 1];
                batch.dispatch(kernel, "bins to bins", &buffers, bytes_of(&push), groups)?;
            }
        }
        batch.submit()?;
        Ok(())
    }
}
