//! States as vectors, for the solvers.

use super::on_host::vectors as host;
use super::residency::{Part, View};
use super::state::State;
use super::watch::{PassMonitor, TransportError};
use super::{Context, WORKGROUP, real};
use crate::gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use crate::plan::{Plan, Residency};
use crate::scene::Precision;
use crate::shaders::{self, RealShader};
use bytemuck::{Pod, Zeroable, bytes_of};

/// `DotPush` of glsl/dot.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct DotPush {
    /// Fours of reals in each of the two vectors.
    pub count: u32,
    /// 1 to add to the sums of an earlier dispatch.
    pub add: u32,
}

/// Lanes that process a vector; each writes one partial sum.
const LANES: u32 = crate::plan::PARTIAL_SUMS as u32;
/// Reals that a lane processes at a time. Parts of states are multiples of it.
const STEP: u32 = 4;

pub struct Vectors {
    combine: Pipeline,
    dot: Pipeline,
    combine_dot: Pipeline,
    partial: Buffer,
}

impl Vectors {
    pub fn new(device: &Device, precision: Precision) -> Result<Self, GpuError> {
        let kernel = |shader: &'static RealShader, buffers: u32, push: u32| {
            Pipeline::beside_host(device, shader.of(precision), buffers, push, &[(0, WORKGROUP)], None)
        };
        let partial = u64::from(LANES) * precision.bytes();
        Ok(Self {
            combine: kernel(&shaders::COMBINE, 2, real::push_bytes(precision, 2, 1))?,
            dot: kernel(&shaders::DOT, 3, size_of::<DotPush>() as u32)?,
            combine_dot: kernel(&shaders::COMBINE_DOT, 4, real::push_bytes(precision, 2, 3))?,
            partial: Buffer::new(device, "partial sums", partial, BufferKind::Storage)?,
        })
    }

    /// y = 0.
    pub fn clear(&self, context: &Context, y: &State) -> Result<(), TransportError> {
        for parts in together(&context.plan) {
            let views = parts.iter().map(|part| y.edit(&context.device, part, false));
            let views: Vec<View> = views.collect::<Result<_, _>>()?;
            let mut batch = context.device.batch()?;
            views.iter().try_for_each(|view| view.fill(&mut batch))?;
            batch.submit()?;
            views.into_iter().try_for_each(|view| view.store(&context.device))?;
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
        for parts in together(plan) {
            let views = parts.iter().map(|part| Ok((x.read(device, part)?, y.edit(device, part, b != 0.0)?)));
            let views: Vec<(View, View)> = views.collect::<Result<_, TransportError>>()?;
            let mut batch = device.batch()?;
            for (x, y) in &views {
                if host::combine(device, precision, (a, x.own()), (b, y.own()))?.is_some() {
                    continue;
                }
                let count = y.reals(precision) / STEP;
                let push = real::push(precision, &[a, b], &[count]);
                let groups = [count.div_ceil(WORKGROUP).min(LANES / WORKGROUP), 1, 1];
                batch.dispatch(&self.combine, "vector", &[x.slice(), y.slice()], &push, groups)?;
            }
            batch.submit()?;
            views.into_iter().try_for_each(|(_, y)| y.store(device))?;
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
        let Context { device, plan, .. } = context;
        let mut on_host = true;
        for part in together(plan).into_iter().flatten() {
            let view = y.edit(device, &part, true)?;
            on_host = on_host && host::scale(device, plan.settings.precision, b, view.own())?.is_some();
            if !on_host {
                return self.combine(context, (b, y), (0.0, y), monitor);
            }
            view.store(device)?;
        }
        monitor.done(0)
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
        let mut additions = additions();
        let mut known = None;
        // Where each rank holds its own bins, the first sums up irradiance.
        let apart = plan.options.ranks > 1 && plan.residency != Residency::Device;
        let counts =
            |part: &Part| !apart || plan.options.rank == 0 || !matches!(part, Part::Irradiance { .. });
        let parts: Vec<Vec<Part>> =
            together(plan).into_iter().filter(|parts| parts.iter().all(counts)).collect();
        if parts.is_empty() {
            known = Some(0.0);
        }
        for parts in parts {
            let views = parts.iter().map(|part| Ok((x.read(device, part)?, y.edit(device, part, true)?)));
            let views: Vec<(View, View)> = views.collect::<Result<_, TransportError>>()?;
            let on_host = |(x, y): &(View, View)| host::dot(device, precision, x.own(), y.own());
            if let Some(sums) = views.iter().map(on_host).collect::<Result<Option<Vec<f64>>, _>>()? {
                known = Some(known.unwrap_or(0.0) + sums.into_iter().sum::<f64>());
                continue;
            }
            let mut batch = device.batch()?;
            for ((x, y), add) in views.iter().zip(&mut additions) {
                let push = DotPush { count: y.reals(precision) / STEP, add };
                let buffers = [x.slice(), y.slice(), self.partial.whole()];
                batch.dispatch(&self.dot, "vector", &buffers, bytes_of(&push), [LANES / WORKGROUP, 1, 1])?;
            }
            batch.submit()?;
            monitor.done(0)?;
        }
        let own = known.map_or_else(|| self.sum(context), Ok)?;
        if !apart {
            return Ok(own);
        }
        let of_all = device.ranks().each([own.to_bits()])?.into_iter();
        Ok(of_all.map(|[bits]| f64::from_bits(bits)).sum())
    }

    /// y = a x + b y; then ⟨z, y⟩, or ⟨y, y⟩ without z.
    pub fn combine_dot(
        &self,
        context: &Context,
        (a, x): (f64, &State),
        (b, y): (f64, &State),
        z: Option<&State>,
        monitor: &mut PassMonitor,
    ) -> Result<f64, TransportError> {
        let Context { device, plan, .. } = context;
        if plan.residency != Residency::Device {
            // Only one vector to read is on the device at a time.
            self.combine(context, (a, x), (b, y), monitor)?;
            return self.dot(context, z.unwrap_or(y), y, monitor);
        }
        let precision = plan.settings.precision;
        let (of_itself, z) = (z.is_none(), z.unwrap_or(y).resident()?);
        let (x, y) = (x.resident()?, y.resident()?);
        let parts = Part::all(plan);
        let on_host = |part: &Part| {
            let [x, y, z] = [x.view(part)?, y.view(part)?, z.view(part)?].map(|view| view.own());
            let z = (!of_itself).then_some(z);
            Ok::<_, TransportError>(host::combine_dot(device, precision, (a, x), (b, y), z)?)
        };
        if let Some(sums) = parts.iter().map(on_host).collect::<Result<Option<Vec<f64>>, _>>()? {
            monitor.done(0)?;
            return Ok(sums.into_iter().sum());
        }
        let mut batch = device.batch()?;
        for (part, add) in parts.iter().zip(additions()) {
            let count = (part.bytes() / precision.bytes()) as u32 / STEP;
            let push = real::push(precision, &[a, b], &[count, add, u32::from(of_itself)]);
            let buffers = [x.part(part)?, y.part(part)?, z.part(part)?, self.partial.whole()];
            batch.dispatch(&self.combine_dot, "vector", &buffers, &push, [LANES / WORKGROUP, 1, 1])?;
        }
        batch.submit()?;
        monitor.done(0)?;
        self.sum(context)
    }

    /// The sum of the partial sums.
    fn sum(&self, Context { device, plan, .. }: &Context) -> Result<f64, TransportError> {
        let partial = real::download(device, &self.partial, plan.settings.precision, LANES.into())?;
        Ok(partial.into_iter().sum())
    }
}

/// Parts of states in groups that the device can access together: on the host, parts take turns in the windows.
fn together(plan: &Plan) -> Vec<Vec<Part>> {
    match plan.residency {
        Residency::Device => vec![Part::all(plan)],
        Residency::Host { .. } => Part::own(plan).into_iter().map(|part| vec![part]).collect(),
    }
}

/// Whether the dispatch of each part adds to the sums of those before: all but the first, wherever parts are, so that not
/// a bit depends on it.
fn additions() -> impl Iterator<Item = u32> {
    std::iter::once(0).chain(std::iter::repeat(1))
}
