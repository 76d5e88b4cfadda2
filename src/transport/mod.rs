//! The operators of C = (1 - (K - J) U)^-1 E on the device, one file each: `exchange` (U), `reflection` (K),
//! `observation` (S). J needs no kernel: the bins of a state hold H(b) / c_b, which is the antiradiance of a
//! blocker's back. Each is the host side of one or two kernels in `glsl/` and has an f64 twin in
//! [`crate::reference`].

mod adjoint;
mod apart;
mod clusters;
mod clusters_adjoint;
mod completion;
mod exchange;
mod exchange_adjoint;
mod exchange_derivative;
mod lobes;
mod near_matrix;
mod observation;
mod observation_adjoint;
mod on_host;
mod pace;
mod real;
mod reflection;
mod reflection_adjoint;
mod residency;
mod scene_buffers;
mod specular;
mod state;
mod sweep;
mod sweep_receivers;
mod vectors;
mod volumes;
mod watch;

pub use clusters::{GatherBinsPush, GatherPush};
pub use clusters_adjoint::SharesPush;
pub use lobes::LobePush;
pub use near_matrix::NearMatrixPush;
pub use pace::Pace;
pub use scene_buffers::SceneBuffers;
pub use state::{Outgoing, State};
pub use volumes::VolumePush;

pub use adjoint::{AdjointKernels, AdjointOperator, LobeSums};
pub use reflection::{GlossyPush, ReflectPush};
pub use reflection_adjoint::{GlossyDerivativePush, ReflectAdjointPush};
pub use sweep::{FarPush, ListPush, NearPush};
pub use sweep_receivers::ReceiversPush;
pub use vectors::{DotPush, ProjectPush};
pub use watch::{PassCallback, TransportError};

use crate::gpu::{Buffer, Device, GpuError};
use crate::plan::Plan;
use crate::scene::{BinLayout, Precision, Scene};
use crate::solve::{LightOperator, Orthonormalised};
use residency::Part;

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
    context: Context,
    pool: state::Pool,
    exchange: exchange::Exchange,
    reflection: reflection::Reflection,
    observation: observation::Observation,
    vectors: vectors::Vectors,
    monitor: watch::PassMonitor,
}

/// Lanes of a workgroup of the kernels that don't depend on the subgroup's size.
const WORKGROUP: u32 = 64;

/// Specialization constants that say how bins are laid out (glsl/bins.glsl).
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
pub fn compile(device: &Device, plan: &Plan) -> Result<(), GpuError> {
    exchange::Exchange::sweeps(device, plan)?;
    clusters::ClusterLight::kernels(device, plan)?;
    volumes::VolumeLight::kernels(device, plan)?;
    observation::Observation::kernels(device, plan)?;
    vectors::Vectors::kernels(device, plan.settings.precision)?;
    near_matrix::NearMatrix::kernels(device, plan)?;
    if !plan.options.gradients.any() {
        return Ok(());
    }
    exchange_adjoint::ExchangeAdjoint::sweeps(device, plan)?;
    exchange_derivative::ExchangeDerivative::new(device, plan)?;
    reflection::Reflection::new(device, plan)?;
    reflection_adjoint::ReflectionAdjoint::new(device, plan)?;
    clusters_adjoint::ClusterCotangents::kernels(device, plan)?;
    clusters_adjoint::ClusterCotangents::share_kernels(device, plan)?;
    observation_adjoint::ObservationAdjoint::new(device, plan)?;
    Ok(())
}

impl Operators {
    /// Allocates everything that the plan counts and compiles the kernels.
    pub fn new(device: &Device, plan: Plan, scene: SceneBuffers) -> Result<Self, GpuError> {
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
            monitor: watch::PassMonitor::new(plan.states_are_whole() && !device.host_works()),
            context: Context { outgoing: Outgoing::new(device, &plan)?, device: device.clone(), plan, scene },
        })
    }

    /// Replaces the materials, and the radiance that each triangle of the scene emits, W/(m² sr); geometry and classes stay as
    /// planned. Light is counted in units of `unit`, W/(m² sr).
    pub fn set_materials(&mut self, scene: &Scene, emitted: &[[f64; 3]], unit: f64) -> Result<(), GpuError> {
        let Context { device, plan, scene: buffers, .. } = &mut self.context;
        buffers.set_materials(device, scene, plan, emitted, unit)
    }

    /// Sets the radiance of lamps that glossy triangles reflect: per glossy group, by slot, bin and channel, in units of light.
    pub fn set_first_bounce(&self, values: &[Option<Vec<f64>>]) -> Result<(), GpuError> {
        self.context.scene.set_first_bounce(&self.context.device, &self.context.plan, values)
    }

    /// Waits for the end of all work: on a GPU some of a pass may be recorded alone, and executed together with what reads its result.
    pub fn finish(&mut self) -> Result<(), TransportError> {
        let timing = self.context.device.execute_waiting()?;
        self.monitor.executed(timing.wall_seconds)
    }

    /// The plan they were made for.
    pub fn plan(&self) -> &Plan {
        &self.context.plan
    }

    /// Sets the callback of a pass, called after every submission; `None` removes it.
    pub fn set_pass_callback(&mut self, callback: Option<PassCallback>) {
        self.monitor.callback = callback;
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
        let weighted = |(h, &i): (&[f64; 4], &u32)| {
            let area = plan.facets.get(i as usize).map_or(0.0, |f| f.area);
            [h[0], h[1], h[2]].map(|h| area.sqrt() * h)
        };
        let mut judged: Vec<f64> = irradiance.iter().zip(&plan.layout.order).flat_map(weighted).collect();
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

    /// Radiance of every slot towards `camera_position` (metres), W/(m² sr): S (E + (K - J) x), without the specular reflection of the
    /// first bounce.
    pub fn observe(
        &mut self,
        x: &State,
        camera_position: glam::DVec3,
    ) -> Result<Vec<[f64; 4]>, TransportError> {
        self.reflection.with_first_bounce = false;
        self.reflection.diffuse(&self.context, Some(x), true)?;
        self.observation.run(&self.context, &mut self.reflection, x, camera_position, &mut self.monitor)
    }

    /// Irradiance of every slot, W/m².
    pub fn irradiance(&self, x: &State) -> Result<Vec<[f64; 4]>, TransportError> {
        let Context { device, plan, .. } = &self.context;
        Ok(rows(&x.download(device, &Part::irradiance(plan), plan.settings.precision)?))
    }

    /// Bins of the triangles of one group, as they lie in memory: triangle, bin, channel. `None` if it has none.
    pub fn bins(&self, x: &State, group: usize) -> Result<Option<Vec<f64>>, TransportError> {
        let Context { device, plan, .. } = &self.context;
        let part = Part::of_group(plan, group, &plan.layout.groups[group]);
        part.map(|part| x.download(device, &part, plan.settings.precision)).transpose()
    }

    /// Sets a state: vec4 per slot, and per group the result of [`Operators::bins`].
    pub fn set(
        &self,
        x: &State,
        irradiance: &[[f64; 4]],
        bins: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = &self.context;
        let precision = plan.settings.precision;
        x.upload(device, &Part::irradiance(plan), precision, irradiance.as_flattened())?;
        for ((g, group), values) in plan.layout.groups.iter().enumerate().zip(bins) {
            if let (Some(part), Some(values)) = (Part::of_group(plan, g, group), values) {
                x.upload(device, &part, precision, values)?;
            }
        }
        Ok(())
    }

    /// Sets every value of a state to `value`, for measurements.
    pub fn fill(&mut self, x: &mut State, value: f64) -> Result<(), TransportError> {
        let Context { device, plan, .. } = &self.context;
        let precision = plan.settings.precision;
        for part in Part::all(plan) {
            let values = vec![value; (part.bytes() / precision.bytes()) as usize];
            x.upload(device, &part, precision, &values)?;
        }
        Ok(())
    }

    /// Outgoing light under `x`, emission included: diffuse radiance of every slot, and per group the specular
    /// radiance, laid out like [`Operators::bins`]. W/(m² sr).
    pub fn outgoing(&mut self, x: &State) -> Result<OutgoingValues, TransportError> {
        self.reflection.with_first_bounce = true;
        let Context { device, plan, outgoing, .. } = &self.context;
        self.reflection.diffuse(&self.context, Some(x), true)?;
        let mut specular: Vec<Option<Vec<f64>>> = vec![None; plan.layout.groups.len()];
        for piece in plan.pieces() {
            self.reflection.specular(&self.context, &piece, Some(x), &mut self.monitor)?;
            if piece.part.class.glossy {
                let buffer = outgoing.specular_of(piece.group)?;
                let count = state::page_reals(plan, &piece.part).into();
                let values = real::download(device, buffer, plan.settings.precision, 0..count)?;
                specular[piece.group].get_or_insert_default().extend(values);
            }
        }
        Ok(OutgoingValues { radiance: self.context.slots(&outgoing.radiance)?, specular })
    }
}

/// Values of one vec4 per slot.
fn rows(values: &[f64]) -> Vec<[f64; 4]> {
    values.chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]).collect()
}

/// A copy of the outgoing light on the host.
pub struct OutgoingValues {
    /// Diffuse radiance of every slot, RGB and an unused fourth, W/(m² sr).
    pub radiance: Vec<[f64; 4]>,
    /// Specular radiance per group, by triangle, bin and channel, W/(m² sr); `None` where the group is not glossy.
    pub specular: Vec<Option<Vec<f64>>>,
}

impl LightOperator for Operators {
    type Vector = State;
    type Error = TransportError;

    fn vector(&mut self) -> Result<State, TransportError> {
        let state = self.pool.take(&self.context.device, &self.context.plan)?;
        self.vectors.clear(&self.context, &state)?;
        Ok(state)
    }

    fn pass(&mut self, x: Option<&State>, emission: bool, y: &mut State) -> Result<(), TransportError> {
        self.reflection.with_first_bounce = emission;
        self.exchange.run(&self.context, &mut self.reflection, (x, emission), y, &mut self.monitor)
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, TransportError> {
        let product = self.vectors.dot(&self.context, x, y, &mut self.monitor)?;
        self.agreed(product)
    }

    fn combine(&mut self, a: f64, x: &State, b: f64, y: &mut State) -> Result<(), TransportError> {
        self.vectors.combine(&self.context, (a, x), (b, y), &mut self.monitor)
    }

    fn accumulate(&mut self, a: &[f64], x: &[State], y: &mut State) -> Result<(), TransportError> {
        self.vectors.accumulate(&self.context, a, x, y, &mut self.monitor)
    }

    fn orthonormalise(
        &mut self,
        basis: &[State],
        y: &mut State,
        spanned: f64,
    ) -> Result<Orthonormalised, TransportError> {
        let [column, irradiance] = self.orthonormal(basis, y, spanned, true)?;
        Ok(Orthonormalised { column, judged: Some(self.judged_of(&rows(&irradiance))?) })
    }

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), TransportError> {
        self.vectors.scale(&self.context, b, y, &mut self.monitor)
    }

    fn judged(&mut self, x: &State) -> Result<Option<Vec<f64>>, TransportError> {
        self.judged_of(&self.irradiance(x)?).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::DeviceOptions;
    use crate::plan::{GradientRequest, PlanOptions};
    use crate::scene::{Material, SceneBuilder, Shape};
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
        builder.finish("three quads").expect("a scene")
    }

    pub fn plan(device: &Device, scene: &Scene) -> Plan {
        let options = PlanOptions { gradients: GradientRequest::EVERYTHING, ..PlanOptions::of(device) };
        Plan::new(scene, &options, &scene.settings).expect("a plan")
    }

    pub fn operators() -> Operators {
        let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device");
        let scene = scene();
        let plan = plan(&device, &scene);
        let buffers = SceneBuffers::new(&device, &scene, &plan).expect("buffers");
        Operators::new(&device, plan, buffers).expect("operators")
    }

    pub fn adjoint(operators: &Operators) -> AdjointKernels {
        let Context { device, plan, .. } = &operators.context;
        AdjointKernels::new(device, plan).expect("an adjoint").expect("gradients")
    }
}
