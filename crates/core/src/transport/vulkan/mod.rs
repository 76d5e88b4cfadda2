//! The operators of C = (1 - (K - J) U)^-1 E on a Vulkan device, one file each, of the same name as that of the CPU. Each is the host side of
//! one or two kernels in `crates/core/glsl/`.

mod adjoint;
mod bundle;
mod completion;
mod distributed;
mod exchange;
mod exchange_adjoint;
mod exchange_derivative;
mod lamp_rays;
mod lobes;
mod near_matrix;
mod observation;
mod observation_adjoint;
mod real;
mod reflection;
mod reflection_adjoint;
mod residency;
mod scene_buffers;
mod specular;
mod state;
mod sweep;
mod vectors;

pub use lamp_rays::LampRays;
pub use lobes::LobePush;
pub use near_matrix::NearMatrixPush;
pub use reflection::{GlossyPush, ReflectPush};
pub use reflection_adjoint::{GlossyDerivativePush, ReflectAdjointPush};
pub use state::State;
pub use sweep::{FarPush, NearPush};
pub use vectors::{DotPush, ProjectPush};

use super::{Adjoint, OutgoingValues, PassCallback, TransportError, Values, judged_irradiance};
use crate::plan::Plan;
use crate::solve::{LightOperator, Orthonormalised};
use crate::transport;
use adjoint::{AdjointKernels, AdjointOperator};
use antirad_base::usage::LabelReport;
use antirad_gpu::{Buffer, Device, GpuError};
use antirad_scene::{BinLayout, Precision, Scene};
use residency::Part;
use scene_buffers::SceneBuffers;
use state::Outgoing;

/// A state as one of a Vulkan device.
fn of(state: &transport::State) -> Result<&State, TransportError> {
    match &state.0 {
        Values::Vulkan(state) => Ok(state),
        _ => Err(TransportError::OtherBackend),
    }
}

/// The states as states of a Vulkan device.
fn all(states: &[transport::State]) -> Result<Vec<State>, TransportError> {
    states.iter().map(|state| of(state).cloned()).collect()
}

/// Device, plan and buffers shared by all operators.
pub(crate) struct Context {
    device: Device,
    plan: Plan,
    scene: SceneBuffers,
    outgoing: Outgoing,
}

impl Context {
    /// Downloads a buffer of one vec4 per slot.
    fn slots(&self, buffer: &Buffer) -> Result<Vec<[f64; 4]>, GpuError> {
        let count = u64::from(self.plan.layout.slots()) * 4;
        let values = real::download(&self.device, buffer, self.plan.settings.precision, 0..count)?;
        Ok(rows(&values))
    }
}

/// All operators over one planned scene, and its current outgoing light.
pub struct Operators {
    forward: Forward,
    /// Kernels and buffers of the adjoint; `None` where no gradients are planned.
    adjoint: Option<AdjointKernels>,
}

/// The operators themselves, without their transposes.
struct Forward {
    context: Context,
    pool: state::Pool,
    exchange: exchange::Exchange,
    reflection: reflection::Reflection,
    observation: observation::Observation,
    vectors: vectors::Vectors,
    monitor: bundle::PassMonitor,
}

/// Lanes of a workgroup of the kernels that don't depend on the subgroup's size.
const WORKGROUP: u32 = 64;

/// Specialization constants that say how bins are laid out (crates/core/glsl/bins.glsl).
fn bin_constants(plan: &Plan) -> [(u32, u32); 4] {
    let (concentric, rows, columns) = match plan.settings.bins {
        BinLayout::EqualAngle { theta, phi } => (0, theta, phi),
        BinLayout::Concentric { n } => (1, n, n),
    };
    [(2, concentric), (4, rows), (5, columns), (6, plan.channels)]
}

/// Compiles the kernels of U, S and the solvers, those of a kept near field included, and where the plan has gradients
/// those of K, of the transposes and of the derivatives, without a scene: for what the driver tells of them
/// ([`Device::kernel_statistics`]).
///
/// # Errors
/// Fails if the device cannot compile a kernel, or has no memory for a buffer.
pub fn compile(device: &Device, plan: &Plan) -> Result<(), GpuError> {
    exchange::Exchange::kernels(device, plan)?;
    observation::Observation::kernels(device, plan)?;
    vectors::Vectors::kernels(device, plan.settings.precision)?;
    near_matrix::NearMatrix::kernels(device, plan)?;
    lamp_rays::LampRays::kernel(device, plan.settings.precision)?;
    if !plan.options.gradients.any() {
        return Ok(());
    }
    exchange_adjoint::ExchangeAdjoint::kernels(device, plan)?;
    exchange_derivative::ExchangeDerivative::new(device, plan)?;
    reflection::Reflection::new(device, plan)?;
    reflection_adjoint::ReflectionAdjoint::new(device, plan)?;
    observation_adjoint::ObservationAdjoint::new(device, plan)?;
    Ok(())
}

impl Operators {
    /// Allocates everything that the plan counts and compiles the kernels. Triangles emit `emitted` in place of their materials' emission,
    /// W/(m² sr), and all light is counted in units of `unit`, W/(m² sr).
    ///
    /// # Errors
    /// Where the device lacks memory or a feature, or a kernel cannot be compiled.
    pub fn emitting(
        device: &Device,
        scene: &Scene,
        plan: Plan,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<Self, GpuError> {
        // Counted separately from everything else on the device, such as engines of other threads.
        let own = device.scope(plan.staging());
        let buffers = SceneBuffers::emitting(&own, scene, &plan, emitted, unit)?;
        let adjoint = AdjointKernels::new(&own, &plan)?;
        Ok(Self { forward: Forward::new(&own, plan, buffers)?, adjoint })
    }
}

impl Forward {
    fn new(device: &Device, plan: Plan, scene: SceneBuffers) -> Result<Self, GpuError> {
        if plan.settings.precision == Precision::F64 && !device.info().enabled.float64 {
            return Err(GpuError::MissingFeature {
                device: device.info().name.clone(),
                features: "shaderFloat64, without which precision \"f64\" can't be; take \"f32\"".to_owned(),
            });
        }
        Ok(Self {
            pool: state::Pool::new(device, &plan)?,
            exchange: exchange::Exchange::new(device, &plan)?,
            reflection: reflection::Reflection::new(device, &plan)?,
            observation: observation::Observation::new(device, &plan)?,
            vectors: vectors::Vectors::new(device, plan.settings.precision)?,
            // Parts of states in windows follow each other, and so do kernels and the work of the host.
            monitor: bundle::PassMonitor::new(plan.states_are_whole()),
            context: Context { outgoing: Outgoing::new(device, &plan)?, device: device.clone(), plan, scene },
        })
    }

    /// What rank 0 has found, so that solvers decide alike on all.
    fn agreed(&self, value: f64) -> Result<f64, TransportError> {
        let mut value = [value];
        self.context.device.ranks().agree(&mut value)?;
        Ok(value[0])
    }

    /// [`LightOperator::orthonormalise`]: the column, and with `judged` the irradiance of the vector, reals of all slots.
    fn orthonormal(
        &mut self,
        basis: &[State],
        y: &State,
        spanned: f64,
        judged: bool,
    ) -> Result<[Vec<f64>; 2], TransportError> {
        let Self { context, vectors, monitor, .. } = self;
        let [mut column, irradiance] = vectors.orthonormalise(context, basis, y, spanned, judged, monitor)?;
        context.device.ranks().agree(&mut column)?;
        Ok([column, irradiance])
    }

    /// [`LightOperator::judged`], by irradiance.
    fn judged_of(&self, irradiance: &[[f64; 4]]) -> Result<Vec<f64>, TransportError> {
        let Context { device, plan, .. } = &self.context;
        let mut judged = judged_irradiance(plan, irradiance);
        device.ranks().agree(&mut judged)?;
        Ok(judged)
    }

    /// Computes the outgoing light of the fronts, E + K x; where the device does not hold states whole, the diffuse part; `first_bounce`:
    /// whether with the specular reflection of lamps, which is part of what enters U but not of what S shows.
    fn update_outgoing(
        &mut self,
        x: Option<&State>,
        emission: bool,
        first_bounce: bool,
    ) -> Result<(), TransportError> {
        self.reflection.with_first_bounce = first_bounce;
        self.reflection.diffuse(&self.context, x, emission)?;
        if !self.context.plan.states_are_whole() {
            // Piece by piece, where it is read.
            return Ok(());
        }
        for piece in self.context.plan.pieces() {
            self.reflection.specular(&self.context, &piece, x, &mut self.monitor)?;
        }
        Ok(())
    }

    fn vector(&mut self) -> Result<State, TransportError> {
        let state = self.pool.take(&self.context.device, &self.context.plan)?;
        self.vectors.clear(&self.context, &state)?;
        Ok(state)
    }

    fn pass(&mut self, x: Option<&State>, emission: bool, y: &State) -> Result<(), TransportError> {
        self.reflection.with_first_bounce = emission;
        self.exchange.run(&self.context, &mut self.reflection, (x, emission), y, &mut self.monitor)
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, TransportError> {
        let product = self.vectors.dot(&self.context, x, y, &mut self.monitor)?;
        self.agreed(product)
    }

    fn combine(&mut self, x: (f64, &State), y: (f64, &State)) -> Result<(), TransportError> {
        self.vectors.combine(&self.context, x, y, &mut self.monitor)
    }

    fn accumulate(&mut self, a: &[f64], x: &[State], y: &State) -> Result<(), TransportError> {
        self.vectors.accumulate(&self.context, a, x, y, &mut self.monitor)
    }

    fn scale(&mut self, b: f64, y: &State) -> Result<(), TransportError> {
        self.vectors.scale(&self.context, b, y, &mut self.monitor)
    }

    /// Irradiance of every slot, W/m².
    fn irradiance(&self, x: &State) -> Result<Vec<[f64; 4]>, TransportError> {
        let Context { device, plan, .. } = &self.context;
        Ok(rows(&x.download(device, &Part::irradiance(plan), plan.settings.precision)?))
    }
}

impl transport::Operators for Operators {
    fn plan(&self) -> &Plan {
        &self.forward.context.plan
    }

    fn allocated(&self) -> Vec<LabelReport> {
        self.forward.context.device.scope_memory()
    }

    fn set_materials(
        &mut self,
        scene: &Scene,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene: buffers, .. } = &mut self.forward.context;
        Ok(buffers.set_materials(device, scene, plan, emitted, unit)?)
    }

    fn set_first_bounce(&mut self, values: &[Option<Vec<f64>>]) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = &self.forward.context;
        Ok(scene.set_first_bounce(device, plan, values)?)
    }

    fn set_pass_callback(&mut self, callback: Option<PassCallback>) {
        self.forward.monitor.progress.callback = callback;
    }

    fn finish(&mut self) -> Result<(), TransportError> {
        let timing = self.forward.context.device.execute_waiting()?;
        self.forward.monitor.executed(timing.wall_seconds)
    }

    fn observe(
        &mut self,
        x: &transport::State,
        camera_position: glam::DVec3,
    ) -> Result<Vec<[f64; 4]>, TransportError> {
        let Forward { context, reflection, observation, monitor, .. } = &mut self.forward;
        reflection.with_first_bounce = false;
        reflection.diffuse(context, Some(of(x)?), true)?;
        observation.run(context, reflection, of(x)?, camera_position, monitor)
    }

    fn irradiance(&self, x: &transport::State) -> Result<Vec<[f64; 4]>, TransportError> {
        self.forward.irradiance(of(x)?)
    }

    fn bins(&mut self, x: &transport::State, group: usize) -> Result<Option<Vec<f64>>, TransportError> {
        let Context { device, plan, .. } = &self.forward.context;
        let (x, part) = (of(x)?, Part::of_group(plan, group, &plan.layout.groups[group]));
        part.map(|part| x.download(device, &part, plan.settings.precision)).transpose()
    }

    fn set(
        &mut self,
        x: &mut transport::State,
        irradiance: &[[f64; 4]],
        bins: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = &self.forward.context;
        let (x, precision) = (of(x)?, plan.settings.precision);
        x.upload(device, &Part::irradiance(plan), precision, irradiance.as_flattened())?;
        for ((g, group), values) in plan.layout.groups.iter().enumerate().zip(bins) {
            if let (Some(part), Some(values)) = (Part::of_group(plan, g, group), values) {
                x.upload(device, &part, precision, values)?;
            }
        }
        Ok(())
    }

    fn fill(&mut self, x: &mut transport::State, value: f64) -> Result<(), TransportError> {
        let Context { device, plan, .. } = &self.forward.context;
        let (x, precision) = (of(x)?, plan.settings.precision);
        for part in Part::all(plan) {
            let values = vec![value; (part.bytes() / precision.bytes()) as usize];
            x.upload(device, &part, precision, &values)?;
        }
        Ok(())
    }

    fn outgoing(&mut self, x: &transport::State) -> Result<OutgoingValues, TransportError> {
        let Forward { context, reflection, monitor, .. } = &mut self.forward;
        let x = Some(of(x)?);
        reflection.with_first_bounce = true;
        let Context { device, plan, outgoing, .. } = &*context;
        reflection.diffuse(context, x, true)?;
        let mut specular: Vec<Option<Vec<f64>>> = vec![None; plan.layout.groups.len()];
        for piece in plan.pieces() {
            reflection.specular(context, &piece, x, monitor)?;
            if piece.part.class.glossy {
                let buffer = outgoing.specular_of(piece.group)?;
                let count = state::page_reals(plan, &piece.part).into();
                let values = real::download(device, buffer, plan.settings.precision, 0..count)?;
                specular[piece.group].get_or_insert_default().extend(values);
            }
        }
        Ok(OutgoingValues { radiance: context.slots(&outgoing.radiance)?, specular })
    }

    fn adjoint(&mut self) -> Result<Box<dyn Adjoint + '_>, TransportError> {
        let adjoint = self.adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        Ok(Box::new(AdjointOperator::new(&mut self.forward, adjoint)))
    }
}

/// Values of one vec4 per slot.
fn rows(values: &[f64]) -> Vec<[f64; 4]> {
    values.chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]).collect()
}

impl LightOperator for Operators {
    type Vector = transport::State;
    type Error = TransportError;

    fn vector(&mut self) -> Result<transport::State, TransportError> {
        self.forward.vector().map(|state| transport::State(Values::Vulkan(state)))
    }

    fn pass(
        &mut self,
        x: Option<&transport::State>,
        emission: bool,
        y: &mut transport::State,
    ) -> Result<(), TransportError> {
        self.forward.pass(x.map(of).transpose()?, emission, of(y)?)
    }

    fn dot(&mut self, x: &transport::State, y: &transport::State) -> Result<f64, TransportError> {
        self.forward.dot(of(x)?, of(y)?)
    }

    fn combine(
        &mut self,
        a: f64,
        x: &transport::State,
        b: f64,
        y: &mut transport::State,
    ) -> Result<(), TransportError> {
        self.forward.combine((a, of(x)?), (b, of(y)?))
    }

    fn accumulate(
        &mut self,
        a: &[f64],
        x: &[transport::State],
        y: &mut transport::State,
    ) -> Result<(), TransportError> {
        self.forward.accumulate(a, &all(x)?, of(y)?)
    }

    fn orthonormalise(
        &mut self,
        basis: &[transport::State],
        y: &mut transport::State,
        spanned: f64,
    ) -> Result<Orthonormalised, TransportError> {
        let [column, irradiance] = self.forward.orthonormal(&all(basis)?, of(y)?, spanned, true)?;
        Ok(Orthonormalised { column, judged: Some(self.forward.judged_of(&rows(&irradiance))?) })
    }

    fn scale(&mut self, b: f64, y: &mut transport::State) -> Result<(), TransportError> {
        self.forward.scale(b, of(y)?)
    }

    fn judged(&mut self, x: &transport::State) -> Result<Option<Vec<f64>>, TransportError> {
        self.forward.judged_of(&self.forward.irradiance(of(x)?)?).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{GradientRequest, PlanOptions};
    use antirad_gpu::DeviceOptions;
    use antirad_scene::{Material, SceneBuilder, Shape};
    use glam::{DAffine3, DVec3};

    /// A glossy floor, a blocker over it and a lamp over both: triangles with bins and without.
    pub fn scene() -> Scene {
        let floor = Material { specular: [0.2; 3], power: 10.0, ..Material::named("floor") };
        let lamp = Material { emission: [5.0; 3], ..Material::named("lamp") };
        let down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
        let at = |height: f64| DAffine3::from_translation(DVec3::new(0.0, height, 0.0));
        let mut builder = SceneBuilder::new();
        builder
            .shape("floor", Shape::Quad { cells: 3 }, &floor, at(0.0))
            .shape("blocker", Shape::Quad { cells: 2 }, &Material::named("blocker"), at(0.5))
            .shape("lamp", Shape::Quad { cells: 1 }, &lamp, at(1.0) * down);
        let mut scene = builder.finish("three quads").expect("a scene");
        scene.settings = scene.settings.visibility(antirad_scene::VisibilityChoice::Implicit);
        scene
    }

    pub fn plan(device: &Device, scene: &Scene) -> Plan {
        let options = PlanOptions { gradients: GradientRequest::EVERYTHING, ..PlanOptions::of(device) };
        Plan::new(scene, &options, &scene.settings).expect("a plan")
    }

    pub fn operators() -> Operators {
        let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device");
        let scene = scene();
        let plan = plan(&device, &scene);
        let emitted: Vec<_> = (0..scene.triangles.len()).map(|i| scene.material(i).emission).collect();
        Operators::emitting(&device, &scene, plan, &emitted, 1.0).expect("operators")
    }
}
