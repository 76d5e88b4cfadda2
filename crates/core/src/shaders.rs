//! The compute shaders of `crates/core/glsl/`, as SPIR-V by `build.rs`: one static per file, named after it (`combine.comp` is
//! [`COMBINE`]). Those that include `real.glsl` are there twice, as a [`RealShader`].

use antirad_gpu::Shader;
use antirad_scene::Precision;

/// A shader compiled for f32 and for f64.
#[derive(Debug)]
pub struct RealShader {
    f32: Shader,
    f64: Shader,
}

impl RealShader {
    /// The variant for a precision.
    pub fn of(&self, precision: Precision) -> &Shader {
        match precision {
            Precision::F32 => &self.f32,
            Precision::F64 => &self.f64,
        }
    }
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
