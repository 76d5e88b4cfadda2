//! The operators of C = (1 - (K - J) U)^-1 E: U (`exchange`), K (`reflection`), S (`observation`), the algebra of states (`vectors`), and
//! of each its transpose and derivative. Two implementations of one trait, `vulkan` and `cpu`, chosen when an engine is made; both
//! have an f64 twin in the crate `antirad-reference`. J needs no operator: the bins of a state hold H(b) / c_b, which is the antiradiance of a
//! blocker's back.

mod cpu;
mod pace;
mod scene_values;
mod shape;
pub mod vulkan;
mod watch;
mod work;

pub use watch::{PassCallback, TransportError};

use crate::backend::Backend;
use crate::direct::{RayScene, Tracer};
use crate::model::FacetGradient;
use crate::plan::Plan;
use crate::solve::LightOperator;
use antirad_base::usage::LabelReport;
use antirad_gpu::GpuError;
use antirad_scene::{Movable, Precision, Scene};
use glam::DVec3;
use std::sync::Arc;

/// Incident light: irradiance of every slot, and radiance per bin for the groups that have bins. It belongs to the operators that made
/// it, whose memory it holds until it is dropped.
pub struct State(Values);

/// The values of a state, by the backend and the precision that hold them.
enum Values {
    /// Buffers of a Vulkan device, or host memory that streams through windows of it.
    Vulkan(vulkan::State),
    /// Numbers in f32 on the CPU.
    Single(cpu::Vector<f32>),
    /// Numbers in f64 on the CPU.
    Double(cpu::Vector<f64>),
}

/// A copy of the outgoing light.
#[non_exhaustive]
pub struct OutgoingValues {
    /// Diffuse radiance of every slot, RGB and an unused fourth, W/(m² sr).
    pub radiance: Vec<[f64; 4]>,
    /// Specular radiance per group, by triangle, bin and channel, W/(m² sr); `None` where the group is not glossy.
    pub specular: Vec<Option<Vec<f64>>>,
}

/// Derivatives of a loss by the specular parameters of a slot, per channel: Σ_ob μ(o) lobe H(b), then Σ_ob
/// μ(o) lobe ln⟨h,n⟩ H(b).
pub type LobeSums = [DVec3; 2];

/// All operators over one planned scene. As a [`LightOperator`] it is the light equation, H = U (E + (K - J) H).
///
/// # Errors
/// All calls fail where the device does, where ranks can no longer work together, or where a callback stops them.
pub trait Operators: LightOperator<Vector = State, Error = TransportError> + Send {
    /// The plan they were made for.
    fn plan(&self) -> &Plan;

    /// Bytes that they allocated, by label.
    fn allocated(&self) -> Vec<LabelReport>;

    /// Replaces the materials, and the radiance that each triangle of the scene emits, W/(m² sr); geometry and classes stay as
    /// planned. Light is counted in units of `unit`, W/(m² sr).
    fn set_materials(&mut self, scene: &Scene, emitted: &[[f64; 3]], unit: f64)
    -> Result<(), TransportError>;

    /// Sets the radiance of lamps that glossy triangles reflect: per glossy group, by slot, bin and channel, in units of light.
    fn set_first_bounce(&mut self, values: &[Option<Vec<f64>>]) -> Result<(), TransportError>;

    /// Sets the callback of a pass, called several times a second; `None` removes it.
    fn set_pass_callback(&mut self, callback: Option<PassCallback>);

    /// Waits for the end of all work: some of a pass may be executed together with what reads its result.
    fn finish(&mut self) -> Result<(), TransportError> {
        Ok(())
    }

    /// Radiance of every slot towards `camera_position` (metres), W/(m² sr): S (E + (K - J) x), without the specular reflection of the
    /// first bounce.
    fn observe(&mut self, x: &State, camera_position: DVec3) -> Result<Vec<[f64; 4]>, TransportError>;

    /// Irradiance of every slot, W/m².
    fn irradiance(&self, x: &State) -> Result<Vec<[f64; 4]>, TransportError>;

    /// Bins of the triangles of one group, as they lie in memory: triangle, bin, channel. `None` if it has none.
    fn bins(&mut self, x: &State, group: usize) -> Result<Option<Vec<f64>>, TransportError>;

    /// Sets a state: vec4 per slot, and per group the result of [`Operators::bins`].
    fn set(
        &mut self,
        x: &mut State,
        irradiance: &[[f64; 4]],
        bins: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError>;

    /// Sets every value of a state to `value`, for measurements.
    fn fill(&mut self, x: &mut State, value: f64) -> Result<(), TransportError>;

    /// Outgoing light under `x`, emission included, W/(m² sr): diffuse radiance of every slot, and specular
    /// radiance per group, laid out like [`Operators::bins`].
    fn outgoing(&mut self, x: &State) -> Result<OutgoingValues, TransportError>;

    /// The transposed operators, of which one solve borrows all.
    ///
    /// # Errors
    /// Where no gradients were planned.
    fn adjoint(&mut self) -> Result<Box<dyn Adjoint + '_>, TransportError>;
}

/// The adjoint of the light equation, λ = λ₀ + (K - J)ᵀ (μ₀ + Uᵀ λ), as a [`LightOperator`], and what gradients are made of. Call
/// [`Adjoint::set`] first.
pub trait Adjoint: LightOperator<Vector = State, Error = TransportError> {
    /// Sets the cotangents of the loss: λ₀ of irradiance and μ₀ of radiance, per slot, and μ₀ of specular radiance
    /// per group, laid out like [`Operators::bins`].
    fn set(
        &mut self,
        irradiance: &[[f64; 4]],
        radiance: &[[f64; 4]],
        specular: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError>;

    /// Adds the cotangent of the radiance of every slot towards `camera_position` (metres).
    fn add_view(&mut self, camera_position: DVec3, colours: &[[f64; 4]]) -> Result<(), TransportError>;

    /// μ₀ of specular radiance per glossy group: that of the loss, and of the views added to it.
    fn given_specular(&mut self) -> Result<Vec<Option<Vec<f64>>>, TransportError>;

    /// μ = μ₀ + Uᵀ λ, the cotangent of outgoing light: of radiance per slot, and of specular radiance per group. It
    /// stays where it is until the next use of the operators.
    fn outgoing_cotangent(&mut self, cotangent: &State) -> Result<OutgoingValues, TransportError>;

    /// Derivatives by the specular parameters of each slot; requires [`Adjoint::outgoing_cotangent`]. `None` where
    /// nothing is glossy.
    fn lobe_sums(&mut self, x: &State) -> Result<Option<Vec<LobeSums>>, TransportError>;

    /// Per slot, the derivative of ⟨λ, U (E + (K - J) x)⟩ and of the views' ⟨colours, S (E + K x)⟩ with respect to geometry,
    /// and of the latter with respect to each camera; per unit of length of the engine. Recomputes the outgoing
    /// light. The former are those of the transport, too, of `movable` triangles at least, where these are stated.
    fn geometry(
        &mut self,
        x: &State,
        cotangent: &State,
        views: &[(DVec3, Vec<[f64; 4]>)],
        movable: Option<&Movable>,
    ) -> Result<(Vec<FacetGradient>, Vec<DVec3>), TransportError>;
}

/// The operators of a backend for a planned scene: allocates exactly the memory that the plan counts. `emitted`: what each triangle of the
/// scene emits, W/(m² sr), in place of its material's emission; light is counted in units of `unit`.
///
/// # Errors
/// Where the backend is not that of the plan, or memory is short.
pub fn operators(
    backend: &Backend,
    scene: &Scene,
    plan: Plan,
    emitted: &[[f64; 3]],
    unit: f64,
) -> Result<Box<dyn Operators>, TransportError> {
    if plan.options.backend != backend.kind() {
        return Err(TransportError::OtherBackend);
    }
    Ok(match (backend, plan.settings.precision) {
        (Backend::Vulkan(device), _) => {
            Box::new(vulkan::Operators::emitting(device, scene, plan, emitted, unit)?)
        }
        (Backend::Cpu(cpu), Precision::F32) => {
            Box::new(cpu::Operators::<f32>::new(cpu, scene, plan, emitted, unit)?)
        }
        (Backend::Cpu(cpu), Precision::F64) => {
            Box::new(cpu::Operators::<f64>::new(cpu, scene, plan, emitted, unit)?)
        }
    })
}

/// The kernel that traces rays to lamps, made for what they may meet; `None` where the host does.
pub fn tracer(
    backend: &Backend,
    plan: &Plan,
) -> Option<impl FnOnce(&RayScene) -> Result<Arc<dyn Tracer>, GpuError>> {
    let precision = plan.settings.precision;
    let device = backend.vulkan().filter(|_| plan.traces_lamps())?;
    let room = plan.lamp_rays_room();
    Some(move |scene: &RayScene| {
        Ok(Arc::new(vulkan::LampRays::new(device, precision, room, scene)?) as Arc<dyn Tracer>)
    })
}

/// [`LightOperator::judged`], by the irradiance of all slots: times the root of the area.
fn judged_irradiance(plan: &Plan, irradiance: &[[f64; 4]]) -> Vec<f64> {
    let weighted = |(h, &i): (&[f64; 4], &u32)| {
        let area = plan.facets.get(i as usize).map_or(0.0, |f| f.area);
        [h[0], h[1], h[2]].map(|h| area.sqrt() * h)
    };
    irradiance.iter().zip(&plan.layout.order).flat_map(weighted).collect()
}
