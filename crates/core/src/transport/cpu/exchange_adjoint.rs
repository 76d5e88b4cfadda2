//! Uᵀ: what the light of every triangle matters to every other, one group of receivers after the other.

use super::Operators;
use super::adjoint::AdjointArrays;
use super::exchange::{blocks, show};
use super::far_adjoint::{Accumulated, Cotangents, Importance, Receivers};
use super::near_matrix::NearMatrix;
use super::real::Real;
use super::scene::{Context, SLOT};
use super::state::Vector;
use super::steps::{Kernel, Steps};
use crate::model::Class;
use crate::plan::{Group, IncidentPart, OutgoingPart};
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::pairs;
use std::ops::Range;

impl<T: Real> Operators<T> {
    /// Adds Uᵀ x: the cotangents of diffuse and specular radiance to the current ones, those of antiradiance to the bins of `y`.
    pub(super) fn exchange_adjoint(
        &mut self,
        x: &Vector<T>,
        y: &mut Vector<T>,
    ) -> Result<(), TransportError> {
        let Self { context, window, near_transposed, steps, adjoint, .. } = self;
        let adjoint = adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        let plan = &context.plan;
        let lists = plan.interactions().by_source.as_ref().ok_or(TransportError::NotPlanned)?;
        steps.begin(plan.own_share(pairs(plan, false)));
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
                let mut add = |kernel, of: Receivers| {
                    let importance = received.importance(from.class, of, slots.start);
                    let front = adjoint.current_specular[s].as_deref_mut().unwrap_or(&mut []);
                    let radiance = &mut adjoint.current_radiance;
                    let to = Accumulated { radiance, back: &mut y.bins[s], front };
                    add(kernel, &importance, blocks(&slots), to, steps)
                };
                if near_transposed.is_none() {
                    add(Kernel::NearAdjoint, Receivers::Close { near: &lists.near, slots: receivers })?;
                }
                let (runs, tiles, tile) = (&lists.far, to.tiles.clone(), plan.layout.tile);
                add(Kernel::FarAdjoint, Receivers::Tiles { runs, tiles, tile })?;
            }
        }
        add_near_matrix(context, near_transposed.as_ref(), None, x, adjoint, y, steps);
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
    /// What the light of sources matters to receivers; `page`: the slot with which the cotangents of their bins begin.
    fn importance(&self, class: Class, of: Receivers<'a>, page: u32) -> Importance<'a, T> {
        Importance {
            shape: Shape::new(class, self.to.class),
            of,
            cotangents: cotangents(self.context, self.x, self.incident),
            receivers_page: self.context.plan.layout.slots_of(&self.to.tiles).start,
            bins_page: page,
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
