//! A compiled compute shader.

/// A compute shader with the entry point `main`. Only the build makes them (`src/shaders.rs`), which is why safe code can run
/// them.
#[derive(Debug)]
pub struct Shader {
    name: &'static str,
    spirv: &'static [u32],
}

impl Shader {
    pub(crate) const fn new(name: &'static str, spirv: &'static [u32]) -> Self {
        Self { name, spirv }
    }

    /// The file's name without `.comp`; it names the pipeline, its profile rows and its errors.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The words of the module.
    pub fn spirv(&self) -> &'static [u32] {
        self.spirv
    }
}
