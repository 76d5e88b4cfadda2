//! The scene as the kernels read it, in the order and the coordinates of the plan.

use super::lobes::Lobes;
use super::real;
use super::state::pages;
use super::watch::TransportError;
use crate::gpu::{Buffer, BufferKind, Device, GpuError};
use crate::model::{Clusters, Facet, Parts};
use crate::plan::{Group, PADDING, PairLists, Plan};
use crate::scene::{Material, Scene};
use bytemuck::Pod;

/// Reals of a `Facet` of glsl/geometry.glsl: centre, area, normal, characteristic area.
pub const FACET: usize = 8;
/// Reals of the corners of a triangle: three vec4.
pub const CORNERS: usize = 12;
/// Reals of a `Surface` of glsl/surface.glsl: δρ, p; L_e, unused; σ N(p), unused.
pub const SURFACE: usize = 12;

fn facet_reals(f: &Facet) -> [f64; FACET] {
    let ([x, y, z], [u, v, w]) = (f.centroid.to_array(), f.normal.to_array());
    [x, y, z, f.area, u, v, w, f.characteristic_area]
}

fn corner_reals(f: &Facet) -> [f64; CORNERS] {
    let [[a, b, c], [d, e, g], [h, i, j]] = f.corners.map(|c| c.to_array());
    [a, b, c, 0.0, d, e, g, 0.0, h, i, j, 0.0]
}

fn surface_reals(m: &Material, emitted: [f64; 3], unit: f64) -> [f64; SURFACE] {
    let normalization = m.specular_normalization();
    let ([a, b, c], [d, e, f]) = (m.diffuse_albedo(), emitted.map(|l| l / unit));
    let [g, h, i] = m.specular.map(|sigma| sigma * normalization);
    [a, b, c, m.power, d, e, f, 0.0, g, h, i, 0.0]
}

/// Values of every slot, zero in padding.
fn by_slot<const N: usize>(plan: &Plan, value: impl Fn(usize) -> [f64; N]) -> Vec<f64> {
    let slot = |&i: &u32| if i == PADDING { [0.0; N] } else { value(i as usize) };
    plan.layout.order.iter().flat_map(slot).collect()
}

/// Buffers that operators only read.
pub struct SceneBuffers {
    /// Centroid, area, normal and characteristic area per slot: `Facet` of glsl/geometry.glsl.
    pub facets: Buffer,
    /// Three vec4 per slot.
    pub corners: Buffer,
    /// Material per slot: `Surface` of glsl/surface.glsl.
    pub surfaces: Buffer,
    /// Per glossy group, the radiance of lamps that it reflects, W/(m² sr), reals by triangle, bin, channel.
    pub first_bounce: Vec<Option<Buffer>>,
    /// Centre of each bin, and c_b.
    pub bin_table: Buffer,
    pub(super) lobes: Lobes,
    /// [`crate::plan::FarRuns`] by receiver; with clusters [`crate::model::SourceLists`].
    pub far_sources: Buffer,
    /// What each cluster consists of, two words each (glsl/cluster_parts.glsl).
    cluster_parts: Option<Buffer>,
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
    /// Uploads scene and plan; their sizes are those that the plan counts.
    pub fn new(device: &Device, scene: &Scene, plan: &Plan) -> Result<Self, GpuError> {
        let emission: Vec<[f64; 3]> =
            (0..scene.triangles.len()).map(|i| scene.material(i).emission).collect();
        Self::emitting(device, scene, plan, &emission, 1.0)
    }

    /// With the radiance that each triangle of the scene emits in place of its material's, W/(m² sr), and all light counted in units
    /// of `unit`, W/(m² sr).
    pub fn emitting(
        device: &Device,
        scene: &Scene,
        plan: &Plan,
        emitted: &[[f64; 3]],
        unit: f64,
    ) -> Result<Self, GpuError> {
        let bins = plan.bins.centre.iter().zip(&plan.bins.projected);
        let bin_table: Vec<f64> = bins.flat_map(|(c, &p)| [c.x, c.y, c.z, p]).collect();
        let mut facets = by_slot(plan, |i| facet_reals(&plan.facets[i]));
        let clusters = plan.clusters().map_or_else(Vec::new, |clusters| clusters.facets(&plan.facets));
        let volumes = plan.clusters().map_or_else(Vec::new, |clusters| clusters.volume_facets(&plan.facets));
        facets.extend(clusters.iter().chain(&volumes).flat_map(facet_reals));
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
            corners: reals("corners", &by_slot(plan, |i| corner_reals(&plan.facets[i])))?,
            surfaces: reals("surfaces", &surfaces(scene, plan, emitted, unit))?,
            first_bounce,
            bin_table: reals("bin table", &bin_table)?,
            lobes,
            far_sources: match plan.clusters() {
                None => list(device, plan, "far runs", far.words())?,
                Some(clusters) => list(device, plan, "cluster sources", clusters.sources().words())?,
            },
            cluster_parts: plan
                .clusters()
                .map(|clusters| filled(device, "cluster parts", &part_words(clusters)))
                .transpose()?,
            near_offsets: list(device, plan, "near offsets", &near.offsets)?,
            near_sources: list(device, plan, "near sources", &near.partners)?,
            near_targets: Buffer::new(
                device,
                "near targets",
                if plan.lists_on_device() { u64::from(plan.layout.slots()) * 4 } else { 0 },
                BufferKind::Storage,
            )?,
            no_bins: reals("no bins", &[0.0])?,
        })
    }

    /// What each cluster consists of, where there are clusters.
    pub(super) fn cluster_parts(&self) -> Result<&Buffer, TransportError> {
        self.cluster_parts.as_ref().ok_or_else(|| TransportError::missing("clusters"))
    }

    /// Sets the radiance of lamps that glossy triangles reflect, initially zero, per group as by [`super::Operators::set_first_bounce`].
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
        let surfaces = surfaces(scene, plan, emitted, unit);
        self.lobes.set(device, scene, plan)?;
        real::upload(device, &self.surfaces, plan.settings.precision, &surfaces)
    }
}

fn part_words(clusters: &Clusters) -> Vec<[u32; 2]> {
    let words = |parts: &Parts| match parts {
        Parts::Triangles(slots) => [slots.start, slots.end],
        Parts::Clusters(both) => *both,
    };
    clusters.parts().iter().map(words).collect()
}

fn surfaces(scene: &Scene, plan: &Plan, emitted: &[[f64; 3]], unit: f64) -> Vec<f64> {
    by_slot(plan, |i| surface_reals(scene.material(i), emitted[i], unit))
}

/// Lists of pairs; empty where the host computes what passes between them.
pub fn list(device: &Device, plan: &Plan, label: &str, words: &[u32]) -> Result<Buffer, GpuError> {
    filled(device, label, if plan.lists_on_device() { words } else { &[] })
}

pub fn filled<T: Pod>(device: &Device, label: &str, values: &[T]) -> Result<Buffer, GpuError> {
    let buffer = Buffer::new(device, label, std::mem::size_of_val(values) as u64, BufferKind::Storage)?;
    if !values.is_empty() {
        device.upload_slice(&buffer, 0, values)?;
    }
    Ok(buffer)
}
