//! S: the radiance of each triangle towards a camera. Twin of crates/core/glsl/observe.comp.

use super::completion::complete_slots;
use super::pairs::{Facet, R2_MIN, dot, minus, times};
use super::real::Real;
use super::reflection::{self, within};
use super::scene::{Context, Outgoing, SLOT, rows};
use super::state::Vector;
use super::steps::Steps;
use super::taps::{Taps, add};
use antirad_base::ranks::RankError;
use glam::DVec3;

/// Radiance of every slot towards `camera_position` (metres), W/(m² sr), under the incident light `x`, of which the diffuse radiance is
/// computed. All ranks call it.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn observe<T: Real>(
    context: &Context<T>,
    outgoing: &mut Outgoing<T>,
    x: &Vector<T>,
    camera_position: DVec3,
    steps: &Steps,
) -> Result<Vec<[f64; 4]>, RankError> {
    let Context { cpu, plan, scene, layout } = context;
    let camera = placed(context, camera_position);
    let mut colours = vec![T::ZERO; plan.layout.slots() as usize * SLOT];
    for g in 0..plan.layout.groups.len() {
        let own = plan.own(g);
        let slots = plan.layout.slots_of(&own.tiles);
        reflection::reflect(context, &mut outgoing.specular, x, g, steps);
        let page = if own.class.glossy { within(context, g, &slots) } else { 0..0 };
        let specular = outgoing.specular.of(plan, g);
        let bins = specular[page].chunks_exact(context.bins());
        let mut bins = bins.map(Some).chain(std::iter::repeat(None));
        for slot in slots {
            let facet = Facet::read(&scene.facets, slot);
            let bins = bins.next().flatten();
            let Some(direction) = towards(&facet, camera) else { continue };
            let mut colour = [T::ZERO; 4];
            let radiance = &outgoing.radiance[slot as usize * SLOT..][..SLOT];
            colour[..3].copy_from_slice(&radiance[..3]);
            if let Some(bins) = bins {
                let mut taps = Taps::<T, 1>::NONE;
                taps.set(layout, |_| facet.in_frame(direction));
                add(&mut colour, T::ONE, taps.gather(0, layout, bins));
            }
            colours[slot as usize * SLOT..][..3].copy_from_slice(&colour[..3]);
        }
    }
    complete_slots(cpu.ranks(), plan, &mut colours, SLOT)?;
    Ok(rows(&colours))
}

/// A point in the coordinates of the plan.
pub fn placed<T: Real>(context: &Context<T>, point: DVec3) -> [T; 3] {
    context.plan.placement.apply(point).to_array().map(T::of)
}

/// The direction from a front towards a camera; `None` from behind.
pub fn towards<T: Real>(facet: &Facet<T>, camera: [T; 3]) -> Option<[T; 3]> {
    let to_camera = minus(camera, facet.centre);
    let seen = dot(to_camera, facet.normal) > T::ZERO;
    let length2 = dot(to_camera, to_camera).most(T::of(R2_MIN));
    seen.then(|| times(T::ONE / length2.root(), to_camera))
}
