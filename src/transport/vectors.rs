//! States as vectors, for the solvers.

use super::state::State;
use super::{Context, WORKGROUP, real};
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::scene::Precision;
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};

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
    pub fn new(device: &Device, precision: Precision) -> Result<Self, GpuError> {
        let workgroup = [(0, WORKGROUP)];
        let combine_push = real::push_bytes(precision, 2, 1);
        let partial = u64::from(LANES) * precision.bytes();
        Ok(Self {
            combine: Pipeline::new(
                device,
                shaders::COMBINE.of(precision),
                2,
                combine_push,
                &workgroup,
                None,
            )?,
            dot: Pipeline::new(
                device,
                shaders::DOT.of(precision),
                3,
                size_of::<DotPush>() as u32,
                &workgroup,
                None,
            )?,
            partial: Buffer::new(device, "partial sums", partial, BufferKind::Storage)?,
        })
    }

    /// y = 0.
    pub fn clear(&self, context: &Context, y: &State) -> Result<(), GpuError> {
        let mut batch = context.device.batch()?;
        for (y, _, count) in y.arrays(y, &context.plan) {
            batch.fill(y, 0, u64::from(count) * context.plan.accuracy.precision.bytes(), 0)?;
        }
        batch.submit()?;
        Ok(())
    }

    /// y = a x + b y.
    pub fn combine(&self, context: &Context, a: f64, x: &State, b: f64, y: &State) -> Result<(), GpuError> {
        let mut batch = context.device.batch()?;
        for (x, y, count) in x.arrays(y, &context.plan) {
            let push = real::push(context.plan.accuracy.precision, &[a, b], &[count]);
            let groups = [count.div_ceil(WORKGROUP).min(LANES / WORKGROUP), 1, 1];
            batch.dispatch(&self.combine, "vector", &[x.whole(), y.whole()], &push, groups)?;
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
            let precision = context.plan.accuracy.precision;
            let partial = real::download(&context.device, &self.partial, precision, LANES.into())?;
            sum += partial.into_iter().sum::<f64>();
        }
        Ok(sum)
    }
}
