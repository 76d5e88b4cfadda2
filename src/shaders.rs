//! The compute shaders of `glsl/`, as SPIR-V by `build.rs`: one static per file, named after it (`combine.comp` is
//! [`COMBINE`]). Those that include `real.glsl` are there twice, as a [`RealShader`].

use crate::scene::Precision;

/// A compute shader with the entry point `main`. Only the build creates them, which is why safe code can run them.
#[derive(Debug)]
pub struct Shader {
    name: &'static str,
    spirv: &'static [u32],
}

impl Shader {
    /// The file's name without `.comp`; it names the pipeline, its profile rows and its errors.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The words of the module.
    pub fn spirv(&self) -> &'static [u32] {
        self.spirv
    }
}

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
            Precision::F32 | Precision::HalfBins => &self.f32,
            Precision::F64 => &self.f64,
        }
    }
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));

#[cfg(test)]
impl Shader {
    /// The code of another kernel under this name, to provoke errors.
    pub(crate) fn impostor(&self, code: &Self) -> Self {
        Self { name: self.name, spirv: code.spirv }
    }
}
