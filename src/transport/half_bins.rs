//! Bins of sources as bfloat16, for [`Precision::HalfBins`](crate::scene::Precision::HalfBins).

use super::{Context, WORKGROUP};
use crate::gpu::{Buffer, BufferKind, BufferSlice, Device, GpuError, Pipeline};
use crate::plan::{Group, Plan};
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};

/// `PackPush` of glsl/pack.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct PackPush {
    /// Slot of the first source, counted from the start of its page.
    pub first: u32,
}

/// Converts the bins of the sources of one dispatch to half bins; no others are held.
pub struct HalfBins {
    kernel: Pipeline,
    antiradiance: Option<Buffer>,
    specular: Option<Buffer>,
}

impl HalfBins {
    /// `None` if the plan has no half bins.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        if !plan.half_bins() {
            return Ok(None);
        }
        let any = |test: fn(&Group) -> bool| plan.layout.groups.iter().any(test);
        let buffer = || Buffer::new(device, "half bins", plan.half_bin_bytes(), BufferKind::Storage);
        Ok(Some(Self {
            kernel: Self::kernel(device, plan)?,
            antiradiance: any(|group| group.class.blocker).then(buffer).transpose()?,
            specular: any(|group| group.class.glossy).then(buffer).transpose()?,
        }))
    }

    pub fn kernel(device: &Device, plan: &Plan) -> Result<Pipeline, GpuError> {
        let constants = [&[(0, WORKGROUP)][..], &super::bin_constants(plan)].concat();
        Pipeline::new(device, &shaders::PACK, 2, size_of::<PackPush>() as u32, &constants)
    }

    /// Half bins of `part`, whose pages start at `first_slot`: of its antiradiance, if any, and its specular
    /// radiance.
    pub fn run<'a>(
        &'a self,
        context: &'a Context,
        part: &Group,
        first_slot: u32,
        antiradiance: Option<BufferSlice>,
        specular: BufferSlice,
    ) -> Result<[BufferSlice<'a>; 2], GpuError> {
        let Context { device, plan, scene, .. } = context;
        let slots = plan.layout.slots_of(&part.tiles);
        let push = PackPush { first: slots.start - first_slot };
        let groups = [(plan.bins.count() as u32).div_ceil(WORKGROUP), slots.len() as u32, 1];
        let none = scene.no_bins.whole();
        let antiradiance = antiradiance.filter(|_| part.class.blocker).zip(self.antiradiance.as_ref());
        let specular = part.class.glossy.then_some(specular).zip(self.specular.as_ref());
        let mut batch = device.batch()?;
        for (from, to) in antiradiance.iter().chain(&specular) {
            batch.dispatch(&self.kernel, "bins", &[*from, to.whole()], bytes_of(&push), groups)?;
        }
        batch.defer()?;
        Ok([antiradiance, specular].map(|halved| halved.map_or(none, |(_, to)| to.whole())))
    }
}
