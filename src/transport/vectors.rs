//! States as vectors, for the solvers.

use super::state::State;
use super::{Context, WORKGROUP};
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};

/// `Push` of glsl/combine.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct CombinePush {
    pub count: u32,
    pub a: f32,
    pub b: f32,
}

/// `DotPush` of glsl/dot.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct DotPush {
    pub count: u32,
}

/// Lanes that share a vector between them; each leaves one partial sum.
const LANES: u32 = crate::plan::PARTIAL_SUMS as u32;

pub struct Vectors {
    combine: Pipeline,
    dot: Pipeline,
    partial: Buffer,
}

impl Vectors {
    pub fn new(device: &Device) -> Result<Self, GpuError> {
        let workgroup = [(0, WORKGROUP)];
        let combine_push = size_of::<CombinePush>() as u32;
        Ok(Self {
            combine: Pipeline::new(device, &shaders::COMBINE, 2, combine_push, &workgroup, None)?,
            dot: Pipeline::new(device, &shaders::DOT, 3, size_of::<DotPush>() as u32, &workgroup, None)?,
            partial: Buffer::new(device, "partial sums", u64::from(LANES) * 4, BufferKind::Storage)?,
        })
    }

    /// y = value, everywhere.
    pub fn fill(&self, context: &Context, y: &State, value: f32) -> Result<(), GpuError> {
        let mut batch = context.device.batch()?;
        for (y, _, count) in y.arrays(y, &context.plan) {
            batch.fill(y, 0, u64::from(count) * 4, value.to_bits())?;
        }
        batch.submit()?;
        Ok(())
    }

    /// y = a x + b y.
    pub fn combine(&self, context: &Context, a: f64, x: &State, b: f64, y: &State) -> Result<(), GpuError> {
        let mut batch = context.device.batch()?;
        for (x, y, count) in x.arrays(y, &context.plan) {
            let push = CombinePush { count, a: a as f32, b: b as f32 };
            let groups = [count.div_ceil(WORKGROUP).min(LANES / WORKGROUP), 1, 1];
            batch.dispatch(&self.combine, "vector", &[x.whole(), y.whole()], bytes_of(&push), groups)?;
        }
        batch.submit()?;
        Ok(())
    }

    /// y = b y: as b x + 0 y with y in both places.
    pub fn scale(&self, context: &Context, b: f64, y: &State) -> Result<(), GpuError> {
        self.combine(context, b, y, 0.0, y)
    }

    /// ⟨x, y⟩.
    pub fn dot(&self, context: &Context, x: &State, y: &State) -> Result<f64, GpuError> {
        let mut sum = 0.0;
        for (x, y, count) in x.arrays(y, &context.plan) {
            let mut batch = context.device.batch()?;
            let buffers = [x.whole(), y.whole(), self.partial.whole()];
            let push = DotPush { count };
            batch.dispatch(&self.dot, "vector", &buffers, bytes_of(&push), [LANES / WORKGROUP, 1, 1])?;
            batch.submit()?;
            let partial: Vec<f32> = context.device.download_slice(&self.partial, 0, LANES.into())?;
            sum += partial.into_iter().map(f64::from).sum::<f64>();
        }
        Ok(sum)
    }
}
