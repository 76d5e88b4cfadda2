//! K and E: reflection of incident light, and emission. Twin of crates/core/glsl/reflect.comp and first_bounce.comp.

use super::completion::complete;
use super::lobes::Side;
use super::real::Real;
use super::scene::{Context, SLOT, Specular, each_slot};
use super::state::Vector;
use super::steps::Steps;
use crate::transport::scene_values::SURFACE;
use antirad_base::ranks::RankError;
use std::f64::consts::FRAC_1_PI;
use std::ops::Range;

/// L_e in a `Surface` of crates/core/glsl/surface.glsl.
const EMISSION: usize = 4;

/// The diffuse radiance of the fronts: L_e with `emission`, and δρ/π of the irradiance of `x`.
pub fn diffuse<T: Real>(context: &Context<T>, radiance: &mut [T], x: Option<&Vector<T>>, emission: bool) {
    let surfaces = &context.scene.surfaces;
    let emitted = if emission { T::ONE } else { T::ZERO };
    let slots = context.plan.layout.slots() as usize * SLOT;
    each_slot(&mut radiance[..slots], |slot, radiance| {
        let surface = &surfaces[slot * SURFACE..][..SURFACE];
        let incident = x.map(|x| &x.irradiance[slot * SLOT..][..SLOT]);
        for c in 0..3 {
            let reflected = incident.map_or(T::ZERO, |e| surface[c] * T::of(FRAC_1_PI) * e[c]);
            radiance[c] = emitted * surface[EMISSION + c] + reflected;
        }
    });
}

/// The specular radiance of a group, of all ranks, which call it together; with `first_bounce`, what it reflects of lamps, too.
///
/// # Errors
/// Fails if another rank has ended, or does not call it.
pub fn specular<T: Real>(
    context: &Context<T>,
    to: &mut Specular<T>,
    (x, first_bounce): (Option<&Vector<T>>, bool),
    group: usize,
    steps: &Steps,
) -> Result<(), RankError> {
    let Context { cpu, plan, scene, .. } = context;
    let of = &plan.layout.groups[group];
    if !of.class.glossy {
        return Ok(());
    }
    match x {
        Some(x) => {
            reflect(context, to, x, group, steps);
            let first = plan.layout.slots_of(&of.tiles).start;
            let page = to.of_mut(plan, group);
            complete(cpu.ranks(), page, (first, context.bins()), &plan.slots_by_rank(group))?;
        }
        None => to.of_mut(plan, group).fill(T::ZERO),
    }
    if let Some(reflected) = scene.first_bounce[group].as_ref().filter(|_| first_bounce) {
        let page = to.of_mut(plan, group).iter_mut();
        page.zip(&reflected[..]).for_each(|(to, &reflected)| *to = reflected + *to);
    }
    Ok(())
}

/// The specular radiance of the triangles of a group that this rank holds, in its place in the group.
pub fn reflect<T: Real>(
    context: &Context<T>,
    to: &mut Specular<T>,
    x: &Vector<T>,
    group: usize,
    steps: &Steps,
) {
    let Context { plan, scene, .. } = context;
    if !plan.layout.groups[group].class.glossy {
        return;
    }
    let own = plan.layout.slots_of(&plan.own(group).tiles);
    let page = &mut to.of_mut(plan, group)[within(context, group, &own)];
    let pairs = own.len() as u64 * (context.layout.count as u64).pow(2);
    steps.timed("reflect", "bins to bins", pairs, || {
        scene.lobes.multiply(Side::Forward, &scene.surfaces, (&own, own.start), &x.bins[group], page);
    });
}

/// The range of numbers that the bins of some slots take in the page of their group.
pub fn within<T: Real>(context: &Context<T>, group: usize, slots: &Range<u32>) -> Range<usize> {
    let first = context.plan.layout.slots_of(&context.plan.layout.groups[group].tiles).start;
    let at = |slot: u32| (slot.max(first) - first) as usize * context.bins();
    at(slots.start)..at(slots.end)
}
