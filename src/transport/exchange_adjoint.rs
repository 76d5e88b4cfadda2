//! Uᵀ: the cotangent of outgoing light from that of incident light.

use super::Context;
use super::adjoint::AdjointBuffers;
use super::clusters::clusters_of;
use super::completion::Values;
use super::exchange::{NEAR_TAKE, PLAIN_NEAR_TAKE, Shape, sweep_of};
use super::near_matrix::NearMatrix;
use super::on_host::far_adjoint::{BLOCK, Importance, Receivers};
use super::state::{State, StateBuffers, page, page_of};
use super::sweep::{Between, Kernels, Sweep, of_partners};
use super::sweep_receivers::FromSources;
use super::watch::{PassMonitor, TransportError};
use crate::gpu::{Bindings, BufferSlice, Device, GpuError};
use crate::model::{Class, LIST};
use crate::plan::{IncidentPart, OutgoingPart, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Plan};
use crate::shaders;
use std::ops::Range;

pub struct ExchangeAdjoint {
    sweeps: Vec<(Shape, Sweep)>,
    /// Where the near field is kept.
    near_matrix: Option<NearMatrix>,
}

impl ExchangeAdjoint {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let near_matrix = NearMatrix::transposed(device, plan)?;
        Ok(Self { sweeps: Self::sweeps(device, plan)?, near_matrix })
    }

    /// Its kernels over pairs.
    pub fn sweeps(device: &Device, plan: &Plan) -> Result<Vec<(Shape, Sweep)>, GpuError> {
        let kernels = |shape: Shape| Kernels {
            far: match shape.any_bins() {
                _ if plan.clusters().is_some() => (&shaders::CLUSTER_ADJOINT, Bindings::from(9)),
                true => (&shaders::TRANSPORT_BINS_ADJOINT, Bindings { storage: 7, uniform: 2 }),
                false => (&shaders::TRANSPORT_IRRADIANCE_ADJOINT, Bindings { storage: 3, uniform: 2 }),
            },
            near: plan.near_field_matrix().is_none().then_some((&shaders::NEAR_ADJOINT, 11)),
            single: shape.any_bins() || plan.clusters().is_some(),
            by_source: true,
            constants: shape.constants(plan),
            take: if shape.source.has_bins() { NEAR_TAKE } else { PLAIN_NEAR_TAKE },
            gathers: u64::from(shape.receiver_bins),
            deposits: u64::from(shape.source.blocker) + u64::from(shape.source.glossy),
            shape: shape.name(),
        };
        Shape::sweeps(device, plan, kernels)
    }

    /// (radiance, specular; y) += Uᵀ x: the cotangents of diffuse and specular radiance go to the buffers of outgoing
    /// light, that of antiradiance to the bins of `y`.
    pub fn run(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        x: &State,
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { plan, scene, outgoing, .. } = context;
        let (x, y) = (x.resident()?, y.resident()?);
        let lists = plan.interactions().by_source.as_ref().ok_or(TransportError::NotPlanned)?;
        monitor.begin(Sweep::pairs_by_source(plan, false) / u64::from(plan.options.ranks));
        let none = &scene.no_bins;
        adjoint.copy_receivers(context, x)?;
        let partners = of_partners(context, &adjoint.receivers);
        for (s, from) in plan.layout.groups.iter().enumerate() {
            for (t, to) in plan.layout.groups.iter().enumerate() {
                let shape = Shape::new(from.class, to.class);
                let sweep = sweep_of(&mut self.sweeps, shape)?;
                let between = Between::own(plan, s, to, lists);
                let irradiance = x.irradiance.whole();
                let incident = page_of(&x.bins, t, to.class.has_bins(), none)?;
                let back = page_of(&y.bins, s, from.class.has_bins(), none)?;
                let front = page_of(&outgoing.specular, s, from.class.glossy, none)?;
                let (facets, radiance) = (scene.facets.whole(), outgoing.radiance.whole());
                let near = [
                    facets,
                    irradiance,
                    scene.corners.whole(),
                    radiance,
                    incident,
                    back,
                    front,
                    adjoint.near_offsets.whole(),
                    adjoint.near_receivers.whole(),
                    scene.bin_table.whole(),
                ];
                let receivers = plan.layout.slots_of(&to.tiles);
                let importance = Importance {
                    shape,
                    of: Receivers::Close { near: &lists.near, slots: receivers.clone() },
                    facets,
                    corners: scene.corners.whole(),
                    irradiance,
                    incident,
                    receivers_page: receivers.start,
                    radiance,
                    radiance_page: 0,
                    back,
                    front,
                    bins_page: between.first_slot,
                    bin_table: scene.bin_table.whole(),
                };
                let own = plan.layout.slots_of(&between.targets.tiles);
                let blocks = own.start / BLOCK..own.end / BLOCK;
                if !importance.run(sweep, context, blocks.clone(), monitor)? {
                    sweep.near(context, &between, &near, true, monitor)?;
                }
                if adjoint.clusters.is_some() {
                    continue;
                }
                let importance = Importance {
                    of: Receivers::Tiles {
                        runs: &lists.far,
                        tiles: to.tiles.clone(),
                        tile: plan.layout.tile,
                    },
                    ..importance
                };
                if importance.run(sweep, context, blocks, monitor)? {
                    continue;
                }
                let far = [
                    facets,
                    adjoint.far_runs.whole(),
                    radiance,
                    incident,
                    back,
                    front,
                    scene.bin_table.whole(),
                ];
                let far = if shape.any_bins() { &far[..] } else { &far[..3] };
                sweep.far(context, &between, far, &partners, PAIR_FRONT | PAIR_NEAR | PAIR_BACK, monitor)?;
            }
        }
        if let Some(matrix) = &mut self.near_matrix {
            let incident = |part| match part {
                IncidentPart::Irradiance => Ok(x.irradiance.whole()),
                IncidentPart::Bins { group } => Ok(page(&x.bins, group)?.whole()),
            };
            let sent = |part| match part {
                OutgoingPart::Diffuse => Ok(outgoing.radiance.whole()),
                OutgoingPart::Antiradiance { group } => Ok(page(&y.bins, group)?.whole()),
                OutgoingPart::Specular { group } => Ok(page(&outgoing.specular, group)?.whole()),
            };
            matrix.run(&context.device, incident, sent, true, monitor)?;
        }
        if let Some(clusters) = &adjoint.clusters {
            for (s, from) in plan.layout.groups.iter().enumerate() {
                self.clusters(context, adjoint, s, x, monitor)?;
                let back = page_of(&y.bins, s, from.class.has_bins(), none)?;
                let front = page_of(&outgoing.specular, s, from.class.glossy, none)?;
                let page = Cotangents {
                    class: from.class,
                    sources: plan.layout.slots_of(&plan.own(s).tiles),
                    bins_page: plan.layout.slots_of(&from.tiles).start,
                    radiance: (outgoing.radiance.whole(), 0),
                    back,
                    front,
                };
                self.received(context, adjoint, x, &page, monitor)?;
                clusters.to_triangles(context, s, [back, front])?;
            }
        }
        context.complete_slots(&outgoing.radiance, plan.rgb_bytes())?;
        context.complete_pages(&outgoing.specular, |group| group.class.glossy)?;
        context.complete_pages(&y.bins, |group| group.class.has_bins())
    }

    /// The cotangents of the light of the clusters of a group, whole: with what comes through the clusters they are part of.
    pub fn clusters(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        group: usize,
        x: &StateBuffers,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Some(clusters) = &adjoint.clusters else { return Ok(()) };
        let Context { plan, scene, .. } = context;
        let (all, run) = clusters_of(plan, group)?;
        let bins = clusters.bins(run.class);
        let [back, front] = bins.map(|bins| bins.unwrap_or(&scene.no_bins).whole());
        clusters.clear(context, group)?;
        let first = all.first();
        let page = Cotangents {
            class: run.class,
            sources: plan.own_clusters(group),
            bins_page: run.range().start,
            radiance: (clusters.radiance.whole(), first),
            back,
            front,
        };
        self.received(context, adjoint, x, &page, monitor)?;
        let shares = plan.clusters_by_rank(group);
        let rgb = plan.rgb_bytes();
        let moments = Values { offset: u64::from(plan.sources() - first) * rgb, first, bytes: 3 * rgb };
        context.complete(&clusters.radiance, Values { offset: 0, first, bytes: rgb }, shares)?;
        context.complete(&clusters.radiance, moments, shares)?;
        for bins in bins.into_iter().flatten() {
            let values = Values { offset: 0, first: run.range().start, bytes: plan.bin_bytes() };
            context.complete(bins, values, shares)?;
        }
        clusters.within(context, group)
    }

    /// Adds what the light of far sources matters to all receivers.
    fn received(
        &mut self,
        context: &Context,
        adjoint: &AdjointBuffers,
        x: &StateBuffers,
        to: &Cotangents,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { plan, scene, .. } = context;
        for (t, receivers) in plan.layout.groups.iter().enumerate() {
            let sweep = sweep_of(&mut self.sweeps, Shape::new(to.class, receivers.class))?;
            let slots = plan.layout.slots_of(&receivers.tiles);
            let incident = page_of(&x.bins, t, receivers.class.has_bins(), &scene.no_bins)?;
            if let Some((clusters, lists)) = plan.clusters().and_then(|all| Some((all, all.receivers()?))) {
                let first = clusters.first();
                let moments = (to.sources.start >= first).then(|| [first, plan.sources() - to.radiance.1]);
                let range = slots.start / LIST..slots.end / LIST;
                let sources = to.sources.clone();
                let groups = lists.groups(&sources);
                let importance = Importance {
                    shape: Shape::new(to.class, receivers.class),
                    of: Receivers::Listed { lists, range, sources, clusters: moments },
                    facets: scene.facets.whole(),
                    corners: scene.corners.whole(),
                    irradiance: x.irradiance.whole(),
                    incident,
                    receivers_page: slots.start,
                    radiance: to.radiance.0,
                    radiance_page: to.radiance.1,
                    back: to.back,
                    front: to.front,
                    bins_page: to.bins_page,
                    bin_table: scene.bin_table.whole(),
                };
                if importance.run(sweep, context, groups, monitor)? {
                    continue;
                }
            }
            let far = [
                scene.facets.whole(),
                adjoint.far_runs.whole(),
                to.radiance.0,
                incident,
                to.back,
                to.front,
                scene.bin_table.whole(),
                adjoint.receivers.whole(),
            ];
            let of = FromSources {
                sources: to.sources.clone(),
                bins_page: to.bins_page,
                radiance_page: to.radiance.1,
                receivers_page: slots.start,
                receivers: slots,
            };
            sweep.received(context, of, &far, monitor)?;
        }
        Ok(())
    }
}

/// Where the cotangents of sources of one class go: of radiance, with the first index of its page, and of bins, from the
/// index `bins_page` on.
struct Cotangents<'a> {
    class: Class,
    sources: Range<u32>,
    bins_page: u32,
    radiance: (BufferSlice<'a>, u32),
    back: BufferSlice<'a>,
    front: BufferSlice<'a>,
}

impl Importance<'_> {
    /// Adds it for `blocks` of sources; `false` where the kernel must do it.
    fn run(
        &self,
        sweep: &mut Sweep,
        context: &Context,
        blocks: Range<u32>,
        monitor: &mut PassMonitor,
    ) -> Result<bool, TransportError> {
        let Context { device, plan, .. } = context;
        let add = |blocks| self.add(device, plan, blocks);
        let close = matches!(self.of, Receivers::Close { .. });
        sweep.on_host(device, (close, blocks), |block| self.of.pairs(block), add, monitor)
    }
}
