//! The derivative of ⟨λ, U L⟩ with respect to the geometry of all triangles: two passes over all pairs, one for each triangle as a source
//! and one as a receiver.

use super::completion::complete_slots;
use super::derivative::{By, Derivative, GRADIENT};
use super::exchange::{Sources, blocks, light, show};
use super::exchange_adjoint::cotangents;
use super::far;
use super::far_adjoint::Receivers;
use super::real::Real;
use super::scene::{Context, reals};
use super::state::Vector;
use super::steps::{Kernel, Steps};
use super::{Operators, observation_adjoint, reflection};
use crate::plan::{Group, Interactions, PADDING, Plan};
use crate::transport::TransportError;
use crate::transport::shape::Shape;
use crate::transport::work::pairs;
use antirad_scene::Movable;
use glam::DVec3;
use std::ops::Range;

impl<T: Real> Operators<T> {
    /// Adds to `gradients` the derivative of ⟨λ, U (E + (K - J) x)⟩ by the geometry, of `movable` triangles at least, where these are
    /// stated, and that of the views' ⟨colours, S (E + K x)⟩; returns the latter's by each camera. λ is the `cotangent`.
    pub(super) fn geometry(
        &mut self,
        [x, cotangent]: [&Vector<T>; 2],
        views: &[(DVec3, Vec<[f64; 4]>)],
        movable: Option<&Movable>,
        gradients: &mut [T],
    ) -> Result<Vec<DVec3>, TransportError> {
        let plan = &self.context.plan;
        reflection::diffuse(&self.context, &mut self.outgoing.radiance, Some(x), true);
        if let Some(movable) = movable {
            self.steps.begin(plan.own_share(2 * pairs(plan, true)));
            self.by_sources([x, cotangent], movable, gradients)?;
            self.by_receivers([x, cotangent], movable, gradients)?;
        }
        let cameras = self.views(x, views, gradients)?;
        let (ranks, plan) = (self.context.cpu.ranks(), &self.context.plan);
        complete_slots(ranks, plan, gradients, GRADIENT)?;
        Ok(cameras)
    }

    /// Adds the derivatives by the movable triangles of this rank as sources.
    fn by_sources(
        &mut self,
        [x, cotangent]: [&Vector<T>; 2],
        movable: &Movable,
        gradients: &mut [T],
    ) -> Result<(), TransportError> {
        let Self { context, outgoing, window, steps, .. } = self;
        let plan = &context.plan;
        let Interactions { by_source, .. } = plan.interactions();
        let lists = by_source.as_ref().ok_or(TransportError::NotPlanned)?;
        for s in 0..plan.layout.groups.len() {
            let held = plan.own(s);
            let slots = plan.layout.slots_of(&held.tiles);
            reflection::specular(context, &mut outgoing.specular, (Some(x), true), s, steps)?;
            let page = if held.class.glossy { reflection::within(context, s, &slots) } else { 0..0 };
            let sources = Sources {
                class: held.class,
                indices: slots,
                antiradiance: &x.bins[s],
                specular: &outgoing.specular.of(plan, s)[page],
            };
            for (t, to) in plan.layout.groups.iter().enumerate() {
                let incident = show(context, cotangent, t, window)?;
                let ends = Ends {
                    context,
                    sources: &sources,
                    radiance: &outgoing.radiance,
                    to,
                    cotangent,
                    incident,
                };
                let receivers = plan.layout.slots_of(&to.tiles);
                let close = Receivers::Close { near: &lists.near, slots: receivers };
                let (runs, tiles, tile) = (&lists.far, to.tiles.clone(), plan.layout.tile);
                let far = Receivers::Tiles { runs, tiles, tile };
                for tiles in movable_tiles(plan, &held, movable) {
                    let own = blocks(&plan.layout.slots_of(&tiles));
                    ends.add(
                        Kernel::NearDerivative,
                        By::Sources(close.clone()),
                        own.clone(),
                        gradients,
                        steps,
                    )?;
                    ends.add(Kernel::FarDerivative, By::Sources(far.clone()), own, gradients, steps)?;
                }
            }
        }
        Ok(())
    }

    /// Adds the derivatives by the movable triangles of this rank as receivers.
    fn by_receivers(
        &mut self,
        [x, cotangent]: [&Vector<T>; 2],
        movable: &Movable,
        gradients: &mut [T],
    ) -> Result<(), TransportError> {
        let Self { context, outgoing, window, steps, .. } = self;
        let plan = &context.plan;
        let lists = &plan.interactions().by_receiver;
        for (s, from) in plan.layout.groups.iter().enumerate() {
            reflection::specular(context, &mut outgoing.specular, (Some(x), true), s, steps)?;
            let slots = plan.layout.slots_of(&from.tiles);
            let antiradiance = show(context, x, s, window)?;
            let specular = outgoing.specular.of(plan, s);
            let sources = Sources { class: from.class, indices: slots.clone(), antiradiance, specular };
            for t in 0..plan.layout.groups.len() {
                let to = &plan.own(t);
                let incident = &cotangent.bins[t][..];
                let ends = Ends {
                    context,
                    sources: &sources,
                    radiance: &outgoing.radiance,
                    to,
                    cotangent,
                    incident,
                };
                let close = far::Sources::Close { near: &lists.near, slots: slots.clone() };
                let (runs, tiles, tile) = (&lists.far, from.tiles.clone(), plan.layout.tile);
                let far = far::Sources::Tiles { runs, tiles, tile };
                for tiles in movable_tiles(plan, to, movable) {
                    let own = blocks(&plan.layout.slots_of(&tiles));
                    ends.add(
                        Kernel::NearDerivative,
                        By::Receivers(close.clone()),
                        own.clone(),
                        gradients,
                        steps,
                    )?;
                    ends.add(Kernel::FarDerivative, By::Receivers(far.clone()), own, gradients, steps)?;
                }
            }
        }
        Ok(())
    }

    /// What cameras see: zero without glossy triangles, since diffuse radiance is the same in all directions.
    fn views(
        &mut self,
        x: &Vector<T>,
        views: &[(DVec3, Vec<[f64; 4]>)],
        gradients: &mut [T],
    ) -> Result<Vec<DVec3>, TransportError> {
        let Self { context, outgoing, steps, .. } = self;
        let mut cameras = Vec::with_capacity(views.len());
        for (camera_position, colours) in views {
            let mut colours: Vec<T> = reals(colours.as_flattened());
            for (g, _) in context.plan.glossy_groups() {
                reflection::reflect(context, &mut outgoing.specular, x, g, steps);
                let specular = &outgoing.specular;
                observation_adjoint::derivative(
                    context,
                    g,
                    specular,
                    *camera_position,
                    &mut colours,
                    gradients,
                );
            }
            cameras.push(observation_adjoint::by_camera(context, &mut colours)?);
        }
        Ok(cameras)
    }
}

/// Sources and their light, receivers and the cotangents of theirs.
struct Ends<'a, T> {
    context: &'a Context<T>,
    sources: &'a Sources<'a, T>,
    /// Diffuse radiance.
    radiance: &'a [T],
    to: &'a Group,
    cotangent: &'a Vector<T>,
    incident: &'a [T],
}

impl<T: Real> Ends<'_, T> {
    /// Adds the derivative by one of both ends.
    fn add(
        &self,
        kernel: Kernel,
        by: By,
        blocks: Range<u32>,
        gradients: &mut [T],
        steps: &mut Steps,
    ) -> Result<(), TransportError> {
        let &Self { context, sources, radiance, to, cotangent, incident } = self;
        let derivative = Derivative {
            shape: Shape::new(sources.class, to.class),
            by,
            light: light(context, radiance, sources),
            sources_page: sources.indices.start,
            cotangents: cotangents(context, cotangent, incident),
            receivers_page: context.plan.layout.slots_of(&to.tiles).start,
        };
        let pairs = |block| derivative.by.pairs(block);
        steps.over((kernel, derivative.shape), blocks, pairs, |blocks| derivative.add(blocks, gradients))
    }
}

/// Ranges of consecutive tiles of a group that contain movable triangles.
fn movable_tiles(plan: &Plan, group: &Group, movable: &Movable) -> Vec<Range<u32>> {
    let moves = |&tile: &u32| {
        let slots = plan.layout.slots_of(&(tile..tile + 1));
        let triangles = slots.map(|slot| plan.layout.order[slot as usize]);
        triangles.into_iter().any(|i| i != PADDING && movable.triangle(i))
    };
    let tiles: Vec<u32> = group.tiles.clone().filter(moves).collect();
    tiles.chunk_by(|a, b| a + 1 == *b).map(|run| run[0]..run[run.len() - 1] + 1).collect()
}
