//! The derivative of ⟨λ, U L⟩ with respect to the geometry of all triangles: two passes over all pairs, one for each
//! triangle as a source and one as a receiver.

use super::Context;
use super::adjoint::{AdjointBuffers, sent, specular_of};
use super::bundle::PassMonitor;
use super::exchange::{shape_constants, sweep_of, sweeps};
use super::reflection::Reflection;
use super::residency::{Part, View};
use super::state::State;
use super::sweep::{Between, Kernels, Sweep, of_partners};
use crate::plan::{Group, Interactions, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Piece, Plan};
use crate::shaders;
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::pairs;
use antirad_gpu::{Bindings, Buffer, BufferSlice, Device, GpuError};
use antirad_scene::Movable;

/// Close partners per target and dispatch: lavapipe stops an invocation after 65535 iterations of all its loops
/// together, and a partner takes at most 16 · (1 + 45 · 17).
const NEAR_TAKE: u32 = 4;
/// Close partners per target and dispatch where sources have no bins: 16 · 50 iterations each.
const PLAIN_NEAR_TAKE: u32 = 64;

/// Specialization constant of the kernels: whether targets are sources.
const TARGET_IS_SOURCE: u32 = 10;

pub struct ExchangeDerivative {
    by_source: Vec<(Shape, Sweep)>,
    by_receiver: Vec<(Shape, Sweep)>,
}

impl ExchangeDerivative {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let kernels = |shape: Shape, target_is_source: bool| Kernels {
            far: (&shaders::TRANSPORT_DERIVATIVE, Bindings { storage: 8, uniform: 2 }),
            near: Some((&shaders::NEAR_DERIVATIVE, 11)),
            single: true,
            constants: [
                &shape_constants(shape, plan)[..],
                &[(TARGET_IS_SOURCE, u32::from(target_is_source))],
            ]
            .concat(),
            take: if shape.source.has_bins() { NEAR_TAKE } else { PLAIN_NEAR_TAKE },
            gathers: u64::from(shape.source.has_bins()) + u64::from(shape.receiver_bins),
            scattered: None,
            slots: plan.layout.slots(),
            shape: format!("{}, by {}", shape.name(), if target_is_source { "source" } else { "receiver" }),
        };
        let sweeps = |by_source| sweeps(device, plan, |shape| kernels(shape, by_source));
        let (by_source, by_receiver) = rayon::join(|| sweeps(true), || sweeps(false));
        Ok(Self { by_source: by_source?, by_receiver: by_receiver? })
    }

    /// Adds to `gradients` the derivative of ⟨λ, U (L - J x)⟩ by the geometry, of `movable` triangles at least; L is the current outgoing
    /// light, λ the `cotangent`.
    #[expect(clippy::too_many_arguments, reason = "the operands of one formula, and what computes them")]
    pub fn run(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        reflection: &mut Reflection,
        [x, cotangent]: [&State; 2],
        gradients: &Buffer,
        movable: &Movable,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        monitor.begin(plan.own_share(2 * pairs(plan, true)));
        adjoint.copy_receivers(context, cotangent)?;
        let none = || View::resident(&scene.no_bins, 0, 0);
        let irradiance = adjoint.receivers.whole();
        for s in 0..plan.layout.groups.len() {
            let held = Piece { group: s, part: plan.own(s) };
            let light = Part::held(plan, s).map(|part| x.edit(device, &part, true)).transpose()?;
            let specular = specular_of(context, reflection, &held, light.as_ref(), monitor)?;
            let light = light.unwrap_or_else(none);
            for to in plan.pieces() {
                let part = Part::of_piece(plan, &to);
                let incident = part.map(|part| cotangent.show(device, &part)).transpose()?;
                let incident = incident.unwrap_or_else(none);
                let both = Both {
                    target: s,
                    shape: Shape::new(held.part.class, to.part.class),
                    other: &to.part,
                    irradiance,
                    sent: [light.slice(), specular],
                    incident: incident.slice(),
                    gradients,
                };
                self.between(context, adjoint, true, &both, movable, monitor)?;
            }
        }
        for t in 0..plan.layout.groups.len() {
            let held = plan.own(t);
            let incident = Part::held(plan, t).map(|part| cotangent.edit(device, &part, true)).transpose()?;
            let incident = incident.unwrap_or_else(none);
            for from in plan.pieces() {
                let both = Both {
                    target: t,
                    shape: Shape::new(from.part.class, held.class),
                    other: &from.part,
                    irradiance,
                    sent: sent(context, reflection, &from, x, monitor)?,
                    incident: incident.slice(),
                    gradients,
                };
                self.between(context, adjoint, false, &both, movable, monitor)?;
            }
        }
        Ok(())
    }

    /// Adds what depends on this rank's movable triangles of one group as sources, or as receivers, with some other triangles.
    fn between(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        target_is_source: bool,
        of: &Both,
        movable: &Movable,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { plan, scene, outgoing, .. } = context;
        let Interactions { by_receiver, by_source, .. } = plan.interactions();
        let by_source = by_source.as_ref().ok_or(TransportError::NotPlanned)?;
        let (sweeps, lists, runs) = match target_is_source {
            true => (&mut self.by_source, by_source, &adjoint.far_runs),
            false => (&mut self.by_receiver, by_receiver, &scene.far_sources),
        };
        let (offsets, partners) = match target_is_source {
            true => (&adjoint.near_offsets, &adjoint.near_receivers),
            false => (&scene.near_offsets, &scene.near_sources),
        };
        let light = if target_is_source { &adjoint.receivers } else { &outgoing.radiance };
        let uniforms = of_partners(context, light);
        let sweep = sweep_of(sweeps, of.shape)?;
        let both = [
            scene.facets.whole(),
            outgoing.radiance.whole(),
            of.irradiance,
            of.gradients.whole(),
            of.sent[0],
            of.sent[1],
            of.incident,
        ];
        let near = [&both[..], &[offsets.whole(), partners.whole(), scene.corners.whole()]].concat();
        let far = [&both[..], &[runs.whole()]].concat();
        let passing = PAIR_FRONT | PAIR_NEAR | PAIR_BACK;
        for between in Between::held(plan, of.target, of.other, lists).movable_targets(plan, movable) {
            sweep.near(context, &between, &near, true, monitor)?;
            sweep.far(context, &between, &far, &uniforms, passing, monitor)?;
        }
        Ok(())
    }
}

/// The light of sources, the cotangents of that of receivers, and where both begin; one of them are targets.
struct Both<'a> {
    /// The group of the targets.
    target: usize,
    shape: Shape,
    /// The group of the other end of the pairs.
    other: &'a Group,
    /// Cotangent of irradiance.
    irradiance: BufferSlice<'a>,
    /// Antiradiance and specular radiance.
    sent: [BufferSlice<'a>; 2],
    /// Cotangent of bins.
    incident: BufferSlice<'a>,
    gradients: &'a Buffer,
}
