//! U: light from every triangle to every other.

use super::bundle::PassMonitor;
use super::clusters::{ClusterLight, Sources as ClusterSources};
use super::near_matrix::NearMatrix;
use super::reflection::Reflection;
use super::residency::{Part, View};
use super::state::State;
use super::sweep::{Between, Kernels, Sweep, of_partners};
use super::volumes::VolumeLight;
use super::{Context, bin_constants};
use crate::gpu::{Bindings, BufferSlice, Device, GpuError};
use crate::plan::{Block, Group, IncidentPart, OutgoingPart, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Plan};
use crate::shaders;
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::{far_pairs, pairs};
use rayon::prelude::*;

/// Close sources per receiver and dispatch: lavapipe bounds the iterations of all loops of an invocation together by
/// 65535, and one source takes at most 1 + 16 · (20 + 16 · 19).
pub const NEAR_TAKE: u32 = 8;
/// The same where sources have no bins and need no second level: 1 + 16 · 20 iterations.
pub const PLAIN_NEAR_TAKE: u32 = 128;

/// Specialization constants of the kernels of a shape.
pub fn shape_constants(shape: Shape, plan: &Plan) -> Vec<(u32, u32)> {
    let (blocker, glossy) = (u32::from(shape.source.blocker), u32::from(shape.source.glossy));
    let own = [(7, blocker), (8, glossy), (9, u32::from(shape.receiver_bins))];
    [&own[..], &bin_constants(plan)].concat()
}

/// One sweep for each shape that occurs.
pub fn sweeps(
    device: &Device,
    plan: &Plan,
    kernels: impl Fn(Shape) -> Kernels<'static> + Sync,
) -> Result<Vec<(Shape, Sweep)>, GpuError> {
    // Drivers may take long to compile their kernels.
    let sweep = |shape| Ok((shape, Sweep::new(device, plan, kernels(shape))?));
    Shape::all(plan).into_par_iter().map(sweep).collect()
}

/// The sweep of a shape.
pub fn sweep_of(sweeps: &mut [(Shape, Sweep)], shape: Shape) -> Result<&mut Sweep, TransportError> {
    let sweep = sweeps.iter_mut().find(|(known, _)| *known == shape).map(|(_, sweep)| sweep);
    sweep.ok_or_else(|| TransportError::missing(format!("a kernel from {}", shape.name())))
}

pub struct Exchange {
    sweeps: Vec<(Shape, Sweep)>,
    /// Where the near field is kept.
    near_matrix: Option<NearMatrix>,
    /// Where clusters stand for far triangles.
    pub(super) clusters: Option<ClusterLight>,
    volumes: Option<VolumeLight>,
}

impl Exchange {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        Ok(Self {
            sweeps: Self::kernels(device, plan)?,
            near_matrix: NearMatrix::forward(device, plan)?,
            clusters: ClusterLight::new(device, plan)?,
            volumes: VolumeLight::new(device, plan)?,
        })
    }

    /// Its kernels over pairs.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<Vec<(Shape, Sweep)>, GpuError> {
        let kernels = |shape: Shape| Kernels {
            far: match (shape.any_bins(), plan.clusters().is_some()) {
                (true, false) => (&shaders::TRANSPORT_BINS, Bindings { storage: 7, uniform: 2 }),
                (false, false) => (&shaders::TRANSPORT_IRRADIANCE, Bindings { storage: 3, uniform: 2 }),
                (true, true) => (&shaders::CLUSTER_BINS, Bindings::from(8)),
                (false, true) => (&shaders::CLUSTER_IRRADIANCE, Bindings::from(4)),
            },
            near: plan.near_field_matrix().is_none().then_some((&shaders::NEAR, 11)),
            single: shape.any_bins(),
            by_source: false,
            constants: shape_constants(shape, plan),
            take: if shape.source.has_bins() { NEAR_TAKE } else { PLAIN_NEAR_TAKE },
            gathers: u64::from(shape.source.has_bins()),
            deposits: Some(u64::from(shape.receiver_bins)),
            shape: shape.name().to_owned(),
        };
        sweeps(device, plan, kernels)
    }

    /// y = U (E + (K - J) x) with `emission`, y = U (K - J) x without; without `x` there is only emission.
    pub fn run(
        &mut self,
        context: &Context,
        reflection: &mut Reflection,
        (x, emission): (Option<&State>, bool),
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        monitor.begin(plan.own_share(pairs(plan, false)));
        let backs = x.is_some();
        let passing = PAIR_FRONT | PAIR_NEAR | if backs { PAIR_BACK } else { 0 };
        let none = || View::resident(&scene.no_bins, 0, 0);
        let (facets, radiance) = (scene.facets.whole(), outgoing.radiance.whole());
        let partners = of_partners(context, &outgoing.radiance);
        let irradiance = y.open(&Part::irradiance(plan))?;
        let pieces = plan.pieces();
        let mut first_sweep = true;
        if let Some(volumes) = &self.volumes {
            volumes.clear(context)?;
        }
        for (number, groups) in plan.sweeps().into_iter().enumerate() {
            let mut receivers = Vec::new();
            // What the sweep begins with, in one submission.
            let mut batch = device.batch()?;
            if number == 0 {
                reflection.record_diffuse(context, x, emission, &mut batch)?;
                irradiance.fill(&mut batch)?;
            }
            for t in groups {
                let incident = Part::held(plan, t).map(|part| y.open(&part)).transpose()?;
                if let Some(incident) = &incident {
                    incident.fill(&mut batch)?;
                }
                receivers.push((plan.own(t), incident.unwrap_or_else(none)));
            }
            batch.defer()?;
            let mut wanted = Vec::new();
            for piece in &pieces {
                let from = &piece.part;
                let reached = |to: &Group| plan.anything_passes(&to.tiles, &from.tiles);
                let (lit, culled): (Vec<_>, Vec<_>) = receivers.iter().partition(|(to, _)| reached(to));
                for (to, _) in culled {
                    monitor.done(far_pairs(plan, to, from))?;
                }
                // Others may need what this rank shows.
                if !lit.is_empty() || plan.options.ranks > 1 {
                    wanted.push((piece, lit));
                }
            }
            let mut from_piece = |number: usize, light: Option<View>, go_on: &mut dyn FnMut()| {
                let (piece, lit) = &wanted[number];
                let from = &piece.part;
                let specular = reflection.specular_under(context, piece, light.as_ref(), monitor)?;
                let antiradiance = light.as_ref().map_or(scene.no_bins.whole(), View::slice);
                let slots = plan.layout.slots_of(&from.tiles);
                let triangles =
                    ClusterSources { class: from.class, indices: slots.clone(), antiradiance, specular };
                let of_clusters = match &self.clusters {
                    Some(clusters) => Some(clusters.gather(context, piece.group, &triangles, backs)?),
                    None => None,
                };
                // All that comes from other ranks is here.
                go_on();
                for (to, incident) in lit {
                    let shape = Shape::new(from.class, to.class);
                    let sweep = sweep_of(&mut self.sweeps, shape)?;
                    let near = [
                        facets,
                        radiance,
                        scene.corners.whole(),
                        irradiance.slice(),
                        antiradiance,
                        specular,
                        incident.slice(),
                        scene.near_offsets.whole(),
                        scene.near_sources.whole(),
                        scene.bin_table.whole(),
                    ];
                    let between = Between::receivers(plan, to, from, incident.first_slot);
                    sweep.near(context, &between, &near, backs, monitor)?;
                }
                let sent = [(from.class.blocker && backs, antiradiance), (from.class.glossy, specular)];
                let sent = Some((piece.group, sent.map(|(there, light)| there.then_some(light))));
                add_near_matrix(&mut self.near_matrix, context, sent, y, monitor)?;
                if let Some(of_clusters) = of_clusters {
                    if let Some(volumes) = self.volumes.as_ref().filter(|_| first_sweep) {
                        volumes.add(context, &triangles, backs)?;
                    }
                    for sources in [triangles, of_clusters] {
                        for (to, incident) in lit {
                            let sweep = sweep_of(&mut self.sweeps, Shape::new(from.class, to.class))?;
                            let light = (irradiance.slice(), incident);
                            add_listed(context, sweep, &sources, to, light, passing, monitor)?;
                        }
                    }
                    return Ok(());
                }
                for (to, incident) in lit {
                    let shape = Shape::new(from.class, to.class);
                    let sweep = sweep_of(&mut self.sweeps, shape)?;
                    let far = [
                        facets,
                        scene.far_sources.whole(),
                        irradiance.slice(),
                        antiradiance,
                        specular,
                        incident.slice(),
                        scene.bin_table.whole(),
                    ];
                    let far = if shape.any_bins() { &far[..] } else { &far[..3] };
                    let between = Between::receivers(plan, to, from, incident.first_slot);
                    sweep.far(context, &between, far, &partners, passing, monitor)?;
                }
                Ok(())
            };
            match x {
                Some(x) => {
                    let parts: Vec<_> = wanted.iter().map(|(of, _)| Part::of_piece(plan, of)).collect();
                    x.show_each(device, &parts, false, from_piece)?;
                }
                None => (0..wanted.len()).try_for_each(|number| from_piece(number, None, &mut || {}))?,
            }
            if let Some(volumes) = self.volumes.as_ref().filter(|_| first_sweep) {
                volumes.sum(context)?;
                first_sweep = false;
            }
            for (to, incident) in receivers.iter().filter(|(to, _)| !to.tiles.is_empty()) {
                let Some(volumes) = &self.volumes else { continue };
                let sources = &volumes.sources(plan)?;
                let sweep = sweep_of(&mut self.sweeps, Shape::new(sources.class, to.class))?;
                // Fronts are on both sides of volumes.
                let passing = PAIR_FRONT | PAIR_BACK;
                add_listed(context, sweep, sources, to, (irradiance.slice(), incident), passing, monitor)?;
            }
            add_near_matrix(&mut self.near_matrix, context, None, y, monitor)?;
            for (_, incident) in receivers {
                incident.store(device)?;
            }
        }
        context.complete_slots(irradiance.buffer(), plan.rgb_bytes())?;
        irradiance.store(device)
    }
}

/// Adds the near field where it is kept, from the antiradiance and the specular radiance of a group or from the diffuse radiance of all;
/// states are on the device then.
fn add_near_matrix(
    matrix: &mut Option<NearMatrix>,
    Context { device, outgoing, .. }: &Context,
    from: Option<(usize, [Option<BufferSlice>; 2])>,
    y: &State,
    monitor: &mut PassMonitor,
) -> Result<(), TransportError> {
    let Some(matrix) = matrix else { return Ok(()) };
    let y = y.resident()?;
    let sent = |part| match (part, from) {
        (OutgoingPart::Diffuse, None) => Some(outgoing.radiance.whole()),
        (OutgoingPart::Antiradiance { group }, Some((of, [sent, _]))) if group == of => sent,
        (OutgoingPart::Specular { group }, Some((of, [_, sent]))) if group == of => sent,
        _ => None,
    };
    let ends = |block: &Block| {
        let Some(sent) = sent(block.outgoing) else { return Ok(None) };
        let received = match block.incident {
            IncidentPart::Irradiance => y.irradiance.whole(),
            IncidentPart::Bins { group } => y.page(group)?.whole(),
        };
        Ok(Some([sent, received]))
    };
    matrix.run(device, ends, monitor)
}

/// Adds what the far triangles of a group, or its clusters, send to another, where clusters stand for triangles.
fn add_listed(
    context: &Context,
    sweep: &mut Sweep,
    from: &ClusterSources,
    to: &Group,
    (irradiance, incident): (BufferSlice, &View),
    passing: u32,
    monitor: &mut PassMonitor,
) -> Result<(), TransportError> {
    let Context { plan, scene, outgoing, .. } = context;
    let shape = Shape::new(from.class, to.class);
    let (facets, lists, radiance) =
        (scene.facets.whole(), scene.far_sources.whole(), outgoing.radiance.whole());
    let with_bins = [
        facets,
        lists,
        irradiance,
        from.antiradiance,
        from.specular,
        incident.slice(),
        scene.bin_table.whole(),
        radiance,
    ];
    let without = [facets, lists, irradiance, radiance];
    let buffers = if shape.any_bins() { &with_bins[..] } else { &without[..] };
    let targets = (&plan.layout.slots_of(&to.tiles), incident.first_slot);
    let partners = (&from.indices, from.indices.start);
    sweep.listed(context, targets, partners, buffers, passing, monitor)
}

#[cfg(test)]
mod tests {
    use super::super::tests::operators;
    use super::*;
    use crate::solve::LightOperator;

    #[test]
    fn a_kernel_that_is_missing_is_an_error_not_darkness() {
        let mut operators = operators();
        let x = operators.vector().expect("a vector");
        let mut y = operators.vector().expect("a vector");
        operators.pass(Some(&x), true, &mut y).expect("a pass");
        operators.exchange.sweeps.pop();
        let error = operators.pass(Some(&x), true, &mut y).expect_err("a kernel is missing");
        assert!(matches!(&error, TransportError::Missing { what } if what.contains("kernel")), "{error}");
    }
}
