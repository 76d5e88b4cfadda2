//! U: light from every triangle to every other, one group of sources after the other.

use super::Operators;
use super::completion::{complete, complete_slots};
use super::far::{self, BLOCK, Light, Received};
use super::near_matrix::NearMatrix;
use super::real::Real;
use super::reflection;
use super::scene::{Context, SLOT};
use super::state::Vector;
use super::steps::{Kernel, Steps};
use super::vectors::clear;
use crate::backend::Array;
use crate::model::Class;
use crate::plan::{Group, IncidentPart, OutgoingPart, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Plan};
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::{far_pairs, pairs};
use antirad_base::ranks::RankError;
use std::ops::Range;

impl<T: Real> Operators<T> {
    /// y = U (E + (K - J) x) with `emission`, y = U (K - J) x without; without `x` there is only emission.
    pub(super) fn exchange(
        &mut self,
        x: Option<&Vector<T>>,
        emission: bool,
        y: &mut Vector<T>,
    ) -> Result<(), TransportError> {
        let Self { context, outgoing, window, near, steps, .. } = self;
        let plan = &context.plan;
        let passing = PAIR_FRONT | PAIR_NEAR | if x.is_some() { PAIR_BACK } else { 0 };
        steps.begin(plan.own_share(pairs(plan, false)));
        reflection::diffuse(context, &mut outgoing.radiance, x, emission);
        clear(y);
        for (g, from) in plan.layout.groups.iter().enumerate() {
            let antiradiance = match x.filter(|_| from.class.blocker) {
                Some(x) => show(context, x, g, window)?,
                None => &[],
            };
            reflection::specular(context, &mut outgoing.specular, (x, emission), g, steps)?;
            let slots = plan.layout.slots_of(&from.tiles);
            let specular = outgoing.specular.of(plan, g);
            let triangles = Sources { class: from.class, indices: slots.clone(), antiradiance, specular };
            let sent = Sent { context, radiance: &outgoing.radiance, passing };
            let lit = receivers(plan, from, steps)?;
            let lists = &plan.interactions().by_receiver;
            if near.is_none() {
                for (t, to) in &lit {
                    let close = far::Sources::Close { near: &lists.near, slots: slots.clone() };
                    sent.add(Kernel::Near, &triangles, close, (*t, to), y, steps)?;
                }
            }
            add_near_matrix(context, near.as_ref(), Some((g, &triangles)), &outgoing.radiance, y, steps);
            for (t, to) in &lit {
                let (runs, tiles, tile) = (&lists.far, from.tiles.clone(), plan.layout.tile);
                let far = far::Sources::Tiles { runs, tiles, tile };
                sent.add(Kernel::Far, &triangles, far, (*t, to), y, steps)?;
            }
        }
        add_near_matrix(context, near.as_ref(), None, &outgoing.radiance, y, steps);
        Ok(complete_slots(context.cpu.ranks(), plan, &mut y.irradiance, SLOT)?)
    }
}

/// The triangles of a group as sources, with their bins in one page.
#[derive(Clone)]
pub struct Sources<'a, T> {
    pub class: Class,
    pub indices: Range<u32>,
    pub antiradiance: &'a [T],
    pub specular: &'a [T],
}

/// What sources send, and to whom.
struct Sent<'a, T> {
    context: &'a Context<T>,
    /// Diffuse radiance.
    radiance: &'a [T],
    /// Bits of pairs to consider.
    passing: u32,
}

impl<T: Real> Sent<'_, T> {
    /// Adds what this rank's triangles `to` of a group receive from sources.
    fn add(
        &self,
        kernel: Kernel,
        sources: &Sources<T>,
        from: far::Sources,
        (t, to): (usize, &Group),
        y: &mut Vector<T>,
        steps: &mut Steps,
    ) -> Result<(), TransportError> {
        let slots = self.context.plan.layout.slots_of(&to.tiles);
        let received = Received {
            shape: Shape::new(sources.class, to.class),
            from,
            passing: self.passing,
            light: light(self.context, self.radiance, sources),
            sources_page: sources.indices.start,
            receivers_page: slots.start,
        };
        let pairs = |block| received.from.pairs(block);
        steps.over((kernel, received.shape), blocks(&slots), pairs, |blocks| {
            received.add(blocks, &mut y.irradiance, &mut y.bins[t]);
        })
    }
}

/// The light of sources in memory.
pub fn light<'a, T: Real>(context: &'a Context<T>, radiance: &'a [T], of: &Sources<'a, T>) -> Light<'a, T> {
    Light {
        layout: context.layout,
        half_range: context.half_range(),
        facets: &context.scene.facets,
        corners: &context.scene.corners,
        radiance,
        antiradiance: of.antiradiance,
        specular: of.specular,
        bin_table: &context.scene.bin_table,
        bins: context.bins(),
    }
}

/// The bins of a group in a state, of all ranks, which call it together.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn show<'a, T: Real>(
    context: &Context<T>,
    x: &'a Vector<T>,
    group: usize,
    window: &'a mut Option<Array<T>>,
) -> Result<&'a [T], RankError> {
    let Context { cpu, plan, .. } = context;
    let of = &plan.layout.groups[group];
    let Some(window) = window.as_mut().filter(|_| of.class.has_bins()) else { return Ok(&x.bins[group]) };
    let slots = plan.layout.slots_of(&of.tiles);
    let own = reflection::within(context, group, &plan.layout.slots_of(&plan.own(group).tiles));
    let window = &mut window[..slots.len() * context.bins()];
    window[own].copy_from_slice(&x.bins[group]);
    complete(cpu.ranks(), window, (slots.start, context.bins()), &plan.slots_by_rank(group))?;
    Ok(window)
}

/// What this rank holds of each group, with its number, if light can pass to it from some sources.
fn receivers(plan: &Plan, from: &Group, steps: &mut Steps) -> Result<Vec<(usize, Group)>, TransportError> {
    let mut lit = Vec::new();
    for t in 0..plan.layout.groups.len() {
        let to = plan.own(t);
        match plan.anything_passes(&to.tiles, &from.tiles) {
            true => lit.push((t, to)),
            false => steps.done(far_pairs(plan, &to, from))?,
        }
    }
    Ok(lit)
}

/// Adds the near field where it is kept, from the bins of a group, or from the diffuse radiance of all.
fn add_near_matrix<T: Real>(
    context: &Context<T>,
    near: Option<&NearMatrix<T>>,
    from: Option<(usize, &Sources<T>)>,
    radiance: &[T],
    y: &mut Vector<T>,
    steps: &Steps,
) {
    let Some(near) = near else { return };
    let channels = context.layout.channels;
    for block in &near.matrix.blocks {
        let sent = match (block.outgoing, &from) {
            (OutgoingPart::Diffuse, None) => (radiance, SLOT),
            (OutgoingPart::Antiradiance { group }, Some((of, sources))) if group == *of => {
                (sources.antiradiance, channels)
            }
            (OutgoingPart::Specular { group }, Some((of, sources))) if group == *of => {
                (sources.specular, channels)
            }
            _ => continue,
        };
        // Without incident light there is no antiradiance.
        if sent.0.is_empty() {
            continue;
        }
        let received = match block.incident {
            IncidentPart::Irradiance => (&mut y.irradiance[..], SLOT),
            IncidentPart::Bins { group } => (&mut y.bins[group][..], channels),
        };
        let entries = near.matrix.entries(block);
        steps.timed("near_matrix", "forward", entries, || near.multiply(block, sent, received));
    }
}

/// The blocks of some slots.
pub fn blocks(slots: &Range<u32>) -> Range<u32> {
    slots.start / BLOCK..slots.end / BLOCK
}
