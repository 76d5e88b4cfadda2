//! Sᵀ, and the derivative of S with respect to geometry and camera. Twin of crates/core/glsl/observe_adjoint.comp and observe_derivative.comp.

use super::adjoint::AdjointArrays;
use super::completion::complete_slots;
use super::derivative::GRADIENT;
use super::exchanged::product;
use super::observation::{placed, towards};
use super::pairs::{Facet, dot, minus, through_normalization};
use super::real::Real;
use super::reflection::within;
use super::scene::{Context, SLOT, Specular};
use super::taps::{Taps, flush};
use antirad_base::ranks::RankError;
use glam::DVec3;

/// Adds Sᵀ `colours` to the cotangent μ₀ of the loss. `camera_position` in metres; `colours` per slot.
pub fn transpose<T: Real>(
    context: &Context<T>,
    adjoint: &mut AdjointArrays<T>,
    camera_position: DVec3,
    colours: &[[f64; 4]],
) {
    let Context { plan, scene, layout, .. } = context;
    let camera = placed(context, camera_position);
    let mut bins = vec![[T::ZERO; 4]; layout.count];
    for g in 0..plan.layout.groups.len() {
        let own = plan.layout.slots_of(&plan.own(g).tiles);
        for slot in own.clone() {
            let facet = Facet::read(&scene.facets, slot);
            let Some(direction) = towards(&facet, camera) else { continue };
            let colour = colours[slot as usize].map(T::of);
            let radiance = &mut adjoint.radiance[slot as usize * SLOT..][..3];
            radiance.iter_mut().zip(colour).for_each(|(to, colour)| *to += colour);
            if let Some(page) = &mut adjoint.specular[g] {
                let mut taps = Taps::<T, 1>::NONE;
                taps.set(layout, |_| facet.in_frame(direction));
                taps.scatter(0, layout, &mut bins, colour);
                let to = &mut page[(slot - own.start) as usize * context.bins()..][..context.bins()];
                flush(layout, &mut bins, |_| T::ONE, to);
            }
        }
    }
}

/// Adds to `gradients` the derivative of ⟨`colours`, S L⟩ by the geometry of this rank's glossy triangles of a group, whose specular
/// radiance L is `specular`, and sets the colours of these slots to that by the camera's position, per unit of length of the engine.
pub fn derivative<T: Real>(
    context: &Context<T>,
    group: usize,
    specular: &Specular<T>,
    camera_position: DVec3,
    colours: &mut [T],
    gradients: &mut [T],
) {
    let Context { plan, scene, layout, .. } = context;
    let camera = placed(context, camera_position);
    let own = plan.layout.slots_of(&plan.own(group).tiles);
    let bins = &specular.of(plan, group)[within(context, group, &own)];
    for (slot, bins) in own.zip(bins.chunks_exact(context.bins())) {
        let facet = Facet::read(&scene.facets, slot);
        let colour = &mut colours[slot as usize * SLOT..][..SLOT];
        let cotangent = [colour[0], colour[1], colour[2], T::ZERO];
        colour.fill(T::ZERO);
        let Some(direction) = towards(&facet, camera) else { continue };
        let local = facet.in_frame(direction);
        let mut taps = Taps::<T, 1>::NONE;
        taps.set(layout, |_| local);
        let by_tap = taps.terms(0, layout, bins).map(|(_, value)| product(value, cotangent));
        let [by_row, by_column] = taps.slopes(0, by_tap);
        let mut by_local = [[T::ZERO; 1]; 3];
        layout.gradients(&local.map(|v| [v]), &[[by_row], [by_column]], &mut by_local);
        let by_local = by_local.map(|[by]| by);
        let to_camera = minus(camera, facet.centre);
        let length = dot(to_camera, to_camera).root();
        let by_camera = through_normalization(facet.out_of_frame(by_local), direction, length);
        colour[..3].copy_from_slice(&by_camera);
        let by_normal = facet.frame_gradient(direction, by_local);
        let gradient = &mut gradients[slot as usize * GRADIENT..][..GRADIENT];
        for a in 0..3 {
            (0..3).for_each(|corner| gradient[4 * corner + a] += -(by_camera[a] / T::of(3.0)));
            gradient[12 + a] += by_normal[a];
        }
    }
}

/// The sum of the rows of colours that are derivatives by the camera, over all glossy triangles. All ranks call it.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn by_camera<T: Real>(context: &Context<T>, colours: &mut [T]) -> Result<DVec3, RankError> {
    let Context { cpu, plan, .. } = context;
    complete_slots(cpu.ranks(), plan, colours, SLOT)?;
    let of_group = |group: &crate::plan::Group| {
        let slots = plan.layout.slots_of(&group.tiles);
        let rows = colours[slots.start as usize * SLOT..slots.end as usize * SLOT].chunks_exact(SLOT);
        rows.map(|row| DVec3::new(row[0].into(), row[1].into(), row[2].into())).sum::<DVec3>()
    };
    Ok(plan.glossy_groups().map(|(_, group)| of_group(group)).sum())
}
