//! U: light from every triangle to every other.

use super::bundle::PassMonitor;
use super::near_matrix::NearMatrix;
use super::reflection::Reflection;
use super::residency::{Part, View};
use super::state::State;
use super::sweep::{Between, Kernels, Sweep, of_partners};
use super::{Context, bin_constants};
use crate::plan::{Block, Group, IncidentPart, OutgoingPart, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Piece, Plan};
use crate::shaders;
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::{far_pairs, pairs};
use antirad_base::parallel;
use antirad_gpu::{Batch, Bindings, BufferSlice, Device, GpuError};
use std::ops::Range;

/// Close sources per receiver and dispatch: lavapipe bounds the iterations of all loops of an invocation together by
/// 65535, and one source takes at most 1 + 16 · (20 + 16 · 19).
pub const NEAR_TAKE: u32 = 8;
/// Close sources per receiver and dispatch where sources have no bins and need no second level: 1 + 16 · 20
/// iterations each.
pub const PLAIN_NEAR_TAKE: u32 = 128;

/// Specialization constants of the kernels of a shape.
pub fn shape_constants(shape: Shape, plan: &Plan) -> Vec<(u32, u32)> {
    let (blocker, glossy) = (u32::from(shape.source.blocker), u32::from(shape.source.glossy));
    let own = [(7, blocker), (8, glossy), (9, u32::from(shape.receiver_bins))];
    [&own[..], &bin_constants(plan)].concat()
}

/// Compiles one sweep for each shape that occurs, on all cores.
///
/// # Errors
/// Fails if the device cannot compile a kernel.
pub fn sweeps(
    device: &Device,
    plan: &Plan,
    kernels: impl Fn(Shape) -> Kernels<'static> + Sync,
) -> Result<Vec<(Shape, Sweep)>, GpuError> {
    // Drivers may take long to compile their kernels.
    let sweep = |shape| Ok((shape, Sweep::new(device, plan, kernels(shape))?));
    parallel::map(Shape::all(plan), sweep).into_iter().collect()
}

/// The sweep of a shape.
///
/// # Errors
/// Fails if there is none.
pub fn sweep_of(sweeps: &mut [(Shape, Sweep)], shape: Shape) -> Result<&mut Sweep, TransportError> {
    let sweep = sweeps.iter_mut().find(|(known, _)| *known == shape).map(|(_, sweep)| sweep);
    sweep.ok_or_else(|| TransportError::missing(format!("a kernel from {}", shape.name())))
}

pub struct Exchange {
    sweeps: Vec<(Shape, Sweep)>,
    /// The near-field matrix; `None` where close pairs are evaluated in each pass.
    near_matrix: Option<NearMatrix>,
}

impl Exchange {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        Ok(Self { sweeps: Self::kernels(device, plan)?, near_matrix: NearMatrix::forward(device, plan)? })
    }

    /// Compiles the kernels of U over pairs, by shape.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<Vec<(Shape, Sweep)>, GpuError> {
        let kernels = |shape: Shape| Kernels {
            far: match shape.any_bins() {
                true => (&shaders::TRANSPORT_BINS, Bindings { storage: 7, uniform: 2 }),
                false => (&shaders::TRANSPORT_IRRADIANCE, Bindings { storage: 3, uniform: 2 }),
            },
            near: plan.near_field_matrix().is_none().then_some((&shaders::NEAR, 11)),
            single: shape.any_bins(),
            constants: shape_constants(shape, plan),
            take: if shape.source.has_bins() { NEAR_TAKE } else { PLAIN_NEAR_TAKE },
            gathers: u64::from(shape.source.has_bins()),
            scattered: Some(u64::from(shape.receiver_bins)),
            slots: plan.layout.slots_where(|class| class.has_bins() == shape.receiver_bins),
            shape: shape.name().to_owned(),
        };
        sweeps(device, plan, kernels)
    }

    /// y = U (E + (K - J) x) with `emission`, y = U (K - J) x without; without `x` there is only emission.
    ///
    /// # Errors
    /// Fails if the device does, if another rank has ended, or if the callback stops the pass.
    pub fn run(
        &mut self,
        context: &Context,
        reflection: &mut Reflection,
        (x, emission): (Option<&State>, bool),
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        monitor.begin(plan.own_share(pairs(plan, false)));
        let irradiance = y.open(&Part::irradiance(plan))?;
        let backs = x.is_some();
        let passing = PAIR_FRONT | PAIR_NEAR | if backs { PAIR_BACK } else { 0 };
        let pass = Pass { context, irradiance: &irradiance, backs, passing };
        for (number, groups) in plan.sweeps().into_iter().enumerate() {
            // What the sweep begins with, in one submission.
            let mut batch = device.batch()?;
            if number == 0 {
                reflection.record_diffuse(context, x, emission, &mut batch)?;
                irradiance.fill(&mut batch)?;
            }
            let receivers = open_receivers(context, groups, y, &mut batch)?;
            batch.defer()?;
            let wanted = sources_for(plan, &receivers, monitor)?;
            let mut add_piece = |of: usize, light: Option<View>, go_on: &mut dyn FnMut()| {
                let (piece, lit) = &wanted[of];
                let specular = reflection.specular_under(context, piece, light.as_ref(), monitor)?;
                let antiradiance = light.as_ref().map_or(context.scene.no_bins.whole(), View::slice);
                // All that comes from other ranks is here.
                go_on();
                self.add_piece(&pass, piece, [antiradiance, specular], lit, y, monitor)
            };
            match x {
                Some(x) => {
                    let parts: Vec<_> = wanted.iter().map(|(of, _)| Part::of_piece(plan, of)).collect();
                    x.show_each(device, &parts, add_piece)?;
                }
                None => (0..wanted.len()).try_for_each(|of| add_piece(of, None, &mut || {}))?,
            }
            add_near_matrix(&mut self.near_matrix, context, None, y, monitor)?;
            receivers.into_iter().try_for_each(|to| to.incident.store(device))?;
        }
        context.complete_slots(irradiance.buffer(), plan.rgb_bytes())?;
        irradiance.store(device)
    }

    /// Adds what a piece of the sources sends to the receivers of a sweep: close triangles, then far ones. `sent`: its antiradiance and
    /// specular radiance.
    fn add_piece(
        &mut self,
        pass: &Pass,
        piece: &Piece,
        sent: [BufferSlice; 2],
        lit: &[&Receivers],
        y: &State,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let from = &piece.part;
        for to in lit {
            pass.near(sweep_of(&mut self.sweeps, to.shape(from))?, sent, from, to, monitor)?;
        }
        let there = [from.class.blocker && pass.backs, from.class.glossy];
        let there = [there[0].then_some(sent[0]), there[1].then_some(sent[1])];
        add_near_matrix(&mut self.near_matrix, pass.context, Some((piece.group, there)), y, monitor)?;
        for to in lit {
            pass.far(sweep_of(&mut self.sweeps, to.shape(from))?, sent, from, to, monitor)?;
        }
        Ok(())
    }
}

/// What this rank computes of a group, and the view in which its bins are accumulated.
struct Receivers<'a> {
    group: Group,
    incident: View<'a>,
}

impl Receivers<'_> {
    fn shape(&self, from: &Group) -> Shape {
        Shape::new(from.class, self.group.class)
    }
}

/// The receivers of a sweep, whose bins are set to zero.
fn open_receivers<'a>(
    context: &'a Context,
    groups: Range<usize>,
    y: &'a State,
    batch: &mut Batch,
) -> Result<Vec<Receivers<'a>>, TransportError> {
    let Context { plan, scene, .. } = context;
    let mut receivers = Vec::new();
    for t in groups {
        let incident = Part::held(plan, t).map(|part| y.open(&part)).transpose()?;
        if let Some(incident) = &incident {
            incident.fill(batch)?;
        }
        let incident = incident.unwrap_or_else(|| View::resident(&scene.no_bins, 0, 0));
        receivers.push(Receivers { group: plan.own(t), incident });
    }
    Ok(receivers)
}

/// Pieces of the sources, each with the receivers that it can light.
fn sources_for<'a, 'b>(
    plan: &Plan,
    receivers: &'b [Receivers<'a>],
    monitor: &mut PassMonitor,
) -> Result<Vec<(Piece, Vec<&'b Receivers<'a>>)>, TransportError> {
    let mut wanted = Vec::new();
    for piece in plan.pieces() {
        let from = &piece.part;
        let reached = |to: &&Receivers| plan.anything_passes(&to.group.tiles, &from.tiles);
        let (lit, culled): (Vec<_>, Vec<_>) = receivers.iter().partition(reached);
        culled.iter().try_for_each(|to| monitor.done(far_pairs(plan, &to.group, from)))?;
        // Others may need what this rank shows.
        if !lit.is_empty() || plan.options.ranks > 1 {
            wanted.push((piece, lit));
        }
    }
    Ok(wanted)
}

/// What kernels of a pass bind, whatever the sources.
#[derive(Clone, Copy)]
struct Pass<'a> {
    context: &'a Context,
    irradiance: &'a View<'a>,
    /// Whether there is antiradiance.
    backs: bool,
    /// Bits of pairs to consider.
    passing: u32,
}

impl Pass<'_> {
    /// Adds what close triangles send, by their antiradiance and specular radiance.
    fn near(
        &self,
        sweep: &mut Sweep,
        [antiradiance, specular]: [BufferSlice; 2],
        from: &Group,
        to: &Receivers,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { plan, scene, outgoing, .. } = self.context;
        let buffers = [
            scene.facets.whole(),
            outgoing.radiance.whole(),
            scene.corners.whole(),
            self.irradiance.slice(),
            antiradiance,
            specular,
            to.incident.slice(),
            scene.near_offsets.whole(),
            scene.near_sources.whole(),
            scene.bin_table.whole(),
        ];
        let between = Between::receivers(plan, &to.group, from, to.incident.first_slot);
        sweep.near(self.context, &between, &buffers, self.backs, monitor)
    }

    /// Adds what far triangles send.
    fn far(
        &self,
        sweep: &mut Sweep,
        [antiradiance, specular]: [BufferSlice; 2],
        from: &Group,
        to: &Receivers,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { plan, scene, outgoing, .. } = self.context;
        let buffers = [
            scene.facets.whole(),
            scene.far_sources.whole(),
            self.irradiance.slice(),
            antiradiance,
            specular,
            to.incident.slice(),
            scene.bin_table.whole(),
        ];
        let buffers = if to.shape(from).any_bins() { &buffers[..] } else { &buffers[..3] };
        let between = Between::receivers(plan, &to.group, from, to.incident.first_slot);
        let partners = of_partners(self.context, &outgoing.radiance);
        sweep.far(self.context, &between, buffers, &partners, self.passing, monitor)
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
        operators.forward.exchange.sweeps.pop();
        let error = operators.pass(Some(&x), true, &mut y).expect_err("a kernel is missing");
        assert!(matches!(&error, TransportError::Missing { what } if what.contains("kernel")), "{error}");
    }
}
