//! The scene as the kernels read it, in the order and the coordinates of the plan.

use super::lobes::Lobes;
use super::real;
use super::state::pages;
use crate::plan::{Group, PairLists, Plan};
use crate::transport::scene_values::{self, FACET};
use antirad_gpu::{Buffer, BufferKind, Device, GpuError};
use antirad_scene::Scene;
use bytemuck::Pod;

/// Buffers that operators only read.
pub struct SceneBuffers {
    /// Centroid, area, normal and characteristic area per slot: `Facet` of crates/core/glsl/geometry.glsl.
    pub facets: Buffer,
    /// Three vec4 per slot.
    pub corners: Buffer,
    /// Material per slot: `Surface` of crates/core/glsl/surface.glsl.
    pub surfaces: Buffer,
    /// Per glossy group, the radiance of lamps that it reflects, W/(m² sr), reals by triangle, bin, channel.
    pub first_bounce: Vec<Option<Buffer>>,
    /// Centre of each bin, and c_b.
    pub bin_table: Buffer,
    pub(super) lobes: Lobes,
    /// [`crate::plan::FarRuns`] by receiver.
    pub far_sources: Buffer,
    /// Offset of the close sources of each slot in `near_sources`, then the end of the last.
    pub near_offsets: Buffer,
    /// Slots of close sources, by receiver.
    pub near_sources: Buffer,
    /// Slots of the targets of a sweep over close pairs, in the order of the lanes.
    pub near_targets: Buffer,
    /// Bound in place of bins where a kernel reads none.
    pub no_bins: Buffer,
}

impl SceneBuffers {
    /// Uploads scene and plan; their sizes are those that the plan counts. `emitted`: the radiance that each triangle of the scene emits in
    /// place of its material's, W/(m² sr); all light is counted in units of `unit`, W/(m² sr).
    pub fn emitting(
        device: &Device,
        scene: &Scene,
        plan: &Plan,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<Self, GpuError> {
        let mut facets = scene_values::facets(plan);
        facets.resize(facets.len() + plan.partner_slots() as usize * FACET, 0.0);
        let reals =
            |label: &str, values: &[f64]| real::filled(device, label, plan.settings.precision, values);
        let PairLists { far, near } = &plan.interactions().by_receiver;
        let mut lobes = Lobes::new(device, plan)?;
        lobes.set(device, scene, plan)?;
        // Of all ranks: each reflects what passes by.
        let lit = |group: &Group| plan.has_first_bounce() && group.class.glossy;
        let bytes = |group: &Group| if lit(group) { plan.page_bytes(group) } else { 0 };
        let first_bounce = pages(device, "first bounce", plan.layout.groups.iter().map(bytes))?;
        let mut batch = device.batch()?;
        for page in first_bounce.iter().flatten() {
            batch.fill(page, 0, page.bytes(), 0)?;
        }
        batch.defer()?;
        Ok(Self {
            facets: reals("facets", &facets)?,
            corners: reals("corners", &scene_values::corners(plan))?,
            surfaces: reals("surfaces", &scene_values::surfaces(scene, plan, emitted, unit))?,
            first_bounce,
            bin_table: reals("bin table", &scene_values::bin_table(plan))?,
            lobes,
            far_sources: filled(device, "far runs", far.words())?,
            near_offsets: filled(device, "near offsets", &near.offsets)?,
            near_sources: filled(device, "near sources", &near.partners)?,
            near_targets: Buffer::new(
                device,
                "near targets",
                u64::from(plan.layout.slots()) * 4,
                BufferKind::Storage,
            )?,
            no_bins: reals("no bins", &[0.0])?,
        })
    }

    /// Sets the radiance of lamps that glossy triangles reflect, initially zero, per group as by [`super::Operators::set_first_bounce`].
    ///
    /// # Errors
    /// Fails if the device cannot write to the pages.
    pub fn set_first_bounce(
        &self,
        device: &Device,
        plan: &Plan,
        values: &[Option<Vec<f64>>],
    ) -> Result<(), GpuError> {
        for (page, values) in self.first_bounce.iter().zip(values) {
            if let (Some(page), Some(values)) = (page, values) {
                real::upload(device, page, plan.settings.precision, values)?;
            }
        }
        Ok(())
    }

    /// Replaces the materials and what is emitted; geometry and classes stay as planned.
    pub fn set_materials(
        &mut self,
        device: &Device,
        scene: &Scene,
        plan: &Plan,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<(), GpuError> {
        let surfaces = scene_values::surfaces(scene, plan, emitted, unit);
        self.lobes.set(device, scene, plan)?;
        real::upload(device, &self.surfaces, plan.settings.precision, &surfaces)
    }
}

pub fn filled<T: Pod>(device: &Device, label: &str, values: &[T]) -> Result<Buffer, GpuError> {
    let buffer = Buffer::new(device, label, std::mem::size_of_val(values) as u64, BufferKind::Storage)?;
    if !values.is_empty() {
        device.upload_slice(&buffer, 0, values)?;
    }
    Ok(buffer)
}
