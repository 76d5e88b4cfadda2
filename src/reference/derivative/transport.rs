//! The derivative of U with respect to the triangles.

use super::pair::pair_derivative;
use crate::model::FacetGradient;
use crate::reference::{Model, Outgoing, State};
use rayon::prelude::*;

/// The gradient of λ·U(outgoing) with respect to every triangle, outgoing light and λ (`importance`) held fixed. The visible side
/// of a source, and whether a pair exchanges light at all, are discrete and have no derivative.
///
/// Each triangle is both source and receiver of every other. Its gradient is one sum over both roles, as on the device, where no
/// sum crosses lanes.
pub fn transport_derivative(model: &Model, outgoing: &Outgoing, importance: &State) -> Vec<FacetGradient> {
    let count = model.facets.len();
    let gradient = |k: usize| {
        let mut sum = FacetGradient::default();
        for other in 0..count {
            sum += pair_derivative(model, outgoing, importance, k, other).source;
            sum += pair_derivative(model, outgoing, importance, other, k).receiver;
        }
        sum
    };
    (0..count).into_par_iter().map(gradient).collect()
}
