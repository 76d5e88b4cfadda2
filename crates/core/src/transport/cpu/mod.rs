//! The operators of C = (1 - (K - J) U)^-1 E on the CPU: plain arrays, loops over blocks of pairs that compilers turn into vectors, all
//! cores. One file for each operator, of the same name as the Vulkan one; `far`, `close`, `pairs`, `pieces`, `taps` and `exchanged` are
//! what they share.
#![allow(clippy::needless_range_loop, reason = "of loops over lanes by index compilers make vectors")]

mod adjoint;
mod close;
mod close_adjoint;
mod close_derivative;
mod completion;
mod derivative;
mod exchange;
mod exchange_adjoint;
mod exchange_derivative;
mod exchanged;
mod far;
mod far_adjoint;
mod far_derivative;
mod lobes;
mod near_matrix;
mod observation;
mod observation_adjoint;
mod pairs;
mod pieces;
mod real;
mod reflection;
mod reflection_adjoint;
mod scene;
mod state;
mod steps;
mod taps;
mod vectors;

pub use real::Real;
pub use state::Vector;

use super::{
    Adjoint, Operators as _, OutgoingValues, State, TransportError, judged_irradiance, watch::PassCallback,
};
use crate::backend::{Array, Cpu};
use crate::plan::Plan;
use crate::solve::{LightOperator, Orthonormalised};
use adjoint::{AdjointArrays, AdjointOperator, vector};
use antirad_base::usage::LabelReport;
use antirad_scene::Scene;
use glam::DVec3;
use near_matrix::NearMatrix;
use scene::{Context, Outgoing, SceneArrays, reals, rows, values};
use state::Pool;
use std::sync::Arc;
use steps::Steps;

/// All operators over one planned scene, and its current outgoing light.
pub struct Operators<T: Real> {
    context: Context<T>,
    outgoing: Outgoing<T>,
    pool: Arc<Pool<T>>,
    /// Room for the bins of a group where several ranks hold them.
    window: Option<Array<T>>,
    /// The near-field matrix and its transpose; `None` where close pairs are evaluated in each pass.
    near: Option<NearMatrix<T>>,
    near_transposed: Option<NearMatrix<T>>,
    /// Cotangents; `None` where no gradients are planned.
    adjoint: Option<AdjointArrays<T>>,
    steps: Steps,
}

impl<T: Real> Operators<T> {
    /// Allocates what the plan counts.
    pub fn new(
        cpu: &Cpu,
        scene: &Scene,
        plan: Plan,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<Self, TransportError> {
        let cpu = cpu.scope();
        let scene = SceneArrays::new(&cpu, scene, &plan, emitted, unit)?;
        let context = Context { layout: taps::Layout::of(&plan), scene, cpu, plan };
        let Context { cpu, plan, .. } = &context;
        let matrix = plan.near_field_matrix();
        let near = matrix.map(|matrix| NearMatrix::new(cpu, &matrix.forward)).transpose()?;
        let transposed = matrix.and_then(|matrix| matrix.transposed.as_ref());
        let largest = plan.largest_group(|group| group.class.has_bins());
        let window = || cpu.array("state: bins", scene::count::<T>(u64::from(largest) * plan.tile_bytes()));
        let several = plan.options.ranks > 1 && largest > 0;
        Ok(Self {
            outgoing: Outgoing::new(cpu, plan)?,
            pool: Pool::new(cpu, plan)?,
            window: several.then(window).transpose()?,
            near,
            near_transposed: transposed.map(|matrix| NearMatrix::new(cpu, matrix)).transpose()?,
            adjoint: AdjointArrays::new(cpu, plan)?,
            steps: Steps::new(cpu),
            context,
        })
    }

    /// A vector of undefined values.
    fn take(&self) -> Result<Vector<T>, TransportError> {
        Ok(self.pool.take(&self.context.cpu, &self.context.plan)?)
    }

    /// The column of [`LightOperator::orthonormalise`], the same on all ranks.
    fn orthonormal(
        &mut self,
        basis: &[State],
        y: &mut State,
        spanned: f64,
    ) -> Result<Vec<f64>, TransportError> {
        let ranks = self.context.cpu.ranks();
        let basis: Vec<&Vector<T>> = basis.iter().map(vector).collect::<Result<_, _>>()?;
        let y = T::vector_mut(y).ok_or(TransportError::OtherBackend)?;
        let mut column = vec![match basis.last() {
            Some(last) => vectors::combine_dot(ranks, (1.0, last), (-1.0, y), basis.first().copied())?,
            None => vectors::dot(ranks, y, y)?,
        }];
        for (number, v) in basis.iter().enumerate() {
            let h = column[number];
            column.push(vectors::combine_dot(ranks, (-h, v), (1.0, y), basis.get(number + 1).copied())?);
        }
        if let Some(square) = column.last_mut() {
            *square = square.sqrt();
            vectors::scale(if *square <= spanned { 0.0 } else { 1.0 / *square }, y);
        }
        ranks.agree(&mut column)?;
        self.steps.done(0)?;
        Ok(column)
    }
}

impl<T: Real> super::Operators for Operators<T> {
    fn plan(&self) -> &Plan {
        &self.context.plan
    }

    fn allocated(&self) -> Vec<LabelReport> {
        self.context.cpu.scope_memory()
    }

    fn set_materials(
        &mut self,
        scene: &Scene,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<(), TransportError> {
        let Context { plan, scene: arrays, .. } = &mut self.context;
        arrays.set_materials(scene, plan, emitted, unit);
        Ok(())
    }

    fn set_first_bounce(&mut self, values: &[Option<Vec<f64>>]) -> Result<(), TransportError> {
        self.context.scene.set_first_bounce(values);
        Ok(())
    }

    fn set_pass_callback(&mut self, callback: Option<PassCallback>) {
        self.steps.set_callback(callback);
    }

    fn observe(&mut self, x: &State, camera_position: DVec3) -> Result<Vec<[f64; 4]>, TransportError> {
        let Self { context, outgoing, steps, .. } = self;
        let x = vector(x)?;
        reflection::diffuse(context, &mut outgoing.radiance, Some(x), true);
        Ok(observation::observe(context, outgoing, x, camera_position, steps)?)
    }

    fn irradiance(&self, x: &State) -> Result<Vec<[f64; 4]>, TransportError> {
        Ok(rows(&vector::<T>(x)?.irradiance))
    }

    fn bins(&mut self, x: &State, group: usize) -> Result<Option<Vec<f64>>, TransportError> {
        let has = self.context.plan.layout.groups[group].class.has_bins();
        let bins = exchange::show(&self.context, vector(x)?, group, &mut self.window)?;
        Ok(has.then(|| values::<T>(bins)))
    }

    fn set(
        &mut self,
        x: &mut State,
        irradiance: &[[f64; 4]],
        bins: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        let x = T::vector_mut(x).ok_or(TransportError::OtherBackend)?;
        x.irradiance.copy_from_slice(&reals(irradiance.as_flattened()));
        let plan = &self.context.plan;
        for ((g, own), given) in x.bins.iter_mut().enumerate().zip(bins) {
            if let Some(given) = given.as_ref().filter(|_| !own.is_empty()) {
                let slots = plan.layout.slots_of(&plan.own(g).tiles);
                own.copy_from_slice(&reals(&given[reflection::within(&self.context, g, &slots)]));
            }
        }
        Ok(())
    }

    fn fill(&mut self, x: &mut State, value: f64) -> Result<(), TransportError> {
        let x = T::vector_mut(x).ok_or(TransportError::OtherBackend)?;
        x.parts_mut().for_each(|part| vectors::fill(part, T::of(value)));
        Ok(())
    }

    fn outgoing(&mut self, x: &State) -> Result<OutgoingValues, TransportError> {
        let Self { context, outgoing, steps, .. } = self;
        let x = vector(x)?;
        reflection::diffuse(context, &mut outgoing.radiance, Some(x), true);
        let mut specular = Vec::new();
        for (g, group) in context.plan.layout.groups.iter().enumerate() {
            reflection::specular(context, &mut outgoing.specular, (Some(x), true), g, steps)?;
            specular.push(group.class.glossy.then(|| values(outgoing.specular.of(&context.plan, g))));
        }
        let slots = context.plan.layout.slots() as usize * scene::SLOT;
        Ok(OutgoingValues { radiance: rows(&outgoing.radiance[..slots]), specular })
    }

    fn adjoint(&mut self) -> Result<Box<dyn Adjoint + '_>, TransportError> {
        match self.adjoint {
            Some(_) => Ok(Box::new(AdjointOperator::new(self))),
            None => Err(TransportError::NotPlanned),
        }
    }
}

impl<T: Real> LightOperator for Operators<T> {
    type Vector = State;
    type Error = TransportError;

    fn vector(&mut self) -> Result<State, TransportError> {
        let mut vector = self.take()?;
        vectors::clear(&mut vector);
        Ok(T::state(vector))
    }

    fn pass(&mut self, x: Option<&State>, emission: bool, y: &mut State) -> Result<(), TransportError> {
        let x = x.map(vector).transpose()?;
        self.exchange(x, emission, T::vector_mut(y).ok_or(TransportError::OtherBackend)?)
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, TransportError> {
        let ranks = self.context.cpu.ranks();
        let mut product = [vectors::dot(ranks, vector::<T>(x)?, vector(y)?)?];
        ranks.agree(&mut product)?;
        Ok(product[0])
    }

    fn combine(&mut self, a: f64, x: &State, b: f64, y: &mut State) -> Result<(), TransportError> {
        let y = T::vector_mut(y).ok_or(TransportError::OtherBackend)?;
        vectors::combine((a, vector(x)?), (b, y));
        self.steps.done(0)
    }

    fn accumulate(&mut self, a: &[f64], x: &[State], y: &mut State) -> Result<(), TransportError> {
        let y = T::vector_mut(y).ok_or(TransportError::OtherBackend)?;
        let terms = a.iter().zip(x).map(|(a, x)| Ok((*a, vector(x)?)));
        vectors::accumulate(&terms.collect::<Result<Vec<_>, TransportError>>()?, y);
        self.steps.done(0)
    }

    fn orthonormalise(
        &mut self,
        basis: &[State],
        y: &mut State,
        spanned: f64,
    ) -> Result<Orthonormalised, TransportError> {
        let column = self.orthonormal(basis, y, spanned)?;
        Ok(Orthonormalised { column, judged: self.judged(y)? })
    }

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), TransportError> {
        vectors::scale(b, T::vector_mut(y).ok_or(TransportError::OtherBackend)?);
        self.steps.done(0)
    }

    fn judged(&mut self, x: &State) -> Result<Option<Vec<f64>>, TransportError> {
        let Context { cpu, plan, .. } = &self.context;
        let mut judged = judged_irradiance(plan, &self.irradiance(x)?);
        cpu.ranks().agree(&mut judged)?;
        Ok(Some(judged))
    }
}
