//! Sᵀ, and the derivative of S with respect to geometry and camera.

use super::adjoint::{AdjointBuffers, specular_of};
use super::bundle::PassMonitor;
use super::reflection::Reflection;
use super::residency::{Part, View};
use super::specular::Specular;
use super::state::State;
use super::{Context, WORKGROUP, bin_constants, real};
use crate::plan::{Group, Piece, Plan};
use crate::shaders;
use crate::transport::TransportError;
use antirad_gpu::{Buffer, Device, GpuError, Pipeline};
use glam::DVec3;

pub struct ObservationAdjoint {
    /// Kernels of diffuse triangles, and of glossy ones.
    adjoint: [Pipeline; 2],
    derivative: Pipeline,
}

impl ObservationAdjoint {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let precision = plan.settings.precision;
        let push = real::push_bytes(precision, 3, 2);
        let constants = |glossy: u32| [&[(0, WORKGROUP), (8, glossy)][..], &bin_constants(plan)].concat();
        let adjoint = |glossy: u32| {
            let shader = shaders::OBSERVE_ADJOINT.of(precision);
            Pipeline::new(device, shader, 4, push, &constants(glossy))
        };
        let derivative = shaders::OBSERVE_DERIVATIVE.of(precision);
        Ok(Self {
            adjoint: [adjoint(0)?, adjoint(1)?],
            derivative: Pipeline::new(device, derivative, 4, push, &constants(1))?,
        })
    }

    /// Adds Sᵀ `colours` to the cotangent μ₀ of the loss. `camera_position` in metres; `colours` per slot.
    pub fn run(
        &self,
        context: &Context,
        adjoint: &AdjointBuffers,
        face_colours: &Buffer,
        camera_position: DVec3,
        colours: &[[f64; 4]],
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        real::upload(device, face_colours, plan.settings.precision, colours.as_flattened())?;
        for (g, group) in plan.layout.groups.iter().enumerate() {
            let glossy = group.class.glossy;
            let specular = glossy.then(|| adjoint.specular.show(context, Specular::Given, g)).transpose()?;
            let buffers = [
                scene.facets.whole(),
                face_colours.whole(),
                adjoint.radiance.whole(),
                specular.as_ref().map_or(scene.no_bins.whole(), View::slice),
            ];
            let kernel = &self.adjoint[usize::from(glossy)];
            let Some((push, groups)) = whole_group(plan, &plan.own(g), camera_position) else { continue };
            let mut batch = device.batch()?;
            batch.dispatch(kernel, "all", &buffers, &push, groups)?;
            batch.defer()?;
            if let Some(view) = specular {
                adjoint.specular.keep(context, Specular::Given, g, &view)?;
            }
        }
        Ok(())
    }

    /// Adds to `gradients` the derivative of ⟨`colours`, S L⟩ by the geometry of what this rank holds, and returns that by the camera
    /// position, per unit of length of the engine; L is the current outgoing light, of the incident light `x`. Both are zero without
    /// glossy triangles: diffuse radiance is the same in all directions.
    pub fn derivative(
        &self,
        context: &Context,
        (reflection, x): (&mut Reflection, &State),
        [face_colours, gradients]: [&Buffer; 2],
        (camera_position, colours): (DVec3, &[[f64; 4]]),
        monitor: &mut PassMonitor,
    ) -> Result<DVec3, TransportError> {
        let Context { device, plan, scene, .. } = context;
        real::upload(device, face_colours, plan.settings.precision, colours.as_flattened())?;
        for (g, _) in plan.glossy_groups() {
            let held = plan.own(g);
            let Some((push, groups)) = whole_group(plan, &held, camera_position) else { continue };
            let piece = Piece { group: g, part: held };
            let light = Part::held(plan, g).map(|part| x.edit(device, &part, true)).transpose()?;
            let specular = specular_of(context, reflection, &piece, light.as_ref(), monitor)?;
            let buffers = [scene.facets.whole(), face_colours.whole(), specular, gradients.whole()];
            let mut batch = device.batch()?;
            batch.dispatch(&self.derivative, "glossy fronts", &buffers, &push, groups)?;
            batch.defer()?;
        }
        context.complete_slots(face_colours, plan.rgb_bytes())?;
        let by_eye = context.slots(face_colours)?;
        let of_group = |group: &Group| {
            let slots = plan.layout.slots_of(&group.tiles);
            by_eye[slots.start as usize..slots.end as usize]
                .iter()
                .map(|&[x, y, z, _]| DVec3::new(x, y, z))
                .sum::<DVec3>()
        };
        Ok(plan.glossy_groups().map(|(_, group)| of_group(group)).sum())
    }
}

/// Push constants and workgroups for a group; `None` where it is empty.
fn whole_group(plan: &Plan, group: &Group, camera_position: DVec3) -> Option<(Vec<u8>, [u32; 3])> {
    let slots = plan.layout.slots_of(&group.tiles);
    let camera_position = plan.placement.apply(camera_position).to_array();
    let push = real::push(plan.settings.precision, &camera_position, &[slots.start, slots.end]);
    (!slots.is_empty()).then(|| (push, [(slots.len() as u32).div_ceil(WORKGROUP), 1, 1]))
}
