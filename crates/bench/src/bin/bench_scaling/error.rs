//! The error of a bounce through clusters, against the exact sum in f64 at some receivers.

use antirad::plan::Plan;
use antirad::scene::Scene;
use antirad_core::plan::PADDING;
use antirad_core::transport::{Operators, State, TransportError};
use antirad_reference::{Exchange, Model, Outgoing};
use glam::DVec3;

/// Receivers at which the exact sum is computed.
const RECEIVERS: usize = 200;

/// Relative L2 error of the irradiance of the second bounce, weighted by area: its light varies as that of solutions does.
pub fn of_second_bounce(
    operators: &mut dyn Operators,
    scene: &Scene,
    plan: &Plan,
) -> Result<f64, TransportError> {
    let mut x = operators.vector()?;
    operators.pass(None, true, &mut x)?;
    let mut y = operators.vector()?;
    operators.pass(Some(&x), true, &mut y)?;
    let found = operators.irradiance(&y)?;
    let model = Model::with_classes(scene, plan.classes().to_vec());
    let outgoing = outgoing(operators, &x, &model, plan)?;
    let slots: Vec<usize> = (0..found.len()).filter(|&slot| plan.layout().order[slot] != PADDING).collect();
    let sampled: Vec<usize> = slots.into_iter().step_by((model.facets.len() / RECEIVERS).max(1)).collect();
    let receivers: Vec<usize> = sampled.iter().map(|&slot| plan.layout().order[slot] as usize).collect();
    let truth = Exchange::new(&model, None).irradiance(&outgoing, &receivers);
    let (mut off, mut all) = (0.0, 0.0);
    for ((&slot, &j), truth) in sampled.iter().zip(&receivers).zip(truth) {
        let [r, g, b, _] = found[slot];
        off += model.facets[j].area * (DVec3::new(r, g, b) - truth).length_squared();
        all += model.facets[j].area * truth.length_squared();
    }
    Ok((off / all).sqrt())
}

/// What leaves all triangles under a state of the device.
fn outgoing(
    operators: &mut dyn Operators,
    x: &State,
    model: &Model,
    plan: &Plan,
) -> Result<Outgoing, TransportError> {
    let channels = plan.channels() as usize;
    let width = model.bins.count() * channels;
    let rgb = |v: &[f64]| if channels == 3 { DVec3::new(v[0], v[1], v[2]) } else { DVec3::splat(v[0]) };
    let values = operators.outgoing(x)?;
    let mut outgoing = model.dark();
    for (&i, radiance) in plan.layout().order.iter().zip(&values.radiance) {
        if i != PADDING {
            outgoing.diffuse[i as usize] = rgb(&radiance[..3]);
        }
    }
    for (g, group) in plan.layout().groups.iter().enumerate() {
        let pages = [values.specular[g].clone(), operators.bins(x, g)?];
        for (page, to) in pages.into_iter().zip([&mut outgoing.specular, &mut outgoing.antiradiance]) {
            let Some(page) = page else { continue };
            for (row, slot) in page.chunks(width).zip(plan.layout().slots_of(&group.tiles)) {
                let i = plan.layout().order[slot as usize];
                let Some(range) = (i != PADDING).then(|| model.bins_of(i as usize)).flatten() else {
                    continue;
                };
                to[range].iter_mut().zip(row.chunks(channels)).for_each(|(to, value)| *to = rgb(value));
            }
        }
    }
    Ok(outgoing)
}
