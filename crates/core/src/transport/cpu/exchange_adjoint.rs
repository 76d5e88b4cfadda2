//! Uᵀ: what the light of every triangle matters to every other, one group of receivers after the other.

use super::Operators;
use super::adjoint::AdjointArrays;
use super::clusters::clusters_of;
use super::completion::complete;
use super::exchange::{blocks, show};
use super::far_adjoint::{Accumulated, Cotangents, Importance, Receivers};
use super::kept_pairs::{KeptFar, KeptPairs};
use super::near_matrix::NearMatrix;
use super::real::Real;
use super::scene::{Context, SLOT};
use super::state::Vector;
use super::steps::{Kernel, Steps};
use crate::backend::Array;
use crate::model::{Class, LIST};
use crate::plan::{Group, IncidentPart, OutgoingPart};
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::pairs_by_source;
use std::ops::Range;

impl<T: Real> Operators<T> {
    /// Adds Uᵀ x: the cotangents of diffuse and specular radiance to the current ones, those of antiradiance to the bins of `y`.
    pub(super) fn exchange_adjoint(
        &mut self,
        x: &Vector<T>,
        y: &mut Vector<T>,
    ) -> Result<(), TransportError> {
        let Self { context, window, near, near_transposed, kept, steps, adjoint, .. } = self;
        let adjoint = adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        let plan = &context.plan;
        let lists = plan.interactions().by_source.as_ref().ok_or(TransportError::NotPlanned)?;
        steps.begin(plan.own_share(pairs_by_source(plan, false)));
        for (t, to) in plan.layout.groups.iter().enumerate() {
            let incident = show(context, x, t, window)?;
            if !incident.is_empty() {
                let from = Some((t, incident));
                add_near_matrix(context, near_transposed.as_ref(), from, x, adjoint, y, steps);
            }
            let received = Received { context, x, to, incident };
            for s in 0..plan.layout.groups.len() {
                let from = plan.own(s);
                let slots = plan.layout.slots_of(&from.tiles);
                let receivers = plan.layout.slots_of(&to.tiles);
                let mut add = |kernel, of: Receivers, kept| {
                    let importance = received.importance(from.class, (of, kept), (0, slots.start));
                    let front = adjoint.current_specular[s].as_deref_mut().unwrap_or(&mut []);
                    let radiance = &mut adjoint.current_radiance;
                    let to = Accumulated { radiance, back: &mut y.bins[s], front };
                    add(kernel, &importance, blocks(&slots), to, steps)
                };
                if near_transposed.is_none() {
                    add(Kernel::NearAdjoint, Receivers::Close { near: &lists.near, slots: receivers }, None)?;
                }
                if plan.clusters().is_none() {
                    let (runs, tiles, tile) = (&lists.far, to.tiles.clone(), plan.layout.tile);
                    let kept = kept.as_ref().and_then(|kept| kept.of(t, s));
                    add(Kernel::FarAdjoint, Receivers::Tiles { runs, tiles, tile }, kept)?;
                }
            }
        }
        add_near_matrix(context, near_transposed.as_ref(), None, x, adjoint, y, steps);
        let scatters = plan.near_field_matrix().is_some_and(|matrix| matrix.scatters);
        for near in near.iter().filter(|_| scatters) {
            for block in near.matrix.blocks.iter().filter(|block| block.is_diffuse()) {
                let (entries, radiance) = (near.matrix.entries(block), &mut adjoint.current_radiance[..]);
                let scatter = || near.multiply_transposed(block, &x.irradiance, radiance);
                steps.timed("near_matrix", "transposed", entries, scatter);
            }
        }
        if plan.clusters().is_some() {
            for s in 0..plan.layout.groups.len() {
                let back = Some((&mut y.bins[s], kept.as_ref()));
                cluster_cotangents(context, adjoint, s, back, x, window, steps)?;
            }
        }
        Ok(())
    }
}

/// Cotangents of the light that some receivers receive.
struct Received<'a, T> {
    context: &'a Context<T>,
    x: &'a Vector<T>,
    to: &'a Group,
    /// Cotangents of the bins of the receivers.
    incident: &'a [T],
}

impl<'a, T: Real> Received<'a, T> {
    /// What the light of sources matters to receivers, with the pairs that are kept; `pages`: the indices with which the cotangents of their
    /// radiance and of their bins begin.
    fn importance(
        &self,
        class: Class,
        (of, kept): (Receivers<'a>, Option<&'a [KeptPairs<T>]>),
        pages: (u32, u32),
    ) -> Importance<'a, T> {
        Importance {
            shape: Shape::new(class, self.to.class),
            of,
            cotangents: cotangents(self.context, self.x, self.incident),
            receivers_page: self.context.plan.layout.slots_of(&self.to.tiles).start,
            radiance_page: pages.0,
            bins_page: pages.1,
            kept,
        }
    }
}

/// Cotangents of light in memory: of the irradiance of all slots, and of the bins of a group.
pub fn cotangents<'a, T: Real>(
    context: &'a Context<T>,
    x: &'a Vector<T>,
    incident: &'a [T],
) -> Cotangents<'a, T> {
    Cotangents {
        layout: context.layout,
        half_range: context.half_range(),
        facets: &context.scene.facets,
        corners: &context.scene.corners,
        irradiance: &x.irradiance,
        incident,
        bin_table: &context.scene.bin_table,
        bins: context.bins(),
    }
}

fn add<T: Real>(
    kernel: Kernel,
    importance: &Importance<T>,
    blocks: Range<u32>,
    to: Accumulated<T>,
    steps: &mut Steps,
) -> Result<(), TransportError> {
    let Accumulated { radiance, back, front } = to;
    let pairs = |block| importance.of.pairs(block);
    steps.over((kernel, importance.shape), blocks, pairs, |blocks| {
        importance
            .add(blocks, Accumulated { radiance: &mut *radiance, back: &mut *back, front: &mut *front });
    })
}

/// Computes the whole cotangents of the light of the clusters of a group, with those of the clusters that
/// contain them. With `back`, the bins of the group's triangles in a state of the adjoint and the pairs that are kept, adds those of its
/// triangles from far receivers, too.
///
/// # Errors
/// Fails if the plan has no clusters or no gradients, if another rank has ended, or if the callback stops the
/// pass.
pub fn cluster_cotangents<T: Real>(
    context: &Context<T>,
    adjoint: &mut AdjointArrays<T>,
    group: usize,
    mut back: Option<(&mut Vec<T>, Option<&KeptFar<T>>)>,
    x: &Vector<T>,
    window: &mut Option<Array<T>>,
    steps: &mut Steps,
) -> Result<(), TransportError> {
    let AdjointArrays { clusters: Some(cotangents), current_radiance, current_specular, .. } = adjoint else {
        return Ok(());
    };
    let plan = &context.plan;
    let (all, run) = clusters_of(plan, group)?;
    let lists = all.receivers().ok_or(TransportError::NotPlanned)?;
    cotangents.clear(run.class);
    let (first, page) = (all.first(), run.range().start);
    let own = plan.own(group);
    let slots = plan.layout.slots_of(&own.tiles);
    let front = current_specular[group].as_deref_mut().unwrap_or(&mut []);
    for (t, to) in plan.layout.groups.iter().enumerate() {
        let incident = show(context, x, t, window)?;
        let received = Received { context, x, to, incident };
        let receivers = plan.layout.slots_of(&to.tiles);
        let listed = |sources: Range<u32>, clusters| Receivers::Listed {
            lists,
            range: receivers.start / LIST..receivers.end / LIST,
            sources,
            clusters,
        };
        let sources = plan.own_clusters(group);
        let of = listed(sources.clone(), Some([first, plan.sources() - first]));
        let importance = received.importance(run.class, (of, None), (first, page));
        let accumulated = cotangents.accumulated(run.class);
        add(Kernel::FarAdjoint, &importance, lists.groups(&sources), accumulated, steps)?;
        if let Some((back, kept)) = &mut back {
            let of = (listed(slots.clone(), None), kept.and_then(|kept| kept.of(t, group)));
            let importance = received.importance(own.class, of, (0, slots.start));
            let to = Accumulated { radiance: &mut *current_radiance, back, front: &mut *front };
            add(Kernel::FarAdjoint, &importance, lists.groups(&slots), to, steps)?;
        }
    }
    let (ranks, shares) = (context.cpu.ranks(), plan.clusters_by_rank(group));
    let (radiance, moments) = cotangents.radiance.split_at_mut(all.count() as usize * SLOT);
    complete(ranks, radiance, (first, SLOT), shares)?;
    complete(ranks, moments, (first, 3 * SLOT), shares)?;
    for bins in cotangents.bins_mut(run.class).into_iter().flatten() {
        complete(ranks, bins, (page, context.bins()), shares)?;
    }
    steps.timed("clusters", "cotangents", run.range().len() as u64, || {
        cotangents.within(context, (all, run));
        if let Some((back, _)) = back {
            cotangents.to_triangles(context, (all, run), &slots, current_radiance, [back, front]);
        }
    });
    Ok(())
}

/// Adds the near field where it is kept, from the cotangents of the bins of a group or of the irradiance of all.
fn add_near_matrix<T: Real>(
    context: &Context<T>,
    near: Option<&NearMatrix<T>>,
    from: Option<(usize, &[T])>,
    x: &Vector<T>,
    adjoint: &mut AdjointArrays<T>,
    y: &mut Vector<T>,
    steps: &Steps,
) {
    let Some(near) = near else { return };
    let channels = context.layout.channels;
    for block in &near.matrix.blocks {
        let incident = match (block.incident, from) {
            (IncidentPart::Irradiance, None) => (&x.irradiance[..], SLOT),
            (IncidentPart::Bins { group }, Some((of, incident))) if group == of => (incident, channels),
            _ => continue,
        };
        let outgoing = match block.outgoing {
            OutgoingPart::Diffuse => (&mut adjoint.current_radiance[..], SLOT),
            OutgoingPart::Antiradiance { group } => (&mut y.bins[group][..], channels),
            OutgoingPart::Specular { group } => {
                (adjoint.current_specular[group].as_deref_mut().unwrap_or(&mut []), channels)
            }
        };
        let entries = near.matrix.entries(block);
        steps.timed("near_matrix", "transposed", entries, || near.multiply(block, incident, outgoing));
    }
}
