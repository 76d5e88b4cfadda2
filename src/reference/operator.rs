//! The reference as a [`LightOperator`] for the solvers.

use super::{Model, State, emission, transport};
use crate::solve::LightOperator;
use glam::DVec3;
use std::convert::Infallible;

impl LightOperator for &Model {
    type Vector = State;
    type Error = Infallible;

    fn vector(&mut self) -> Result<State, Infallible> {
        Ok(self.zero())
    }

    fn pass(&mut self, x: Option<&State>, with_emission: bool, y: &mut State) -> Result<(), Infallible> {
        let emitted = emission(self);
        let outgoing = match x {
            None => emitted,
            Some(x) => {
                let mut outgoing = self.leave(x);
                if with_emission {
                    for (l, e) in outgoing.diffuse.iter_mut().zip(emitted.diffuse) {
                        *l += e;
                    }
                }
                outgoing
            }
        };
        *y = transport(self, &outgoing);
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
        let weighted = |(h, f): (&DVec3, &super::Facet)| (f.area.sqrt() * *h).to_array();
        Ok(Some(x.irradiance.iter().zip(&self.facets).flat_map(weighted).collect()))
    }
}

impl State {
    fn values(&self) -> impl Iterator<Item = &DVec3> {
        self.irradiance.iter().chain(&self.bins)
    }

    fn values_mut(&mut self) -> impl Iterator<Item = &mut DVec3> {
        self.irradiance.iter_mut().chain(&mut self.bins)
    }
}
