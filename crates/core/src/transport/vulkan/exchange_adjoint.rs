//! Uᵀ: the cotangent of outgoing light from that of incident light.

use super::Context;
use super::adjoint::AdjointBuffers;
use super::bundle::PassMonitor;
use super::exchange::{NEAR_TAKE, PLAIN_NEAR_TAKE, shape_constants, sweep_of, sweeps};
use super::near_matrix::NearMatrix;
use super::residency::{Part, View};
use super::specular::Accumulated;
use super::state::State;
use super::sweep::{Between, Kernels, Sweep, of_partners};
use crate::plan::{Block, IncidentPart, OutgoingPart, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Plan};
use crate::shaders;
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::pairs;
use antirad_gpu::{Bindings, BufferSlice, Device, GpuError};

pub struct ExchangeAdjoint {
    sweeps: Vec<(Shape, Sweep)>,
    /// The transposed near-field matrix; `None` where close pairs are evaluated in each pass.
    near_matrix: Option<NearMatrix>,
}

impl ExchangeAdjoint {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let near_matrix = NearMatrix::transposed(device, plan)?;
        Ok(Self { sweeps: Self::kernels(device, plan)?, near_matrix })
    }

    /// Compiles the kernels of Uᵀ over pairs, by shape.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<Vec<(Shape, Sweep)>, GpuError> {
        let kernels = |shape: Shape| Kernels {
            far: match shape.any_bins() {
                true => (&shaders::TRANSPORT_BINS_ADJOINT, Bindings { storage: 7, uniform: 2 }),
                false => (&shaders::TRANSPORT_IRRADIANCE_ADJOINT, Bindings { storage: 3, uniform: 2 }),
            },
            near: plan.near_field_matrix().is_none().then_some((&shaders::NEAR_ADJOINT, 11)),
            single: shape.any_bins(),
            constants: shape_constants(shape, plan),
            take: if shape.source.has_bins() { NEAR_TAKE } else { PLAIN_NEAR_TAKE },
            gathers: u64::from(shape.receiver_bins),
            scattered: Some(u64::from(shape.source.blocker) + u64::from(shape.source.glossy)),
            slots: plan.layout.slots_where(|class| class == shape.source),
            shape: shape.name().to_owned(),
        };
        sweeps(device, plan, kernels)
    }

    /// Before the first sweep of a pass: copies the cotangent of irradiance to where kernels read it of partners.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn begin(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        x: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let plan = &context.plan;
        monitor.begin(plan.own_share(pairs(plan, false)));
        adjoint.copy_receivers(context, x)
    }

    /// Adds Uᵀ x for the sources of one sweep: the cotangents of diffuse radiance to the buffer of outgoing light, those of antiradiance
    /// and of specular radiance to `sources`.
    ///
    /// # Errors
    /// Fails if no gradients were planned, if the device fails, if another rank has ended, or if the callback
    /// stops the pass.
    pub fn run(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        x: &State,
        sources: &[Accumulated],
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let lists = plan.interactions().by_source.as_ref().ok_or(TransportError::NotPlanned)?;
        let partners = of_partners(context, &adjoint.receivers);
        let none = View::resident(&scene.no_bins, 0, 0);
        let irradiance = adjoint.receivers.whole();
        let pieces = plan.pieces();
        let parts: Vec<_> = pieces.iter().map(|piece| Part::of_piece(plan, piece)).collect();
        x.show_each(device, &parts, |number, light, go_on| {
            go_on();
            let to = &pieces[number].part;
            if let Some(light) = &light {
                let near = Some((pieces[number].group, light.slice()));
                add_near_matrix(&mut self.near_matrix, context, near, irradiance, sources, monitor)?;
            }
            let incident = light.as_ref().unwrap_or(&none).slice();
            for accumulated in sources {
                let from = plan.own(accumulated.group);
                let back = accumulated.back.as_ref().unwrap_or(&none);
                let front = accumulated.front.as_ref().unwrap_or(&none).slice();
                let shape = Shape::new(from.class, to.class);
                let sweep = sweep_of(&mut self.sweeps, shape)?;
                let (facets, radiance) = (scene.facets.whole(), outgoing.radiance.whole());
                let near = [
                    facets,
                    irradiance,
                    scene.corners.whole(),
                    radiance,
                    incident,
                    back.slice(),
                    front,
                    adjoint.near_offsets.whole(),
                    adjoint.near_receivers.whole(),
                    scene.bin_table.whole(),
                ];
                let between = Between { targets: from, partners: to, lists, first_slot: back.first_slot };
                sweep.near(context, &between, &near, true, monitor)?;
                let far = [
                    facets,
                    adjoint.far_runs.whole(),
                    radiance,
                    incident,
                    back.slice(),
                    front,
                    scene.bin_table.whole(),
                ];
                let far = if shape.any_bins() { &far[..] } else { &far[..3] };
                sweep.far(context, &between, far, &partners, PAIR_FRONT | PAIR_NEAR | PAIR_BACK, monitor)?;
            }
            Ok(())
        })?;
        add_near_matrix(&mut self.near_matrix, context, None, irradiance, sources, monitor)
    }
}

/// Adds the near field where it is kept, from the cotangents of the bins of a group or of the irradiance of all; states are on the device
/// then.
fn add_near_matrix(
    matrix: &mut Option<NearMatrix>,
    context: &Context,
    from: Option<(usize, BufferSlice)>,
    irradiance: BufferSlice,
    sources: &[Accumulated],
    monitor: &mut PassMonitor,
) -> Result<(), TransportError> {
    let Some(matrix) = matrix else { return Ok(()) };
    let of_group = |group| {
        let found = sources.iter().find(|accumulated| accumulated.group == group);
        found.ok_or_else(|| TransportError::missing(format!("bins of group {group}")))
    };
    let none = || TransportError::missing("bins of a source of the near field");
    let ends = |block: &Block| {
        let incident = match (block.incident, from) {
            (IncidentPart::Irradiance, None) => irradiance,
            (IncidentPart::Bins { group }, Some((of, incident))) if group == of => incident,
            _ => return Ok(None),
        };
        let outgoing = match block.outgoing {
            OutgoingPart::Diffuse => context.outgoing.radiance.whole(),
            OutgoingPart::Antiradiance { group } => {
                of_group(group)?.back.as_ref().map(View::slice).ok_or_else(none)?
            }
            OutgoingPart::Specular { group } => {
                of_group(group)?.front.as_ref().map(View::slice).ok_or_else(none)?
            }
        };
        Ok(Some([outgoing, incident]))
    };
    matrix.run(&context.device, ends, monitor)
}
