//! Compiles every `glsl/NAME.comp` to SPIR-V and writes `$OUT_DIR/shaders.rs`, which `src/shaders.rs` includes.
//! Heads (`glsl/*.glsl`) are reached with `#include`; any shader error stops the build with the compiler's message.

use std::collections::BTreeSet;
use std::env;
use std::fmt::Write as _;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// Relative to the package root, where cargo runs build scripts: no path of the building machine gets into the SPIR-V.
const GLSL: &str = "glsl";

fn main() -> ExitCode {
    match build() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            for line in message.lines() {
                println!("cargo::error={line}");
            }
            ExitCode::FAILURE
        }
    }
}

fn build() -> Result<(), String> {
    println!("cargo::rerun-if-changed={GLSL}");
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: run through cargo")?);
    let mut source = String::new();
    let mut all = String::new();
    let mut names = BTreeSet::new();
    for shader in shaders()? {
        let name = shader.file_stem().and_then(|stem| stem.to_str()).ok_or("a shader's name is not UTF-8")?;
        let constant = name.to_uppercase();
        let single = compiled(&shader, &out, name, &[])?;
        let doubles = uses_reals(&shader)?;
        for name in [Some(name.to_owned()), doubles.then(|| format!("{name}_f64"))].into_iter().flatten() {
            if !names.insert(name.clone()) {
                return Err(format!("{}: there are two shaders \"{name}\": rename one", shader.display()));
            }
        }
        if doubles {
            let double = compiled(&shader, &out, &format!("{name}_f64"), &["F64"])?;
            let _ = writeln!(
                source,
                "/// `{}`.\npub static {constant}: RealShader = RealShader {{ f32: {single}, f64: {double} }};",
                shader.display()
            );
            let _ = write!(all, "&{constant}.f32, &{constant}.f64, ");
        } else {
            let _ =
                writeln!(source, "/// `{}`.\npub static {constant}: Shader = {single};", shader.display());
            let _ = write!(all, "&{constant}, ");
        }
    }
    let _ = writeln!(source, "/// Every shader of the crate.\npub static ALL: &[&Shader] = &[{all}];");
    let generated = out.join("shaders.rs");
    fs::write(&generated, source).map_err(|error| format!("{}: {error}", generated.display()))
}

/// Compiles and checks one variant of a shader; returns it as Rust source.
fn compiled(shader: &Path, out: &Path, name: &str, defines: &[&str]) -> Result<String, String> {
    let spv = out.join(name).with_extension("spv");
    compiler::compile(shader, &spv, defines)?;
    validate(shader, &spv)?;
    Ok(format!("Shader {{ name: {name:?}, spirv: &{:?} }}", words(&spv)?))
}

/// Whether a shader includes the head that makes its numbers f32 or f64, itself or through another head.
fn uses_reals(shader: &Path) -> Result<bool, String> {
    let text = fs::read_to_string(shader).map_err(|error| format!("{}: {error}", shader.display()))?;
    let included = text.lines().filter_map(|line| line.strip_prefix("#include \"")?.strip_suffix('"'));
    for head in included {
        if head == "real.glsl" || uses_reals(&Path::new(GLSL).join(head))? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The compute shaders, sorted so that the generated file is the same on every machine.
fn shaders() -> Result<Vec<PathBuf>, String> {
    let entries = match fs::read_dir(GLSL) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(format!("{GLSL}: {error}")),
    };
    let mut shaders = Vec::new();
    for entry in entries {
        let path = entry.map_err(|error| format!("{GLSL}: {error}"))?.path();
        if path.extension().is_some_and(|extension| extension == "comp") {
            shaders.push(path);
        }
    }
    shaders.sort();
    Ok(shaders)
}

fn words(spv: &Path) -> Result<Vec<u32>, String> {
    let bytes = fs::read(spv).map_err(|error| format!("{}: {error}", spv.display()))?;
    Ok(bytes.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]])).collect())
}

/// Runs `spirv-val` where there is one: a second opinion that most hosts have, not worth a dependency.
fn validate(shader: &Path, spv: &Path) -> Result<(), String> {
    match Command::new("spirv-val")
        .args(["--target-env", "vulkan1.2", "--scalar-block-layout"])
        .arg(spv)
        .output()
    {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => {
            Err(format!("{}: spirv-val: {}", shader.display(), text(&output.stdout, &output.stderr)))
        }
        Err(_) => Ok(()),
    }
}

fn text(stdout: &[u8], stderr: &[u8]) -> String {
    format!("{}{}", String::from_utf8_lossy(stdout), String::from_utf8_lossy(stderr))
}

/// `glslc` from PATH: a fraction of a second a shader, and packaged nearly everywhere.
#[cfg(not(feature = "shaderc"))]
mod compiler {
    use super::{Command, ErrorKind, GLSL, Path, fs, text};

    const INSTALL: &str = "`glslc` compiles the shaders and is not in PATH: install it (`apt install glslc`, \
        `dnf install glslc`, `brew install shaderc` or the Vulkan SDK), or build with `--features shaderc`, \
        which compiles it from source (needs cmake, python3 and a C++ compiler)";

    pub fn compile(shader: &Path, spv: &Path, defines: &[&str]) -> Result<(), String> {
        let dependencies = spv.with_extension("d");
        // -g keeps the names: validation messages and profilers can be read, and tests check layouts by member name.
        let output = Command::new("glslc")
            .args(["--target-env=vulkan1.2", "-std=450core", "-O", "-g", "-Werror", "-I", GLSL, "-MD", "-MF"])
            .arg(&dependencies)
            .args(defines.iter().map(|name| format!("-D{name}")))
            .arg("-o")
            .args([spv, shader])
            .output()
            .map_err(|error| match error.kind() {
                ErrorKind::NotFound => INSTALL.to_owned(),
                _ => format!("glslc: {error}"),
            })?;
        if !output.status.success() {
            return Err(text(&output.stdout, &output.stderr));
        }
        // One line, "NAME.spv: glsl/NAME.comp glsl/HEAD.glsl ..."
        let list = fs::read_to_string(&dependencies)
            .map_err(|error| format!("{}: {error}", dependencies.display()))?;
        for file in list.split_once(": ").map_or("", |(_, files)| files).split_whitespace() {
            println!("cargo::rerun-if-changed={file}");
        }
        Ok(())
    }
}

/// The same compiler front end built from source, for hosts without `glslc`.
#[cfg(feature = "shaderc")]
mod compiler {
    use super::{GLSL, Path, fs};
    use shaderc::{
        CompileOptions, Compiler, EnvVersion, GlslProfile, OptimizationLevel, ResolvedInclude, ShaderKind,
        TargetEnv,
    };

    pub fn compile(shader: &Path, spv: &Path, defines: &[&str]) -> Result<(), String> {
        let failed = |error: shaderc::Error| error.to_string();
        let file = shader.display().to_string();
        let source = fs::read_to_string(shader).map_err(|error| format!("{file}: {error}"))?;
        let mut options = CompileOptions::new().map_err(failed)?;
        options.set_target_env(TargetEnv::Vulkan, EnvVersion::Vulkan1_2 as u32);
        options.set_forced_version_profile(450, GlslProfile::Core);
        options.set_optimization_level(OptimizationLevel::Performance);
        options.set_generate_debug_info();
        options.set_warnings_as_errors();
        for name in defines {
            options.add_macro_definition(name, None);
        }
        options.set_include_callback(|name, _, _, _| {
            let head = Path::new(GLSL).join(name);
            let resolved_name = head.display().to_string();
            println!("cargo::rerun-if-changed={resolved_name}");
            let content = fs::read_to_string(&head).map_err(|error| format!("{resolved_name}: {error}"))?;
            Ok(ResolvedInclude { resolved_name, content })
        });
        let artifact = Compiler::new()
            .and_then(|compiler| {
                compiler.compile_into_spirv(&source, ShaderKind::Compute, &file, "main", Some(&options))
            })
            .map_err(failed)?;
        println!("cargo::rerun-if-changed={file}");
        fs::write(spv, artifact.as_binary_u8()).map_err(|error| format!("{}: {error}", spv.display()))
    }
}
