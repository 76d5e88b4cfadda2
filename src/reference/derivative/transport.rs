//! The derivative of U with respect to the triangles.

use super::pair::pair_derivative;
use crate::model::FacetGradient;
use crate::reference::{Model, Outgoing, State};
use rayon::prelude::*;

/// The gradient of λ·U(outgoing) with respect to every triangle, what leaves and λ (`importance`) held fixed. Which side
/// of a source is seen, and whether a pair exchanges light at all, are no matters of degree and have no derivative.
///
/// Every triangle is once the source and once the receiver of every other; its gradient is summed in one place, as on the
/// device, where nothing may be added up across lanes.
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
