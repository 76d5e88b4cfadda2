//! Sᵀ, and the derivative of S with respect to geometry and camera.

use super::adjoint::AdjointBuffers;
use super::state::{page, page_of};
use super::watch::TransportError;
use super::{Context, WORKGROUP, bin_constants, real};
use crate::gpu::{Buffer, Device, GpuError, Pipeline};
use crate::plan::{Group, Plan};
use crate::shaders;
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
            Pipeline::new(device, shader, 4, push, &constants(glossy), None)
        };
        let derivative = shaders::OBSERVE_DERIVATIVE.of(precision);
        Ok(Self {
            adjoint: [adjoint(0)?, adjoint(1)?],
            derivative: Pipeline::new(device, derivative, 4, push, &constants(1), None)?,
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
        let mut batch = device.batch()?;
        for (g, group) in plan.layout.groups.iter().enumerate() {
            let buffers = [
                scene.facets.whole(),
                face_colours.whole(),
                adjoint.radiance.whole(),
                page_of(&adjoint.specular, g, group.class.glossy, &scene.no_bins)?,
            ];
            let kernel = &self.adjoint[usize::from(group.class.glossy)];
            let (push, groups) = whole_group(plan, group, camera_position);
            batch.dispatch(kernel, "all", &buffers, &push, groups)?;
        }
        batch.submit()?;
        Ok(())
    }

    /// Adds to `gradients` the derivative of ⟨`colours`, S L⟩ by the geometry, and returns that by the camera
    /// position, per unit of length of the engine; L is the current outgoing light. Both are zero without glossy
    /// triangles: diffuse radiance is the same in all directions.
    pub fn derivative(
        &self,
        context: &Context,
        face_colours: &Buffer,
        gradients: &Buffer,
        camera_position: DVec3,
        colours: &[[f64; 4]],
    ) -> Result<DVec3, TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        real::upload(device, face_colours, plan.settings.precision, colours.as_flattened())?;
        let mut batch = device.batch()?;
        for (g, group) in plan.glossy_groups() {
            let specular = page(&outgoing.specular, g)?;
            let buffers = [scene.facets.whole(), face_colours.whole(), specular.whole(), gradients.whole()];
            let (push, groups) = whole_group(plan, group, camera_position);
            batch.dispatch(&self.derivative, "glossy fronts", &buffers, &push, groups)?;
        }
        batch.submit()?;
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

fn whole_group(plan: &Plan, group: &Group, camera_position: DVec3) -> (Vec<u8>, [u32; 3]) {
    let slots = plan.layout.slots_of(&group.tiles);
    let camera_position = plan.placement.apply(camera_position).to_array();
    let push = real::push(plan.settings.precision, &camera_position, &[slots.start, slots.end]);
    (push, [(slots.len() as u32).div_ceil(WORKGROUP), 1, 1])
}
