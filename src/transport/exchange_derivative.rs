//! The derivative of ⟨λ, U L⟩ with respect to the geometry of all triangles: two passes over all pairs, one for each
//! triangle as a source and one as a receiver.

use super::Context;
use super::adjoint::{AdjointBuffers, sent, specular_of};
use super::clusters::Sources;
use super::exchange::{Shape, sweep_of};
use super::on_host::derivative::{By, Derivative};
use super::on_host::far::Sources as HostSources;
use super::on_host::far_adjoint::Receivers;
use super::reflection::Reflection;
use super::residency::{Part, View};
use super::state::State;
use super::sweep::{Between, Kernels, Sweep, of_partners};
use super::sweep_receivers::FromSources;
use super::watch::{PassMonitor, TransportError};
use crate::gpu::{Bindings, Buffer, BufferSlice, Device, GpuError, Pipeline};
use crate::model::LIST;
use crate::plan::{Group, Interactions, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Piece, Plan};
use crate::scene::Movable;
use crate::shaders;
use rayon::prelude::*;
use std::ops::Range;

/// Close partners per target and dispatch: lavapipe stops an invocation after 65535 iterations of all its loops
/// together, and a partner takes at most 16 · (1 + 45 · 17).
const NEAR_TAKE: u32 = 4;
/// The same where sources have no bins: 16 · 50 iterations.
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
            far: match (plan.clusters().is_some(), target_is_source) {
                (false, _) => (&shaders::TRANSPORT_DERIVATIVE, Bindings { storage: 8, uniform: 2 }),
                (true, true) => (&shaders::CLUSTER_DERIVATIVE_SOURCE, Bindings::from(9)),
                (true, false) => (&shaders::CLUSTER_DERIVATIVE_RECEIVER, Bindings::from(8)),
            },
            near: Some((&shaders::NEAR_DERIVATIVE, 11)),
            single: true,
            by_source: target_is_source,
            constants: [&shape.constants(plan)[..], &[(TARGET_IS_SOURCE, u32::from(target_is_source))]]
                .concat(),
            take: if shape.source.has_bins() { NEAR_TAKE } else { PLAIN_NEAR_TAKE },
            gathers: u64::from(shape.source.has_bins()) + u64::from(shape.receiver_bins),
            deposits: None,
            shape: format!("{}, by {}", shape.name(), if target_is_source { "source" } else { "receiver" }),
        };
        let sweeps = |by_source| Shape::sweeps(device, plan, |shape| kernels(shape, by_source));
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
        // With clusters, their cotangents are computed once more.
        let again = if adjoint.clusters.is_some() { Sweep::pairs_by_source(plan, true) } else { 0 };
        let pairs = Sweep::pairs(plan, true) + Sweep::pairs_by_source(plan, true) + again;
        monitor.begin(plan.own_share(pairs));
        adjoint.copy_receivers(context, cotangent)?;
        if !device.host_works() {
            self.compile(plan, movable)?;
        }
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
                    pages: [&held.part, &to.part].map(|part| plan.layout.slots_of(&part.tiles).start),
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
                    pages: [&from.part, &held].map(|part| plan.layout.slots_of(&part.tiles).start),
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
        let partners = plan.layout.slots_of(&of.other.tiles);
        let derivative = |by| Derivative {
            shape: of.shape,
            by,
            facets: scene.facets.whole(),
            corners: scene.corners.whole(),
            radiance: outgoing.radiance.whole(),
            antiradiance: of.sent[0],
            specular: of.sent[1],
            sources_page: of.pages[0],
            irradiance: of.irradiance,
            incident: of.incident,
            receivers_page: of.pages[1],
            gradients: of.gradients.whole(),
        };
        let close = derivative(match target_is_source {
            true => By::Sources(Receivers::Close { near: &lists.near, slots: partners }),
            false => By::Receivers(HostSources::Close { near: &lists.near, slots: partners }),
        });
        let (runs, tiles, tile) = (&lists.far, of.other.tiles.clone(), plan.layout.tile);
        let all = derivative(match target_is_source {
            true => By::Sources(Receivers::Tiles { runs, tiles, tile }),
            false => By::Receivers(HostSources::Tiles { runs, tiles, tile }),
        });
        for between in Between::held(plan, of.target, of.other, lists).movable_targets(plan, movable) {
            let own = plan.layout.slots_of(&between.targets.tiles);
            let blocks = own.start / LIST..own.end / LIST;
            if !close.run(sweep, context, blocks.clone(), monitor)? {
                sweep.near(context, &between, &near, true, monitor)?;
            }
            if plan.clusters().is_none() && !all.run(sweep, context, blocks, monitor)? {
                sweep.far(context, &between, &far, &uniforms, passing, monitor)?;
            }
        }
        Ok(())
    }

    /// Compiles the kernels that `movable` triangles need, side by side: drivers may take long.
    fn compile(&mut self, plan: &Plan, movable: &Movable) -> Result<(), TransportError> {
        let Interactions { by_receiver, by_source, .. } = plan.interactions();
        let by_source = by_source.as_ref().ok_or(TransportError::NotPlanned)?;
        let mut needed = Vec::new();
        for (s, from) in plan.layout.groups.iter().enumerate() {
            for (t, to) in plan.layout.groups.iter().enumerate() {
                let shape = Shape::new(from.class, to.class);
                let ends = [(&self.by_source, s, to, by_source), (&self.by_receiver, t, from, by_receiver)];
                for (sweeps, target, other, lists) in ends {
                    let sweep = sweeps.iter().find(|(known, _)| *known == shape).map(|(_, sweep)| sweep);
                    let parts = Between::held(plan, target, other, lists).movable_targets(plan, movable);
                    let kernels =
                        parts.iter().flat_map(|between| sweep.map(|sweep| sweep.kernels(plan, between)));
                    needed.extend(kernels.flatten());
                }
            }
        }
        Ok(needed.into_par_iter().try_for_each(Pipeline::compile)?)
    }

    /// Adds what the far triangles of a group and its clusters contribute where clusters stand for triangles; `sources` are both.
    pub fn listed(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        (group, sources): (usize, [&Sources; 2]),
        cotangent: &State,
        gradients: &Buffer,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let clusters = plan.clusters().ok_or_else(|| TransportError::missing("clusters"))?;
        let lists = clusters.receivers().ok_or(TransportError::NotPlanned)?;
        let own_triangles = plan.layout.slots_of(&plan.own(group).tiles);
        let irradiance = adjoint.receivers.whole();
        for piece in plan.pieces() {
            let part = Part::of_piece(plan, &piece);
            let light = part.map(|part| cotangent.show_beside(device, &part)).transpose()?;
            let incident = light.as_ref().map_or(scene.no_bins.whole(), View::slice);
            let receivers = &piece.part;
            let slots = plan.layout.slots_of(&receivers.tiles);
            for (from, own) in sources.into_iter().zip([own_triangles.clone(), plan.own_clusters(group)]) {
                let moments =
                    (from.indices.start >= clusters.first()).then(|| [clusters.first(), plan.sources()]);
                let shape = Shape::new(from.class, receivers.class);
                let buffers = |lists| {
                    [
                        scene.facets.whole(),
                        lists,
                        outgoing.radiance.whole(),
                        gradients.whole(),
                        from.antiradiance,
                        from.specular,
                        incident,
                        adjoint.receivers.whole(),
                    ]
                };
                let derivative = |by| Derivative {
                    shape,
                    by,
                    facets: scene.facets.whole(),
                    corners: scene.corners.whole(),
                    radiance: outgoing.radiance.whole(),
                    antiradiance: from.antiradiance,
                    specular: from.specular,
                    sources_page: from.indices.start,
                    irradiance,
                    incident,
                    receivers_page: slots.start,
                    gradients: gradients.whole(),
                };
                let sweep = sweep_of(&mut self.by_source, shape)?;
                let range = slots.start / LIST..slots.end / LIST;
                let onto = Receivers::Listed { lists, range, sources: own.clone(), clusters: moments };
                if !derivative(By::Sources(onto)).run(sweep, context, lists.groups(&own), monitor)? {
                    let of = FromSources {
                        sources: own,
                        bins_page: from.indices.start,
                        radiance_page: 0,
                        receivers_page: slots.start,
                        receivers: slots.clone(),
                    };
                    sweep.received(context, of, &buffers(adjoint.far_runs.whole()), monitor)?;
                }
                let sweep = sweep_of(&mut self.by_receiver, shape)?;
                let own = plan.layout.slots_of(&plan.own(piece.group).tiles);
                let blocks = own.start / LIST..own.end / LIST;
                let (lists, indices) = (clusters.sources(), from.indices.clone());
                let of = HostSources::Listed { lists, indices, clusters: moments, volumes: false };
                if !derivative(By::Receivers(of)).run(sweep, context, blocks, monitor)? {
                    let partners = (&from.indices, from.indices.start);
                    let passing = PAIR_FRONT | PAIR_NEAR | PAIR_BACK;
                    let buffers = buffers(scene.far_sources.whole());
                    sweep.listed(context, (&own, slots.start), partners, &buffers, passing, monitor)?;
                }
            }
        }
        Ok(())
    }
}

/// The light of sources, the cotangents of that of receivers, and where both begin; one of them are targets.
struct Both<'a> {
    /// The group of the targets.
    target: usize,
    shape: Shape,
    /// The others.
    other: &'a Group,
    /// Cotangent of irradiance.
    irradiance: BufferSlice<'a>,
    /// Antiradiance and specular radiance.
    sent: [BufferSlice<'a>; 2],
    /// Cotangent of bins.
    incident: BufferSlice<'a>,
    /// Slots with which the bins of sources and of receivers begin.
    pages: [u32; 2],
    gradients: &'a Buffer,
}

impl Derivative<'_> {
    /// Adds it for `blocks`; `false` where the kernel must do it.
    fn run(
        &self,
        sweep: &mut Sweep,
        context: &Context,
        blocks: Range<u32>,
        monitor: &mut PassMonitor,
    ) -> Result<bool, TransportError> {
        let Context { device, plan, .. } = context;
        let add = |blocks| self.add(device, plan, blocks);
        sweep.on_host(device, (self.by.close(), blocks), |block| self.by.pairs(block), add, monitor)
    }
}
