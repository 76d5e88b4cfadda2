//! States as vectors, for the solvers.

use super::residency::Part;
use super::state::State;
use super::watch::{PassMonitor, TransportError};
use super::{Context, WORKGROUP, real};
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::scene::Precision;
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};

/// `DotPush` of glsl/dot.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct DotPush {
    /// Reals in each of the two vectors.
    pub count: u32,
}

/// Lanes that process a vector; each writes one partial sum.
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
    pub fn clear(&self, context: &Context, y: &State) -> Result<(), TransportError> {
        for part in Part::all(&context.plan) {
            let y = y.edit(&context.device, &part, false)?;
            y.clear(&context.device)?;
            y.store(&context.device)?;
        }
        Ok(())
    }

    /// y = a x + b y.
    pub fn combine(
        &self,
        context: &Context,
        (a, x): (f64, &State),
        (b, y): (f64, &State),
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.settings.precision;
        for part in Part::all(plan) {
            let (x, y) = (x.show(device, &part)?, y.edit(device, &part, b != 0.0)?);
            let count = y.reals(precision);
            let push = real::push(precision, &[a, b], &[count]);
            let groups = [count.div_ceil(WORKGROUP).min(LANES / WORKGROUP), 1, 1];
            let mut batch = device.batch()?;
            batch.dispatch(&self.combine, "vector", &[x.slice(), y.slice()], &push, groups)?;
            batch.submit()?;
            y.store(device)?;
            monitor.done(0)?;
        }
        Ok(())
    }

    /// y = b y, as b x + 0 y with x = y.
    pub fn scale(
        &self,
        context: &Context,
        b: f64,
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        self.combine(context, (b, y), (0.0, y), monitor)
    }

    /// ⟨x, y⟩.
    pub fn dot(
        &self,
        context: &Context,
        x: &State,
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<f64, TransportError> {
        let Context { device, plan, .. } = context;
        let precision = plan.settings.precision;
        let mut sum = 0.0;
        for part in Part::all(plan) {
            let (x, y) = (x.show(device, &part)?, y.edit(device, &part, true)?);
            let push = DotPush { count: y.reals(precision) };
            let buffers = [x.slice(), y.slice(), self.partial.whole()];
            let mut batch = device.batch()?;
            batch.dispatch(&self.dot, "vector", &buffers, bytes_of(&push), [LANES / WORKGROUP, 1, 1])?;
            batch.submit()?;
            sum += real::download(device, &self.partial, precision, LANES.into())?.into_iter().sum::<f64>();
            monitor.done(0)?;
        }
        Ok(sum)
    }
}
