//! The light equation and its adjoint as [`LightOperator`]s for the solvers.
//!
//! For a loss F(H, C) with partial derivatives λ0 and μ0, the total derivatives λ = dF/dH and μ = dF/dC over all light paths
//! satisfy
//!
//! ```text
//! μ = μ0 + Uᵀ λ,   λ = λ0 + (K - J)ᵀ μ.
//! ```
//!
//! λ has the form of a [`State`] and μ that of [`Outgoing`]: an entry is the derivative with respect to that entry as it is
//! stored, so in particular with respect to H(b) / c_b.

use super::{Exchange, Model, Outgoing, State, emission, reflect_adjoint};
use antirad_core::model::Facet;
use antirad_core::solve::LightOperator;
use glam::DVec3;
use std::convert::Infallible;

impl LightOperator for &Model {
    type Vector = State;
    type Error = Infallible;

    fn vector(&mut self) -> Result<State, Infallible> {
        Ok(self.zero())
    }

    fn pass(&mut self, x: Option<&State>, with_emission: bool, y: &mut State) -> Result<(), Infallible> {
        let mut outgoing = x.map_or_else(|| self.dark(), |x| self.leave(x));
        if with_emission || x.is_none() {
            outgoing += &emission(self);
        }
        *y = Exchange::new(self).apply(&outgoing);
        Ok(())
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, Infallible> {
        Ok(x.values().zip(y.values()).map(|(a, b)| a.dot(*b)).sum())
    }

    fn combine(&mut self, a: f64, x: &State, b: f64, y: &mut State) -> Result<(), Infallible> {
        for (y, x) in y.values_mut().zip(x.values()) {
            *y = a * *x + b * *y;
        }
        Ok(())
    }

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), Infallible> {
        for y in y.values_mut() {
            *y *= b;
        }
        Ok(())
    }

    fn judged(&mut self, x: &State) -> Result<Option<Vec<f64>>, Infallible> {
        let weighted = |(h, f): (&DVec3, &Facet)| (f.area.sqrt() * *h).to_array();
        Ok(Some(x.irradiance.iter().zip(&self.facets).flat_map(weighted).collect()))
    }
}

/// The equation λ = λ0 + (K - J)ᵀ (μ0 + Uᵀ λ) for the solvers of [`antirad_core::solve`]; λ0 + (K - J)ᵀ μ0 takes the place of emission.
pub struct AdjointEquation<'a> {
    /// The discretised scene.
    pub model: &'a Model,
    /// λ0, the partial derivative of the loss with respect to the incident light.
    pub incident: State,
    /// μ0, the partial derivative of the loss with respect to the outgoing light.
    pub outgoing: Outgoing,
}

impl AdjointEquation<'_> {
    /// μ = μ0 + Uᵀ λ: the derivative of the loss with respect to the outgoing light, and hence to emission.
    pub fn outgoing(&self, importance: &State) -> Outgoing {
        let mut outgoing = Exchange::new(self.model).transpose(importance);
        outgoing += &self.outgoing;
        outgoing
    }
}

impl LightOperator for AdjointEquation<'_> {
    type Vector = State;
    type Error = Infallible;

    fn vector(&mut self) -> Result<State, Infallible> {
        Ok(self.model.zero())
    }

    fn pass(&mut self, x: Option<&State>, emission: bool, y: &mut State) -> Result<(), Infallible> {
        *y = match (x, emission) {
            (None, false) => self.model.zero(),
            (None, true) => reflect_adjoint(self.model, &self.outgoing),
            (Some(x), false) => reflect_adjoint(self.model, &Exchange::new(self.model).transpose(x)),
            (Some(x), true) => reflect_adjoint(self.model, &self.outgoing(x)),
        };
        if emission {
            self.model.combine(1.0, &self.incident, 1.0, y)?;
        }
        Ok(())
    }

    fn dot(&mut self, x: &State, y: &State) -> Result<f64, Infallible> {
        self.model.dot(x, y)
    }

    fn combine(&mut self, a: f64, x: &State, b: f64, y: &mut State) -> Result<(), Infallible> {
        self.model.combine(a, x, b, y)
    }

    fn scale(&mut self, b: f64, y: &mut State) -> Result<(), Infallible> {
        self.model.scale(b, y)
    }

    /// Convergence is judged by all entries: importance per bin is as much a result as that of irradiance, and includes the areas.
    fn judged(&mut self, _: &State) -> Result<Option<Vec<f64>>, Infallible> {
        Ok(None)
    }
}
