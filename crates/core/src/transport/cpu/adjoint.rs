//! The transposed operators combined for the solvers: λ = λ₀ + (K - J)ᵀ (μ₀ + Uᵀ λ), with λ the adjoint of incident light (importance)
//! and μ the cotangent of outgoing light. A state of the adjoint holds the cotangents of irradiance and, per bin, of H(b).

use super::Operators;
use super::completion::{complete, complete_slots};
use super::derivative::GRADIENT;
use super::real::Real;
use super::scene::{SLOT, count, page_reals, reals, rows, values};
use super::state::Vector;
use super::vectors::clear;
use super::{observation_adjoint, reflection, reflection_adjoint};
use crate::backend::{Array, Cpu};
use crate::model::FacetGradient;
use crate::plan::Plan;
use crate::solve::{LightOperator, Orthonormalised};
use crate::transport::{Adjoint, LobeSums, OutgoingValues, State, TransportError};
use antirad_base::usage::OverBudget;
use antirad_scene::Movable;
use glam::DVec3;

/// The cotangents that the loss itself provides, and those that a pass accumulates.
pub struct AdjointArrays<T> {
    /// λ₀: cotangent of irradiance, four numbers per slot.
    pub irradiance: Array<T>,
    /// μ₀: cotangent of diffuse radiance, four numbers per slot; and of specular radiance, by glossy group,
    /// of the triangles of this rank.
    pub radiance: Array<T>,
    pub specular: Vec<Option<Array<T>>>,
    /// μ = μ₀ + Uᵀ λ: current cotangents of diffuse and of specular radiance, laid out like μ₀.
    pub current_radiance: Array<T>,
    pub current_specular: Vec<Option<Array<T>>>,
    /// Derivatives by geometry of each slot, sixteen numbers each.
    gradients: Option<Array<T>>,
    /// Derivatives by specular parameters, two rows of four numbers per slot.
    lobe_sums: Option<Array<T>>,
}

impl<T: Real> AdjointArrays<T> {
    /// Allocates the arrays that the plan counts; `None` without planned gradients.
    ///
    /// # Errors
    /// Fails if the memory budget of the CPU does not hold them.
    pub fn new(cpu: &Cpu, plan: &Plan) -> Result<Option<Self>, OverBudget> {
        if plan.interactions().by_source.is_none() {
            return Ok(None);
        }
        let request = plan.options.gradients;
        let slots = plan.layout.slots() as usize;
        let radiance = || cpu.array("cotangent: radiance", slots * SLOT);
        let page = |bytes: u64| {
            let reals = count::<T>(bytes);
            (reals > 0).then(|| cpu.array("cotangent: specular", reals)).transpose()
        };
        let specular = || plan.own_pages(|group| group.class.glossy).map(page).collect::<Result<_, _>>();
        let gradients = || cpu.array("facet gradients", slots * GRADIENT);
        let lobes = request.lobes() && plan.classes.iter().any(|class| class.glossy);
        Ok(Some(Self {
            irradiance: cpu.array("cotangent: irradiance", slots * SLOT)?,
            radiance: radiance()?,
            specular: specular()?,
            current_radiance: radiance()?,
            current_specular: specular()?,
            gradients: request.geometry().then(gradients).transpose()?,
            lobe_sums: lobes.then(|| cpu.array("lobe sums", 2 * slots * SLOT)).transpose()?,
        }))
    }
}

/// The adjoint of the light equation, for the solvers.
pub struct AdjointOperator<'a, T: Real> {
    operators: &'a mut Operators<T>,
}

impl<'a, T: Real> AdjointOperator<'a, T> {
    pub fn new(operators: &'a mut Operators<T>) -> Self {
        Self { operators }
    }

    /// y = [given] λ₀ + (K - J)ᵀ ([given] μ₀ + Uᵀ x); also stores the cotangent of outgoing light, of specular radiance that of the
    /// triangles of this rank.
    fn transpose(
        &mut self,
        x: Option<&Vector<T>>,
        given: bool,
        y: &mut Vector<T>,
    ) -> Result<(), TransportError> {
        self.start(given)?;
        clear(y);
        if let Some(x) = x {
            self.operators.exchange_adjoint(x, y)?;
        }
        let Operators { context, adjoint, .. } = &mut *self.operators;
        let adjoint = adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        for (g, specular) in adjoint.current_specular.iter().enumerate() {
            if let Some(specular) = specular {
                reflection_adjoint::specular(context, g, specular, &mut y.bins[g]);
            }
        }
        complete_slots(context.cpu.ranks(), &context.plan, &mut adjoint.current_radiance, SLOT)?;
        reflection_adjoint::diffuse(context, adjoint, given, &mut y.irradiance);
        Ok(())
    }

    /// Initialises μ to μ₀, or to zero.
    fn start(&mut self, given: bool) -> Result<(), TransportError> {
        let adjoint = self.operators.adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        let set = |to: &mut [T], from: &[T]| if given { to.copy_from_slice(from) } else { to.fill(T::ZERO) };
        set(&mut adjoint.current_radiance, &adjoint.radiance);
        for (to, from) in adjoint.current_specular.iter_mut().zip(&adjoint.specular) {
            if let (Some(to), Some(from)) = (to, from) {
                set(to, from);
            }
        }
        Ok(())
    }

    fn arrays(&self) -> Result<&AdjointArrays<T>, TransportError> {
        self.operators.adjoint.as_ref().ok_or(TransportError::NotPlanned)
    }

    /// Cotangents of specular radiance per group, of all ranks.
    fn gathered(&self, pages: &[Option<Array<T>>]) -> Result<Vec<Option<Vec<f64>>>, TransportError> {
        let context = &self.operators.context;
        let plan = &context.plan;
        let of_group = |(g, group): (usize, &crate::plan::Group)| {
            if !group.class.glossy {
                return Ok(None);
            }
            let mut all = vec![T::ZERO; page_reals(plan, group)];
            let own = reflection::within(context, g, &plan.layout.slots_of(&plan.own(g).tiles));
            all[own].copy_from_slice(pages[g].as_deref().unwrap_or(&[]));
            let first = plan.layout.slots_of(&group.tiles).start;
            complete(context.cpu.ranks(), &mut all, (first, context.bins()), &plan.slots_by_rank(g))?;
            Ok(Some(values(&all)))
        };
        plan.layout.groups.iter().enumerate().map(of_group).collect()
    }
}

impl<T: Real> Adjoint for AdjointOperator<'_, T> {
    fn set(
        &mut self,
        irradiance: &[[f64; 4]],
        radiance: &[[f64; 4]],
        specular: &[Option<Vec<f64>>],
    ) -> Result<(), TransportError> {
        let Operators { context, adjoint, .. } = &mut *self.operators;
        let adjoint = adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        adjoint.irradiance.copy_from_slice(&reals(irradiance.as_flattened()));
        adjoint.radiance.copy_from_slice(&reals(radiance.as_flattened()));
        for (g, page) in adjoint.specular.iter_mut().enumerate() {
            let Some(page) = page else { continue };
            let own = context.plan.layout.slots_of(&context.plan.own(g).tiles);
            match specular.get(g).and_then(Option::as_deref) {
                Some(values) => {
                    page.copy_from_slice(&reals(&values[reflection::within(context, g, &own)]));
                }
                None => page.fill(T::ZERO),
            }
        }
        Ok(())
    }

    fn add_view(&mut self, camera_position: DVec3, colours: &[[f64; 4]]) -> Result<(), TransportError> {
        let Operators { context, adjoint, .. } = &mut *self.operators;
        let adjoint = adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        observation_adjoint::transpose(context, adjoint, camera_position, colours);
        Ok(())
    }

    fn given_specular(&mut self) -> Result<Vec<Option<Vec<f64>>>, TransportError> {
        self.gathered(&self.arrays()?.specular)
    }

    fn outgoing_cotangent(&mut self, cotangent: &State) -> Result<OutgoingValues, TransportError> {
        // The bins of antiradiance go to a vector that is discarded.
        let mut unused = self.operators.take()?;
        self.transpose(Some(self::vector(cotangent)?), true, &mut unused)?;
        let radiance = rows(&self.arrays()?.current_radiance);
        Ok(OutgoingValues { radiance, specular: self.gathered(&self.arrays()?.current_specular)? })
    }

    fn lobe_sums(&mut self, x: &State) -> Result<Option<Vec<LobeSums>>, TransportError> {
        let Operators { context, adjoint, .. } = &mut *self.operators;
        let adjoint = adjoint.as_mut().ok_or(TransportError::NotPlanned)?;
        let AdjointArrays { lobe_sums: Some(sums), current_specular, .. } = adjoint else { return Ok(None) };
        reflection_adjoint::derivative(context, current_specular, vector(x)?, sums)?;
        let rgb = |v: &[T]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
        Ok(Some(sums.chunks_exact(2 * SLOT).map(|v| [rgb(v), rgb(&v[SLOT..])]).collect()))
    }

    fn geometry(
        &mut self,
        x: &State,
        cotangent: &State,
        views: &[(DVec3, Vec<[f64; 4]>)],
        movable: Option<&Movable>,
    ) -> Result<(Vec<FacetGradient>, Vec<DVec3>), TransportError> {
        let [x, cotangent] = [vector(x)?, vector(cotangent)?];
        // Taken out, since operators change what else they hold.
        let arrays = self.operators.adjoint.as_mut().and_then(|adjoint| adjoint.gradients.take());
        let mut gradients =
            arrays.ok_or_else(|| TransportError::missing("derivatives with respect to geometry"))?;
        gradients.fill(T::ZERO);
        let found = self.operators.geometry([x, cotangent], views, movable, &mut gradients);
        let result = found.map(|cameras| (facet_gradients(&gradients), cameras));
        if let Some(adjoint) = &mut self.operators.adjoint {
            adjoint.gradients = Some(gradients);
        }
        result
    }
}

/// A state as a vector of numbers of this type.
///
/// # Errors
/// Fails with [`TransportError::OtherBackend`] if the state is of another backend or precision.
pub fn vector<T: Real>(state: &State) -> Result<&Vector<T>, TransportError> {
    T::vector(state).ok_or(TransportError::OtherBackend)
}

/// The derivatives by facets, of each slot.
fn facet_gradients<T: Real>(gradients: &[T]) -> Vec<FacetGradient> {
    values(gradients).chunks_exact(GRADIENT).map(FacetGradient::of_slot).collect()
}

impl<T: Real> LightOperator for AdjointOperator<'_, T> {
    type Vector = State;
    type Error = TransportError;

    fn vector(&mut self) -> Result<State, TransportError> {
        self.operators.vector()
    }

    fn pass(&mut self, x: Option<&State>, emission: bool, y: &mut State) -> Result<(), TransportError> {
        let x = x.map(vector).transpose()?;
        self.transpose(x, emission, T::vector_mut(y).ok_or(TransportError::OtherBackend)?)
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, TransportError> {
        self.operators.dot(x, y)
    }

    fn combine(&mut self, a: f64, x: &State, b: f64, y: &mut State) -> Result<(), TransportError> {
        self.operators.combine(a, x, b, y)
    }

    fn accumulate(&mut self, a: &[f64], x: &[State], y: &mut State) -> Result<(), TransportError> {
        self.operators.accumulate(a, x, y)
    }

    fn orthonormalise(
        &mut self,
        basis: &[State],
        y: &mut State,
        spanned: f64,
    ) -> Result<Orthonormalised, TransportError> {
        Ok(Orthonormalised { column: self.operators.orthonormal(basis, y, spanned)?, judged: None })
    }

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), TransportError> {
        self.operators.scale(b, y)
    }

    /// All entries count: which of them matter depends on the loss.
    fn judged(&mut self, _: &State) -> Result<Option<Vec<f64>>, TransportError> {
        Ok(None)
    }
}
