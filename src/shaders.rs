//! The compute shaders of `glsl/`, compiled by `build.rs`: one static per file, named after it (`combine.comp` is [`COMBINE`]).

/// A compute shader with the entry point `main`.
#[derive(Debug)]
pub struct Shader {
    /// The file's name without `.comp`; it names the pipeline, its profile rows and its errors.
    pub name: &'static str,
    pub spirv: &'static [u32],
}

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
