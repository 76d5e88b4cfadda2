//! A compiled compute shader.

/// A compute shader with the entry point `main`. Only the build makes them (`crates/core/src/shaders.rs`), which is why safe code can run
/// them.
#[derive(Debug)]
pub struct Shader {
    name: &'static str,
    spirv: &'static [u32],
}

impl Shader {
    /// A shader of this name from its SPIR-V words.
    pub const fn new(name: &'static str, spirv: &'static [u32]) -> Self {
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

/// A kernel of the engine, which tests of this layer run without the engine.
#[cfg(test)]
pub fn engine_kernel(name: &'static str) -> Shader {
    let file = format!("{}/../core/spirv/{name}.spv", env!("CARGO_MANIFEST_DIR"));
    let bytes = std::fs::read(file).expect("a module");
    let words: Vec<u32> = bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    Shader::new(name, words.leak())
}
