//! Kᵀ, and the derivative of K with respect to specular parameters.

use super::adjoint::AdjointBuffers;
use super::lobes::LobePush;
use super::reflection::GlossyPush;
use super::residency::Part;
use super::specular::{Accumulated, Specular};
use super::state::State;
use super::{Context, WORKGROUP, bin_constants};
use crate::plan::Plan;
use crate::shaders;
use crate::transport::TransportError;
use antirad_gpu::{Bindings, Buffer, Device, GpuError, Pipeline};
use bytemuck::{Pod, Zeroable, bytes_of};

/// `ReflectAdjointPush` of crates/core/glsl/reflect_adjoint.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ReflectAdjointPush {
    /// Number of slots.
    pub count: u32,
    /// 1 to add λ₀, the loss's cotangent of irradiance, 0 not to.
    pub given: f32,
}

/// `GlossyDerivativePush` of crates/core/glsl/reflect_glossy_derivative.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GlossyDerivativePush {
    /// First slot of the page.
    pub page: u32,
    /// The first triangle, among the slots by power.
    pub list: u32,
    /// Number of triangles.
    pub count: u32,
    /// The first incident bin of this dispatch.
    pub bin_begin: u32,
    /// One past the last incident bin of this dispatch.
    pub bin_end: u32,
}

/// Workgroups of one dispatch of Kᵀ: some tens of milliseconds on a CPU.
const GLOSSY_GROUPS: u32 = 1024;
/// Pairs of bins per lane and dispatch of the derivative: lavapipe stops all loops after 65535 iterations.
const BIN_PAIRS: u32 = 1 << 14;

pub struct ReflectionAdjoint {
    diffuse: Pipeline,
    /// Kernels of Kᵀ and of the derivative, pair by pair of bins.
    glossy: Option<(Pipeline, Pipeline)>,
    /// Kernels of Kᵀ and of the derivative by matrices of lobes; `None` where no matrices are planned.
    lobes: Option<(Pipeline, Pipeline)>,
}

impl ReflectionAdjoint {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let precision = plan.settings.precision;
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let glossy = || -> Result<_, GpuError> {
            let adjoint = shaders::REFLECT_GLOSSY_ADJOINT.of(precision);
            let derivative = shaders::REFLECT_GLOSSY_DERIVATIVE.of(precision);
            let push = [size_of::<GlossyPush>() as u32, size_of::<GlossyDerivativePush>() as u32];
            Ok((
                Pipeline::new(device, adjoint, 5, push[0], &constants)?,
                Pipeline::new(device, derivative, 6, push[1], &constants)?,
            ))
        };
        let lobes = || -> Result<_, GpuError> {
            let adjoint = shaders::REFLECT_LOBES_ADJOINT.of(precision);
            let derivative = shaders::REFLECT_LOBES_DERIVATIVE.of(precision);
            let push = size_of::<LobePush>() as u32;
            let bindings = |uniform: u32| Bindings { storage: 4, uniform };
            Ok((
                Pipeline::new(device, adjoint, bindings(1), push, &constants)?,
                Pipeline::new(device, derivative, bindings(2), push, &constants)?,
            ))
        };
        let any_glossy = plan.layout.groups.iter().any(|g| g.class.glossy);
        let push = size_of::<ReflectAdjointPush>() as u32;
        let diffuse = shaders::REFLECT_ADJOINT.of(precision);
        Ok(Self {
            diffuse: Pipeline::new(device, diffuse, 4, push, &[(0, WORKGROUP)])?,
            glossy: any_glossy.then(glossy).transpose()?,
            lobes: (plan.lobes.matrices > 0).then(lobes).transpose()?,
        })
    }

    fn glossy(&self) -> Result<&(Pipeline, Pipeline), TransportError> {
        self.glossy.as_ref().ok_or_else(|| TransportError::missing("specular reflection"))
    }

    fn lobes(&self) -> Result<&(Pipeline, Pipeline), TransportError> {
        self.lobes.as_ref().ok_or_else(|| TransportError::missing("specular reflection by matrix"))
    }

    /// The irradiance of y: Kᵀ μ, plus λ₀ of the loss if `given`.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn diffuse(
        &self,
        context: &Context,
        adjoint: &AdjointBuffers,
        given: bool,
        y: &State,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let irradiance = y.edit(device, &Part::irradiance(plan), false)?;
        let slots = plan.layout.slots();
        let push = ReflectAdjointPush { count: slots, given: if given { 1.0 } else { 0.0 } };
        let mut batch = device.batch()?;
        let buffers = [
            scene.surfaces.whole(),
            outgoing.radiance.whole(),
            adjoint.irradiance.whole(),
            irradiance.slice(),
        ];
        batch.dispatch(&self.diffuse, "all", &buffers, bytes_of(&push), [slots.div_ceil(WORKGROUP), 1, 1])?;
        batch.defer()?;
        irradiance.store(device)
    }

    /// Adds Kᵀ μ of the specular radiance of this rank's triangles to their bins.
    ///
    /// # Errors
    /// Fails if the device does, or if a kernel was not planned.
    pub fn specular(&self, context: &Context, of: &Accumulated) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        let (Some(bins), Some(specular)) = (&of.back, &of.front) else { return Ok(()) };
        let slots = plan.layout.slots_of(&plan.own(of.group).tiles);
        let page = bins.first_slot;
        let (kernel, _) = self.glossy()?;
        let by_power = scene.lobes.slots(&scene.no_bins);
        let mut batch = device.batch()?;
        for product in scene.lobes.products(plan, page, &slots) {
            let (kernel, _) = self.lobes()?;
            let surfaces = scene.surfaces.whole();
            let buffers = [by_power, surfaces, specular.slice(), bins.slice(), product.transposed];
            batch.dispatch(kernel, "by matrix", &buffers, bytes_of(&product.push), product.groups())?;
        }
        let buffers =
            [scene.surfaces.whole(), scene.bin_table.whole(), specular.slice(), bins.slice(), by_power];
        let direct = scene.lobes.direct(&slots);
        let lanes = direct.len() as u32 * plan.bins.count() as u32;
        for first in (0..lanes).step_by((GLOSSY_GROUPS * WORKGROUP) as usize) {
            let count = (lanes - first).min(GLOSSY_GROUPS * WORKGROUP);
            let push = GlossyPush { page, list: direct.start, first, count };
            let groups = [count.div_ceil(WORKGROUP), 1, 1];
            batch.dispatch(kernel, "bins to bins", &buffers, bytes_of(&push), groups)?;
        }
        batch.defer()?;
        Ok(())
    }

    /// `sums` = derivatives by the specular parameters under the incident light `x`, from the current μ.
    ///
    /// # Errors
    /// Fails if the device does, if a kernel was not planned, or if another rank has ended.
    pub fn derivative(
        &self,
        context: &Context,
        adjoint: &AdjointBuffers,
        x: &State,
        sums: &Buffer,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        let mut batch = device.batch()?;
        batch.fill(sums, 0, 2 * u64::from(plan.layout.slots()) * plan.rgb_bytes(), 0)?;
        batch.defer()?;
        let bins = plan.bins.count() as u32;
        for (g, _) in plan.glossy_groups() {
            let Some(part) = Part::held(plan, g) else { continue };
            let (_, kernel) = self.glossy()?;
            let incident = x.edit(device, &part, true)?;
            let specular = adjoint.specular.show(context, Specular::Current, g)?;
            let (page, slots) = (incident.first_slot, plan.layout.slots_of(&plan.own(g).tiles));
            let by_power = scene.lobes.slots(&scene.no_bins);
            let mut batch = device.batch()?;
            for product in scene.lobes.products(plan, page, &slots) {
                let (_, kernel) = self.lobes()?;
                let (incident, specular, sums) = (incident.slice(), specular.slice(), sums.whole());
                let buffers = [by_power, incident, specular, sums, product.forward, product.logarithms];
                // A lane sums over all blocks.
                let [groups, ..] = product.groups();
                batch.dispatch(kernel, "by matrix", &buffers, bytes_of(&product.push), [groups, 1, 1])?;
            }
            let buffers = [
                scene.surfaces.whole(),
                scene.bin_table.whole(),
                incident.slice(),
                specular.slice(),
                sums.whole(),
                by_power,
            ];
            let direct = scene.lobes.direct(&slots);
            let (list, count) = (direct.start, direct.len() as u32);
            let steps = if count > 0 { 0..bins } else { 0..0 };
            let step = (BIN_PAIRS / bins).max(1);
            for bin_begin in steps.step_by(step as usize) {
                let bin_end = (bin_begin + step).min(bins);
                let push = GlossyDerivativePush { page, list, count, bin_begin, bin_end };
                let groups = [count.div_ceil(WORKGROUP), 1, 1];
                batch.dispatch(kernel, "bins to bins", &buffers, bytes_of(&push), groups)?;
            }
            batch.defer()?;
        }
        context.complete_slots(sums, 2 * plan.rgb_bytes())
    }
}
