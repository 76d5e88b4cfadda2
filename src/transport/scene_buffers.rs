//! The scene as the kernels read it, in the order and the coordinates of the plan.

use crate::gpu::{Buffer, BufferKind, Device, GpuError};
use crate::plan::{PADDING, Plan};
use crate::scene::{Material, Scene};
use bytemuck::{Pod, Zeroable};

/// `Facet` of glsl/geometry.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct FacetData {
    pub centre: [f32; 3],
    pub area: f32,
    pub normal: [f32; 3],
    pub extent: f32,
}

/// `Surface` of glsl/surface.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct SurfaceData {
    pub diffuse: [f32; 3],
    pub power: f32,
    pub emission: [f32; 3],
    pub unused_emission: f32,
    pub specular: [f32; 3],
    pub unused_specular: f32,
}

impl From<&Material> for SurfaceData {
    fn from(material: &Material) -> Self {
        let normalization = material.specular_normalization();
        Self {
            diffuse: material.diffuse_albedo().map(|x| x as f32),
            power: material.power as f32,
            emission: material.emission.map(|x| x as f32),
            specular: material.specular.map(|x| (x * normalization) as f32),
            ..Self::default()
        }
    }
}

/// Buffers that no operator writes.
pub struct SceneBuffers {
    pub facets: Buffer,
    /// Three vec4 per slot.
    pub corners: Buffer,
    pub surfaces: Buffer,
    /// Centre of each bin, and c_b.
    pub bin_table: Buffer,
    pub tile_pairs: Buffer,
    pub near_offsets: Buffer,
    pub near_sources: Buffer,
    /// Bound where a kernel has no use for bins.
    pub no_bins: Buffer,
}

impl SceneBuffers {
    pub fn new(device: &Device, scene: &Scene, plan: &Plan) -> Result<Self, GpuError> {
        let slots = || plan.layout.order.iter().map(|&i| (i != PADDING).then_some(i as usize));
        let facets: Vec<FacetData> = slots()
            .map(|i| {
                i.map_or_else(FacetData::default, |i| {
                    let f = &plan.facets[i];
                    FacetData {
                        centre: f.centroid.as_vec3().to_array(),
                        area: f.area as f32,
                        normal: f.normal.as_vec3().to_array(),
                        extent: f.extent as f32,
                    }
                })
            })
            .collect();
        let corners: Vec<[f32; 4]> = slots()
            .flat_map(|i| {
                i.map_or([[0.0; 4]; 3], |i| {
                    plan.facets[i].corners.map(|c| c.as_vec3().extend(0.0).to_array())
                })
            })
            .collect();
        let surfaces: Vec<SurfaceData> =
            slots().map(|i| i.map_or_else(SurfaceData::default, |i| scene.material(i).into())).collect();
        let bins = plan.bins.centre.iter().zip(&plan.bins.projected);
        let bin_table: Vec<[f32; 4]> = bins.map(|(c, &p)| c.as_vec3().extend(p as f32).to_array()).collect();
        Ok(Self {
            facets: filled(device, "facets", &facets)?,
            corners: filled(device, "corners", &corners)?,
            surfaces: filled(device, "surfaces", &surfaces)?,
            bin_table: filled(device, "bin table", &bin_table)?,
            tile_pairs: filled(device, "tile pairs", &plan.tile_pairs.flags)?,
            near_offsets: filled(device, "near offsets", &plan.near.offsets)?,
            near_sources: filled(device, "near sources", &plan.near.sources)?,
            no_bins: filled(device, "no bins", &[0.0f32])?,
        })
    }

    /// Replaces the materials; geometry and classes stay as planned.
    pub fn set_materials(&self, device: &Device, scene: &Scene, plan: &Plan) -> Result<(), GpuError> {
        let surface = |&i: &u32| match i {
            PADDING => SurfaceData::default(),
            i => scene.material(i as usize).into(),
        };
        let surfaces: Vec<SurfaceData> = plan.layout.order.iter().map(surface).collect();
        device.upload_slice(&self.surfaces, 0, &surfaces)
    }
}

fn filled<T: Pod>(device: &Device, label: &str, values: &[T]) -> Result<Buffer, GpuError> {
    let buffer = Buffer::new(device, label, std::mem::size_of_val(values) as u64, BufferKind::Storage)?;
    if !values.is_empty() {
        device.upload_slice(&buffer, 0, values)?;
    }
    Ok(buffer)
}
