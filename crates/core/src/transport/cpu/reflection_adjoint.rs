//! Kᵀ, and the derivative of K with respect to specular parameters. Twin of crates/core/glsl/reflect_adjoint.comp.

use super::adjoint::AdjointArrays;
use super::completion::complete_slots;
use super::lobes::Side;
use super::real::Real;
use super::scene::{Context, SLOT, each_slot};
use super::state::Vector;
use crate::backend::Array;
use crate::transport::scene_values::SURFACE;
use antirad_base::ranks::RankError;
use std::f64::consts::FRAC_1_PI;

/// The irradiance of a state of the adjoint: Kᵀ of the current μ, plus λ₀ of the loss if `given`.
pub fn diffuse<T: Real>(context: &Context<T>, adjoint: &AdjointArrays<T>, given: bool, irradiance: &mut [T]) {
    let surfaces = &context.scene.surfaces;
    let given = if given { T::ONE } else { T::ZERO };
    each_slot(irradiance, |slot, irradiance| {
        let at = slot * SLOT;
        for c in 0..3 {
            let reflected =
                surfaces[slot * SURFACE + c] * T::of(FRAC_1_PI) * adjoint.current_radiance[at + c];
            irradiance[c] = given * adjoint.irradiance[at + c] + reflected;
        }
        irradiance[3] = T::ZERO;
    });
}

/// Adds Kᵀ of the cotangent of specular radiance of this rank's triangles of a group to their bins.
pub fn specular<T: Real>(context: &Context<T>, group: usize, specular: &[T], bins: &mut [T]) {
    let Context { plan, scene, .. } = context;
    let own = plan.layout.slots_of(&plan.own(group).tiles);
    scene.lobes.multiply(Side::Transposed, &scene.surfaces, (&own, own.start), specular, bins);
}

/// `sums` = derivatives by the specular parameters under the incident light `x`, from the current μ of specular radiance.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn derivative<T: Real>(
    context: &Context<T>,
    specular: &[Option<Array<T>>],
    x: &Vector<T>,
    sums: &mut [T],
) -> Result<(), RankError> {
    let Context { cpu, plan, scene, .. } = context;
    sums.fill(T::ZERO);
    for (g, cotangent) in specular.iter().enumerate() {
        let Some(cotangent) = cotangent else { continue };
        let own = plan.layout.slots_of(&plan.own(g).tiles);
        let found = scene.lobes.derivatives(&scene.surfaces, (&own, own.start), &x.bins[g], cotangent);
        for (slot, rows) in found {
            for (row, sum) in rows.iter().enumerate() {
                sums[(2 * slot as usize + row) * SLOT..][..3].copy_from_slice(sum);
            }
        }
    }
    complete_slots(cpu.ranks(), plan, sums, 2 * SLOT)
}
