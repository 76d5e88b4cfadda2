//! The compute shaders of `glsl/`, as SPIR-V by `build.rs`: one static per file, named after it (`combine.comp` is
//! [`COMBINE`]). Those that include `real.glsl` are there twice, as a [`RealShader`].

use crate::scene::Precision;

/// A compute shader with the entry point `main`.
#[derive(Debug)]
pub struct Shader {
    /// The file's name without `.comp`; it names the pipeline, its profile rows and its errors.
    pub name: &'static str,
    pub spirv: &'static [u32],
}

/// A shader in both precisions.
#[derive(Debug)]
pub struct RealShader {
    pub f32: Shader,
    pub f64: Shader,
}

impl RealShader {
    pub fn of(&self, precision: Precision) -> &Shader {
        match precision {
            Precision::F32 | Precision::Packed => &self.f32,
            Precision::F64 => &self.f64,
        }
    }
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
